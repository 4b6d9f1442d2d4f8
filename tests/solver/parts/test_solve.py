"""A solve in parts: equal to the whole to the last bit."""

from __future__ import annotations

import pytest

import equimesh as em
from cases import problem
from solver.parts.whole import in_parts, low_strips, require_equal

__all__ = ["low_strips"]


@pytest.mark.usefixtures("low_strips")
@pytest.mark.parametrize("boundary", [em.Boundary.TRACE, em.Boundary.ORTHOGONAL])
@pytest.mark.parametrize("domain", [em.Rectangle(), em.AnnulusSector(angles=(0, 120))], ids=["square", "annulus"])
def test_parts_are_equal_to_the_whole(domain: em.Domain, boundary: em.Boundary) -> None:
    case = problem("tanh20", 257, boundary=boundary, b=0.5)
    case = em.Problem(monitor=case.monitor, grid=case.grid, boundary=boundary, domain=domain)
    for mode in em.Mode:
        whole = em.solve(case, mode=mode, threads=1)
        assert whole.status is em.Status.CONVERGED
        for count in (1, 2, 3, 8):
            require_equal(in_parts(case, count, mode), whole)
