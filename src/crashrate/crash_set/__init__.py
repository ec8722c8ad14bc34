"""Which situations crash: risk order, monotone set, surrogate."""
