"""Where to simulate: dominating points and proposals."""
