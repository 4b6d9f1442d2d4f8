"""Problems: the monitor bound to the domain, and the equations of the whole grid."""

from __future__ import annotations

import pytest

import equimesh as em

U = em.Expression("tanh(9*(x - y))")
GRID = em.Grid(n_xi=9, n_eta=7)
SECTOR = em.AnnulusSector()


def test_the_monitor_is_bound_to_the_domain() -> None:
    case = em.Problem(monitor=em.Curvature(u=U), grid=GRID, domain=SECTOR)
    assert case.monitor == em.Curvature(u=U).on(SECTOR)
    assert case.monitor.on(SECTOR) is case.monitor
    with pytest.raises(em.InputError, match="rho"):
        em.Problem(monitor=em.Weight(rho=em.Expression("x - 0.5")), grid=GRID)


def test_the_equations_are_those_of_the_grid_and_the_boundary() -> None:
    case = em.Problem(monitor=em.ArcLength(u=U), grid=GRID, boundary=em.Boundary.ORTHOGONAL)
    equations = case.equations(0.25)
    assert equations.shape == (9, 7)
    assert (equations.d_xi, equations.d_eta) == (1 / 8, 1 / 6)
    assert equations.cross_line == 0.25
    assert {getattr(side, "kind", None) for side in equations.conditions} == {em.Boundary.ORTHOGONAL}
    assert case.equations().cross_line == 0.0
    assert equations.metric is case.metric


def test_another_grid_keeps_the_metric() -> None:
    """What it measures of u is measured once for all levels of a nested iteration."""
    problem = em.Problem(monitor=em.ArcLength(u=em.Expression("x + y")), grid=em.Grid(n_xi=9, n_eta=5))
    other = problem.on_grid(em.Grid(n_xi=17, n_eta=9))
    assert other == em.Problem(monitor=problem.monitor, grid=em.Grid(n_xi=17, n_eta=9))
    assert other.metric is problem.metric
