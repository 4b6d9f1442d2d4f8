"""Problems and settings of Schwarz solves that several tests look at, and the comparison of their solutions."""

from __future__ import annotations

import equimesh as em
from cases import problem
from equimesh.schwarz.merged_mesh import MergedMeshes

PAPER = problem("paper", 24, 20)
WHOLE = MergedMeshes(em.Decomposition(grid=PAPER.grid))


def assert_same(solution: em.Solution, other: em.Solution, tolerance: float) -> None:
    """Node positions on the reference square differ by less than ``tolerance``."""
    pairs = ((solution.reference.x, other.reference.x), (solution.reference.y, other.reference.y))
    assert max(float(abs(one - two).max()) for one, two in pairs) < tolerance


HOPELESS = problem("wave", 9, boundary=em.Boundary.EQUIDISTRIBUTED_1D, a=1.0, b=0.0)


LINEAR_ROBIN = em.Schwarz(
    subdomains=(2, 2), transmission=em.LinearRobin(), ordering=em.Ordering.ALTERNATING, tolerance=1e-9
)
