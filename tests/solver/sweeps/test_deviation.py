"""The deviation in one pass is that of a sweep, on all domains and in any number of threads."""

from __future__ import annotations

import math

import numpy as np
import pytest

import equimesh as em
from equimesh.equations.problem import Problem
from equimesh.meshes.rows import Rows
from equimesh.sweeps.deviation import deviation
from equimesh.sweeps.sweep import Sweep, memory_needed

U = em.Expression("tanh(9*(x + y/2 - 0.7))")


def problem(shape: tuple[int, int], domain: em.Domain, monitor: em.Monitor) -> Problem:
    return Problem(monitor=monitor, grid=em.Grid(n_xi=shape[0], n_eta=shape[1]), domain=domain)


def bent(shape: tuple[int, int]) -> em.Mesh:
    """A smooth mesh of the reference square that solves nothing."""
    start = em.Mesh.uniform(em.Grid(n_xi=shape[0], n_eta=shape[1]))
    x, y = start.x, start.y
    return em.Mesh(x + 0.1 * x * (1 - x) * (1 + y), y - 0.1 * np.sin(np.pi * y) * np.sin(3 * x))


@pytest.mark.parametrize("domain", [em.Rectangle(), em.AnnulusSector()], ids=["square", "sector"])
@pytest.mark.parametrize("monitor", [em.ArcLength(u=U), em.Weight(rho=em.Expression("1 + x*y"))])
@pytest.mark.parametrize("shape", [(4, 4), (40, 7), (301, 150)])
def test_it_is_that_of_a_sweep(domain: em.Domain, monitor: em.Monitor, shape: tuple[int, int]) -> None:
    case, mesh = problem(shape, domain, monitor), bent(shape)
    swept = Sweep(case.metric, case.boundary, Rows.whole(shape), np.empty(memory_needed(shape))).correct(mesh.x, mesh.y)
    found = deviation(case.metric, case.boundary, mesh)
    assert found == pytest.approx(swept.deviation, rel=1e-12)
    assert deviation(case.metric, case.boundary, mesh, threads=3) == found
    u = case.metric.u(mesh.x, mesh.y)
    assert deviation(case.metric, case.boundary, mesh, u=u) == pytest.approx(found, rel=1e-12)
    assert found > 1e-3


def test_a_length_that_is_not_a_number_makes_it_infinite() -> None:
    case, mesh = problem((9, 9), em.Rectangle(), em.ArcLength(u=U)), bent((9, 9))
    x = mesh.x.copy()
    x[4, 4] = math.nan
    assert deviation(case.metric, case.boundary, em.Mesh(x, mesh.y)) == math.inf


# The deviation of a mesh with closed lines, against lengths that are computed one by one.


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
