"""Meshes of quadrilaterals from files that others made: plain arrays of points, cells and named sides."""
