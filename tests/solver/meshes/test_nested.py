"""Nested grids, and meshes taken from one to the next."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.meshes.nested import interpolate, nested_grids, prolong, square_grids


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


def test_interpolation_keeps_or_measures() -> None:
    rule = (np.array([0, 0, 0]), np.array([[1.0, 0.0], [0.5, 0.5], [0.0, 1.0]]))
    coarse, fine = np.array([[0.0, 1.0], [2.0, 5.0]]), np.full((3, 3), 7.0)
    assert interpolate(coarse, *rule, *rule, fine, False) == 7.0
    assert (fine == 7.0).all()
    interpolate(coarse, *rule, *rule, fine, True)
    assert fine == pytest.approx(np.array([[0, 0.5, 1], [1, 2, 3], [2, 3.5, 5]]))


def test_square_grids_have_like_numbers_as_long_as_they_can() -> None:
    shapes = [grid.shape for grid in square_grids(em.Grid(n_xi=129, n_eta=65))]
    assert shapes == [(17, 17), (33, 33), (65, 65), (129, 65)]
    assert [grid.shape for grid in square_grids(em.Grid(n_xi=40, n_eta=171))][-1] == (40, 171)
    alike = em.Grid(n_xi=70, n_eta=60)
    assert square_grids(alike) == nested_grids(alike)
