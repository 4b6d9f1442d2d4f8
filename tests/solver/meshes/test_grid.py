"""Grids count points, not cells."""

from __future__ import annotations

import pytest

import equimesh as em


def test_the_paper_s_mesh_of_12_by_12_points() -> None:
    grid = em.Grid(n_xi=12, n_eta=6)
    assert (grid.shape, grid.points, grid.cells) == ((12, 6), 72, 55)
    assert (grid.d_xi, grid.d_eta) == (1 / 11, 1 / 5)
    assert str(grid) == "12 x 6"
    assert grid == em.Grid(n_xi=12, n_eta=6)


@pytest.mark.parametrize("name", ["n_xi", "n_eta"])
def test_too_few_points_are_refused(name: str) -> None:
    em.Grid(n_xi=4, n_eta=4)
    with pytest.raises(em.InputError, match=f"{name} = 3: a grid needs at least 4 points") as caught:
        em.Grid(**({"n_xi": 5, "n_eta": 5} | {name: 3}))
    assert caught.value.field == f"grid.{name}"
