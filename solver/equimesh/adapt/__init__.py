"""Meshes for a solution that is not known: solve, adapt to the nodal values, and solve again."""
