"""Nested grids, and meshes taken from one to the next."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.meshes.nested import distance, nested_grids, prolong, square_grids


def test_nested_grids_halve_and_keep_small_directions() -> None:
    assert [grid.shape for grid in nested_grids(em.Grid(n_xi=65, n_eta=65))] == [(17, 17), (33, 33), (65, 65)]
    uneven = nested_grids(em.Grid(n_xi=70, n_eta=6))
    assert [grid.shape for grid in uneven] == [(10, 6), (19, 6), (36, 6), (70, 6)]


def test_prolongation_is_exact_for_cubics_and_never_folds() -> None:
    grid, fine = em.Grid(n_xi=9, n_eta=7), em.Grid(n_xi=17, n_eta=13)
    uniform, finer = em.Mesh.uniform(grid), em.Mesh.uniform(fine)

    def curved(mesh: em.Mesh) -> em.Mesh:
        return em.Mesh(mesh.x + 0.5 * mesh.x * (1 - mesh.x) * mesh.y, mesh.y + 0.3 * mesh.y**2 * (1 - mesh.y))

    assert abs(prolong(curved(uniform), fine).x - curved(finer).x).max() < 1e-14
    assert abs(prolong(curved(uniform), fine).y - curved(finer).y).max() < 1e-14


@pytest.mark.parametrize("points", [(257, 257), (300, 290)], ids=["doubled", "other"])
def test_threads_do_not_change_a_bit(points: tuple[int, int]) -> None:
    """Of a prolongation, of the distance to a coarser mesh, and of the sign that tells a fold."""
    random = np.random.default_rng(5)
    coarser, coarse = (em.Mesh.uniform(em.Grid(n_xi=n, n_eta=n)) for n in (65, 129))
    coarse.x[1:-1] += 1e-3 * random.standard_normal((127, 129))
    fine = em.Grid(n_xi=points[0], n_eta=points[1])
    one, *others = (prolong(coarse, fine, coarser, threads=threads) for threads in (1, 2, 5))
    assert all(np.array_equal(one.x, mesh.x) and np.array_equal(one.y, mesh.y) for mesh in others)
    one.x[-3, 6] += 0.1
    assert {distance(one, coarse, threads) for threads in (1, 2, 5)} == {distance(one, coarse)}
    assert distance(one, coarse) > 0.09
    assert [one.is_folded_on(threads) for threads in (1, 2, 5)] == [True, True, True]


def test_square_grids_have_like_numbers_as_long_as_they_can() -> None:
    shapes = [grid.shape for grid in square_grids(em.Grid(n_xi=129, n_eta=65))]
    assert shapes == [(17, 17), (33, 33), (65, 65), (129, 65)]
    assert [grid.shape for grid in square_grids(em.Grid(n_xi=40, n_eta=171))][-1] == (40, 171)
    alike = em.Grid(n_xi=70, n_eta=60)
    assert square_grids(alike) == nested_grids(alike)
