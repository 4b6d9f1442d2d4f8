"""The checks of `equimesh doctor`."""
