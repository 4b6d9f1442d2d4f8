"""Error estimates of a certificate: those of the solve times a factor, so that they err on the safe side.

The factors are from 200 random problems: the true errors are below the products in 95 % of 200 other random problems
(``benchmarks/error_estimates.py``).
"""

from equimesh.inputs import finite_or_none

# The estimate from the last moves of the iteration is too small where its contraction still grows.
ALGEBRAIC_SAFETY = 2.0
# The estimate from a coarser grid is too small where u is not yet resolved there, so that the order is below two.
DISCRETIZATION_SAFETY = 2.5


def safe_algebraic_error(estimate: float | None) -> float | None:
    """The estimated error from stopping the iteration, on the safe side; ``None`` where it is not known."""
    return None if estimate is None else finite_or_none(ALGEBRAIC_SAFETY * estimate)


def safe_discretization_error(estimate: float | None) -> float | None:
    """The estimated error of the grid, on the safe side; ``None`` where it is not known."""
    return None if estimate is None else finite_or_none(DISCRETIZATION_SAFETY * estimate)
