"""Rows of a mesh as parts of it."""

from __future__ import annotations

import numpy as np
import pytest

from equimesh.errors import InputError
from equimesh.meshes.mesh import Grid, Mesh
from equimesh_cluster.mesh_part import MeshPart, cut

MESH = Mesh.uniform(Grid(n_xi=9, n_eta=5))


def test_parts_together_are_the_mesh() -> None:
    parts = cut(MESH, [2, 3, 7])
    assert [part.number for part in parts] == [0, 1, 2, 3]
    assert all(part.count == 4 and part.grid == MESH.grid for part in parts)
    assert np.array_equal(np.concatenate([part.x[part.own_rows] for part in parts]), MESH.x)
    assert np.array_equal(np.concatenate([part.y[part.own_rows] for part in parts]), MESH.y)
    assert sum(part.last - part.first for part in parts) == MESH.grid.n_xi
    assert [part.is_last for part in parts] == [False, False, False, True]


def test_every_cell_belongs_to_one_part() -> None:
    parts = cut(MESH, [1, 6])
    assert np.array_equal(np.concatenate([part.first_node + part.cells for part in parts]), MESH.cells)
    assert [part.cell_rows for part in parts] == [(0, 1), (1, 6), (6, 8)]


def test_a_mesh_without_cuts_is_one_part() -> None:
    (part,) = cut(MESH, [])
    assert (part.first, part.last, part.is_last) == (0, 9, True)
    assert part.x.shape == (9, 5)


@pytest.mark.parametrize("cuts", [[0], [4, 4], [5, 3], [9], [12]])
def test_cuts_that_leave_a_part_without_rows_are_refused(cuts: list[int]) -> None:
    with pytest.raises(InputError, match="are not rows of a grid"):
        cut(MESH, cuts)


def test_a_part_without_the_first_row_of_the_next_one_is_refused() -> None:
    with pytest.raises(InputError, match=r"need the shape \(4, 5\)"):
        MeshPart(grid=MESH.grid, number=0, count=2, first=0, last=3, x=MESH.x[:3], y=MESH.y[:3])
