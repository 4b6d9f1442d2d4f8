"""One call from a problem to its solution."""
