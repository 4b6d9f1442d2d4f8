"""The coarse solution."""

from __future__ import annotations

import pytest

import equimesh as em
from cases import problem
from equimesh.numerics.channel import ALONE
from equimesh_cluster.parts.solve import OtherGridsNeededError, coarse_solution, solve_part


def test_the_coarse_grid_is_the_finest_one_below_the_limit() -> None:
    case = problem("ring", 129)
    assert coarse_solution(case, max_points=70 * 70).grid.shape == (65, 65)
    assert coarse_solution(case, max_points=64 * 64).grid.shape == (33, 33)
    assert coarse_solution(case).grid.shape == (129, 129), "relaxed equations may be solved on this grid"


def test_what_has_no_metric_is_refused_with_what_to_take() -> None:
    u, grid = em.Expression("x*y"), em.Grid(n_xi=33, n_eta=33)
    for monitor in (em.Auto(u=u), em.LeastError(u=u)):
        with pytest.raises(em.InputError, match=r"has no metric, and is not solved in parts: take Curvature"):
            coarse_solution(em.Problem(monitor=monitor, grid=grid))
    periodic = em.ArcLength(u=em.Expression("sin(2*pi*x)"))
    closed = em.Problem(monitor=periodic, grid=grid, domain=em.Rectangle(periodic="x"))
    with pytest.raises(em.InputError, match="the lines of this domain are closed, and parts end at sides"):
        coarse_solution(closed)
    with pytest.raises(em.InputError, match="a gradient map is not solved in parts"):
        coarse_solution(em.Problem(monitor=em.Weight(rho=em.Expression("1 + x"), map="gradient"), grid=grid))
    with pytest.raises(em.InputError, match="a bound of the angles is not kept in parts"):
        coarse_solution(em.Problem(monitor=em.ArcLength(u=u, orthogonality=50.0), grid=grid))


def test_other_grids_are_asked_for_where_sweeps_fail_on_a_grid_of_another_shape(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    case = problem("ring", 257, 65, b=0.5)
    coarse = coarse_solution(case, threads=1, max_points=140 * 40)
    assert coarse.only_requested
    assert coarse.grid.shape == (129, 33)
    square = coarse_solution(case, threads=1, max_points=140 * 70, square=True)
    assert square.grid.shape == (129, 65)
    assert not square.only_requested
    monkeypatch.setattr("equimesh.single_domain.level.MAX_SWEEPS", 0)
    with pytest.raises(OtherGridsNeededError):
        solve_part(case, coarse, ALONE)
