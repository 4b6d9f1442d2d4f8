"""Nested grids: meshes taken from one to the next, by rules that are exact for cubics."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.meshes.nested import (
    distance,
    extrapolate,
    interpolate,
    interpolated_values,
    nested_grids,
    prolong,
    rule,
    rules,
    square_grids,
)


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


def nodes(*points: int) -> tuple[np.ndarray, np.ndarray]:
    x, y = np.meshgrid(*(np.linspace(0.0, 1.0, n) for n in points), indexing="ij")
    return x, y


@pytest.mark.parametrize("fine", [(13, 21), (9, 30)], ids=["doubled", "other"])
def test_rules_are_exact_for_cubics_and_for_lines(fine: tuple[int, int]) -> None:
    def cubic(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return (x**3 - x) * (2 * y**3 + y**2 - 1)

    (x, y), (fine_x, fine_y) = nodes(7, 11), nodes(*fine)
    assert abs(interpolated_values(cubic(x, y), fine) - cubic(fine_x, fine_y)).max() < 1e-14
    assert abs(interpolated_values(x - 2 * y, fine, cubic=False) - (fine_x - 2 * fine_y)).max() < 1e-14
    curved = interpolated_values(cubic(x, y), fine, cubic=False) - cubic(fine_x, fine_y)
    assert abs(curved).max() > 1e-3, "lines are no cubics"


def test_common_points_keep_their_values_to_the_last_bit() -> None:
    values = np.random.default_rng(0).random((8, 9))
    assert np.array_equal(interpolated_values(values, (15, 17))[::2, ::2], values)


def test_rules_have_weights_that_sum_to_one() -> None:
    for cubic in (True, False):
        found = rule(6, 23, cubic=cubic)
        assert found.weights.sum(axis=0) == pytest.approx(np.ones(23), abs=1e-14)
        assert found.first.max() == 2
        assert not found.weights.flags.writeable, "rules are shared"


def test_rows_are_written_or_compared() -> None:
    coarse, fine = np.random.default_rng(1).random((5, 6)), np.full((9, 11), 7.0)
    along = rules(coarse.shape, fine.shape)
    whole = interpolated_values(coarse, fine.shape)
    assert interpolate(coarse, *along, (0, 9), fine, False) == abs(whole - 7.0).max()
    assert (fine == 7.0).all()
    interpolate(coarse, *along, (3, 8), fine, True)
    assert np.array_equal(fine[3:8], whole[3:8])
    assert (fine[:3] == 7.0).all()
    assert (fine[8] == 7.0).all()
    fine[4, 4] = np.nan
    assert np.isnan(interpolate(coarse, *along, (3, 8), fine, False)), "a hole must not be overlooked"


def test_extrapolation_continues_the_difference() -> None:
    values, before = np.random.default_rng(2).random((2, 6, 4))
    expected = values + 0.25 * (values - before)
    found = before.copy()
    extrapolate(values, found, 0.25, (2, 5))
    assert np.array_equal(found[2:5], expected[2:5])
    assert np.array_equal(found[:2], before[:2])
    assert np.array_equal(found[5:], before[5:])
