"""The transmission conditions of the paper, as functionals that a receiver sets equal to its neighbour's."""
