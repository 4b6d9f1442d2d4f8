"""The optimized transmission condition: interfaces that yield as the rest of every grid line does."""
