"""The discrete equations of local equidistribution, their boundary conditions, and the problem that they state."""
