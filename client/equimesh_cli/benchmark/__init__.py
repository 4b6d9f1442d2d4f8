"""The measurements of `equimesh bench`; imported only with the solver."""
