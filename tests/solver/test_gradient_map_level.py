"""The iteration on one grid: it ends with equal shares, and never accepts a folded mesh."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

import equimesh as em
from equimesh.gradient_map import MAX_DEVIATION, MAX_MOVES, MIN_JACOBIAN, Density, MapLevel, Placed


def level(rho: str, n_xi: int = 17, n_eta: int = 17, domain: em.Domain | None = None) -> MapLevel:
    domain, grid = domain or em.Rectangle(), em.Grid(n_xi=n_xi, n_eta=n_eta)
    density = Density.of(em.Weight(rho=em.Expression(rho)).on(domain), domain, grid)
    return MapLevel(grid=grid, table=density.on(grid), extents=density.extents)


def solved(of: MapLevel) -> list[Placed]:
    return list(of.steps(np.zeros(tuple(n - 1 for n in of.grid.shape))))


@pytest.mark.parametrize("rho", ["1 + 20*exp(-50*((x - 0.4)**2 + (y - 0.6)**2))", "where(x + y < 0.9, 1, 100)"])
def test_shares_become_equal(rho: str) -> None:
    steps = solved(level(rho))
    deviations = [step.deviation for step in steps]
    assert deviations[0] > 10 * MAX_DEVIATION
    assert all(after < before for before, after in pairwise(deviations))
    assert deviations[-1] <= MAX_DEVIATION
    assert len(steps) < 30


def test_a_density_of_one_coordinate_gives_its_equidistribution() -> None:
    last = solved(level("1/(0.1 + x)", 33, 9))[-1]
    exact = 0.1 * 11.0 ** np.linspace(0, 1, 33) - 0.1
    assert np.abs(last.x - exact[:, None]).max() < 0.01
    assert np.abs(last.y - np.linspace(0, 1, 9)).max() < 1e-12


def test_the_map_is_a_gradient() -> None:
    """Its curl vanishes: the change of x along eta is the change of y along xi, on a square of equal spacings."""
    last = solved(level("1 + 20*exp(-50*((x - 0.4)**2 + (y - 0.6)**2))", 33, 33))[-1]
    dx, dy = last.x - np.linspace(0, 1, 33)[:, None], last.y - np.linspace(0, 1, 33)
    by_eta = dx[1:-1, 2:] - dx[1:-1, :-2]
    by_xi = dy[2:, 1:-1] - dy[:-2, 1:-1]
    assert np.abs(by_eta - by_xi).max() < 0.05 * np.abs(by_eta).max()


def test_a_long_rectangle_is_moved_by_a_gradient_in_its_own_lengths() -> None:
    rho = "1 + 5*exp(-3*((x - 2)**2 + (y - 0.5)**2))"
    turned = "1 + 5*exp(-3*((y - 2)**2 + (x - 0.5)**2))"
    wide = solved(level(rho, 33, 9, em.Rectangle(x=(0, 4))))[-1]
    tall = solved(level(turned, 9, 33, em.Rectangle(y=(0, 4))))[-1]
    assert np.allclose(wide.x, tall.y.T, atol=1e-10)
    dx, dy = 4.0 * (wide.x - np.linspace(0, 1, 33)[:, None]), wide.y - np.linspace(0, 1, 9)
    by_y, by_x = dx[1:-1, 2:] - dx[1:-1, :-2], dy[2:, 1:-1] - dy[:-2, 1:-1]  # both over a quarter
    assert np.abs(by_y - by_x).max() < 0.25 * np.abs(by_y).max()


def test_no_accepted_mesh_is_folded_even_where_shares_do_not_become_equal() -> None:
    hard = level("1 + 1e9*exp(-(300*(x - y))**2)", 33, 33)
    steps = solved(hard)
    assert all(not em.Mesh(step.x, step.y).is_folded for step in steps)
    assert steps[-1].deviation > MAX_DEVIATION


def test_a_potential_that_folds_is_reduced() -> None:
    here = level("1")
    phi = np.cos(np.pi * (np.arange(16)[:, None] + 0.5) / 16) * np.ones(16)
    assert here.place(phi) is None
    started = here.start(phi)
    assert 0.0 < np.abs(started.phi).max() < np.abs(phi).max()
    mesh = em.Mesh(started.x, started.y)
    assert mesh.min_jacobian > MIN_JACOBIAN
    assert len(list(here.steps(phi))) < MAX_MOVES
