"""Ways: first meshes of any size, and lifting to finer grids without folds."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.least_error.ways import Way, coordinates_of, mesh_of
from solver.bent import bent, uniform

COARSE = em.Grid(n_xi=9, n_eta=7)
FINE = [em.Grid(n_xi=17, n_eta=13), em.Grid(n_xi=16, n_eta=7), em.Grid(n_xi=9, n_eta=12), em.Grid(n_xi=14, n_eta=13)]
GRADED = np.array([0.0, 0.001, 0.003, 0.01, 0.1, 0.4, 0.8, 1.0])
STRAIGHT = Way(name="rectilinear", s=GRADED, t=1.0 - GRADED[::-1])
EVEN = Way.uniform()


def test_the_uniform_way_begins_with_uniform_meshes() -> None:
    for grid in (COARSE, *FINE):
        assert EVEN.start(grid) == pytest.approx(uniform(grid), abs=1e-15)
        assert EVEN.start(grid) is EVEN.start(grid)
    assert (EVEN.name, Way.uniform("given").name) == ("uniform", "given")


@pytest.mark.parametrize("way", [EVEN, STRAIGHT], ids=lambda way: way.name)
@pytest.mark.parametrize("fine", FINE, ids=str)
def test_the_first_mesh_is_lifted_to_the_first_mesh(way: Way, fine: em.Grid) -> None:
    assert way.lifted(way.start(COARSE), COARSE, fine) == pytest.approx(way.start(fine), abs=1e-14)


@pytest.mark.parametrize("fine", FINE, ids=str)
def test_lifting_keeps_sides_and_does_not_fold(fine: em.Grid) -> None:
    for seed in range(20):
        lifted = EVEN.lifted(bent(COARSE, seed, share=0.45), COARSE, fine)
        mesh = mesh_of(lifted, fine)
        assert not mesh.is_folded
        for side in (mesh.x[0], 1 - mesh.x[-1], mesh.y[:, 0], 1 - mesh.y[:, -1]):
            assert (side == 0.0).all()


def test_smooth_displacements_are_lifted_by_cubics() -> None:
    def curved(grid: em.Grid) -> np.ndarray:
        s, t = uniform(grid)
        return np.stack([s + 0.4 * s * (1 - s) * t, t + 0.3 * t**2 * (1 - t)])

    for fine in FINE:
        assert EVEN.lifted(curved(COARSE), COARSE, fine) == pytest.approx(curved(fine), abs=1e-13)


def nearly_folded(grid: em.Grid, seed: int) -> np.ndarray:
    """A valid mesh with cells of nearly no area: the farthest way along a random direction."""
    away = bent(grid, seed, share=3.0) - uniform(grid)
    good, bad = 0.0, 1.0
    for _ in range(40):
        middle = 0.5 * (good + bad)
        if mesh_of(uniform(grid) + middle * away, grid).min_jacobian > 1e-6:
            good = middle
        else:
            bad = middle
    return uniform(grid) + good * away


def test_a_mesh_that_is_nearly_folded_is_lifted_to_a_refined_grid_as_it_is() -> None:
    fine = em.Grid(n_xi=17, n_eta=13)
    for seed in range(20):
        mesh = nearly_folded(COARSE, seed)
        lifted = mesh_of(EVEN.lifted(mesh, COARSE, fine), fine)
        assert not lifted.is_folded
        # Each node of the coarse grid is one of the fine grid, and stays where it is.
        assert coordinates_of(em.Mesh(lifted.x[::2, ::2], lifted.y[::2, ::2])) == pytest.approx(mesh, abs=1e-12)


def test_coordinates_and_meshes_are_the_same() -> None:
    mesh = bent(COARSE)
    assert np.array_equal(coordinates_of(mesh_of(mesh, COARSE)), mesh)


def test_a_given_mesh_is_the_first_one_on_its_own_grid_alone() -> None:
    mesh = bent(COARSE)
    way = Way.given(mesh_of(mesh, COARSE))
    assert np.array_equal(way.start(COARSE), mesh)
    assert way.start(FINE[0]) == pytest.approx(uniform(FINE[0]), abs=1e-15)
    assert way.name == "given"
