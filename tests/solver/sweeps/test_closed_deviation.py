"""The deviation of a mesh with closed lines, against lengths that are computed one by one."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.sweeps.deviation import deviation


def test_the_deviation_is_the_largest_one_of_all_lines() -> None:
    problem = em.Problem(
        monitor=em.Weight(rho=em.Expression("1")), grid=em.Grid(n_xi=5, n_eta=6), domain=em.Rectangle(periodic="both")
    )
    mesh = em.Mesh.uniform(problem.grid)
    mesh.x[0] -= 0.05  # the seam of the xi-lines
    mesh.x[-1] -= 0.05
    found = deviation(problem.metric, problem.boundary, mesh)
    lengths = np.array([0.3, 0.25, 0.25, 0.2]) ** 2
    assert found == pytest.approx(np.abs(lengths - lengths.mean()).max() / lengths.mean())


def test_a_node_that_is_no_number_has_no_deviation() -> None:
    problem = em.Problem(
        monitor=em.Weight(rho=em.Expression("1")), grid=em.Grid(n_xi=5, n_eta=6), domain=em.Rectangle(periodic="y")
    )
    mesh = em.Mesh.uniform(problem.grid)
    mesh.x[2, 2] = np.nan
    assert deviation(problem.metric, problem.boundary, mesh) == np.inf
