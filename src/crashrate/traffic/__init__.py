"""How often each situation occurs: truncated normals, the mixture fit, the traffic model."""
