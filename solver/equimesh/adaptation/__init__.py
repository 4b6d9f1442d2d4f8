"""Meshes for a solution that is not known: solve, adapt to what the solver returns, and solve again."""
