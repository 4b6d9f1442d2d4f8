"""Functions of x and y with derivatives: expressions, samples, nodal values."""
