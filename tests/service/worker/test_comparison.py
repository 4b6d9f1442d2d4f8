"""The comparison of a mesh that was read from its file is that of the solution it came from."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh_service.worker.drawing import compare

U = em.Expression("tanh(20*(x + y/2 - 0.75))")


@pytest.mark.parametrize(
    "monitor", [em.Auto(u=U, cells="triangle"), em.ArcLength(u=U), em.Weight(rho=em.Expression("1 + x"))]
)
def test_a_mesh_is_compared_as_its_solution_was(monitor: em.Monitor) -> None:
    problem = em.Problem(monitor=monitor, grid=em.Grid(n_xi=17, n_eta=17))
    solution = em.solve(problem)
    expected = solution.against_uniform
    found = compare(solution.mesh, problem, solution.certificate.summary())
    assert found.gain == (expected.gain and pytest.approx(expected.gain, rel=1e-12))
    for mine, its in ((found.adapted, expected.adapted), (found.uniform, expected.uniform)):
        assert (mine.error is None) == (its.error is None) == isinstance(monitor, em.Weight)
        if mine.error is not None and its.error is not None:
            assert np.allclose(mine.error, its.error, rtol=1e-9, atol=1e-15)
