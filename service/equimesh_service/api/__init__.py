"""Routes, and the models of their answers."""
