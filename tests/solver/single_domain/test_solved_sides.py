"""The sides are equidistributed from any start, also where fronts are thinner than the cells."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from cases import problem
from equimesh.single_domain.solved_sides import cut, sampled, straight_start, with_solved_sides
from equimesh.sweeps.sweep import SideNodes, Sides


def deviation(case: em.Problem, mesh: em.Mesh) -> float:
    return Sides(case.metric, case.boundary, mesh.x.shape).moves(SideNodes.of(mesh.x, mesh.y))[0]


@pytest.mark.parametrize("boundary", [em.Boundary.TRACE, em.Boundary.EQUIDISTRIBUTED_1D])
def test_squared_lengths_along_the_sides_become_equal(boundary: em.Boundary) -> None:
    case = problem("tanh20", 17, boundary=boundary)
    uniform = em.Mesh.uniform(case.grid)
    assert deviation(case, uniform) > 0.5
    found = with_solved_sides(case, uniform)
    assert deviation(case, found) < 1e-11
    assert not found.is_folded


@pytest.mark.parametrize("steepness", [20, 60, 100])
@pytest.mark.parametrize("points", [17, 33, 65])
def test_fronts_in_curvature_are_found_on_every_grid(steepness: int, points: int) -> None:
    monitor = em.Curvature(u=em.Expression(f"tanh({steepness}*(x - 0.37))"))
    case = em.Problem(monitor=monitor, grid=em.Grid(n_xi=points, n_eta=9))
    found = with_solved_sides(case, em.Mesh.uniform(case.grid))
    assert found is not None
    assert deviation(case, found) < 1e-11


def test_the_interior_follows_the_sides() -> None:
    case = em.Problem(monitor=em.ArcLength(u=em.Expression("tanh(40*(x - 0.3))")), grid=em.Grid(n_xi=17, n_eta=9))
    mesh = straight_start(case)
    assert np.ptp(mesh.x, axis=1).max() < 1e-11, "straight lines: u does not depend on y"
    assert np.diff(mesh.x[:, 0]).min() < 0.5 / 16


def test_orthogonal_sides_are_left_alone_but_start_straight() -> None:
    u = em.Expression("tanh(40*(x - 0.3))")
    case = em.Problem(monitor=em.ArcLength(u=u), grid=em.Grid(n_xi=17, n_eta=9), boundary=em.Boundary.ORTHOGONAL)
    uniform = em.Mesh.uniform(case.grid)
    assert with_solved_sides(case, uniform) is uniform
    assert np.diff(straight_start(case).x[:, 0]).min() < 0.5 / 16


def test_samples_see_a_front_thinner_than_their_first_spacing() -> None:
    width, place = 1e-3, 0.3217

    def density(at: np.ndarray) -> np.ndarray:
        middle = 0.5 * (at[1:] + at[:-1])
        return np.asarray(1.0 + np.exp(-(((middle - place) / width) ** 2)) / width)

    at, integral = sampled(density)
    assert integral[-1] == pytest.approx(1.0 + np.sqrt(np.pi), rel=5e-3)
    nodes = cut(at, integral, 11, 0.0)
    assert (nodes[0], nodes[-1]) == (0.0, 1.0)
    assert np.sum(np.abs(nodes - place) < 3 * width) >= 5
