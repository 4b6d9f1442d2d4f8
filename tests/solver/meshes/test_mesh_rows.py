"""Nodes of all rows of a mesh, and of some."""

from __future__ import annotations

import numpy as np
import pytest

from equimesh.meshes.mesh import Grid, Mesh, MeshRows
from equimesh.meshes.rows import Rows

MESH = Mesh.uniform(Grid(n_xi=1400, n_eta=90))


def test_the_uniform_mesh_is_known_by_rows() -> None:
    rows = Rows(shape=MESH.x.shape, begin=3, end=10, first=4, last=8)
    some = MeshRows.uniform(rows)
    assert np.array_equal(some.x, MESH.x[3:10])
    assert np.array_equal(some.nodes(4, 8)[1], MESH.y[4:9])


def test_rows_within_rows_are_counted_in_the_grid() -> None:
    every = MeshRows.of(MESH)
    some = every.within(3, 9).within(4, 8)
    assert (some.rows.begin, some.rows.end, some.grid) == (4, 8, MESH.grid)
    assert (some.rows.first, some.rows.last) == (4, 7), "the cells between the rows of nodes that are here"
    assert np.array_equal(some.x, MESH.x[4:8])
    assert np.shares_memory(some.x, every.x)
    assert (every.within(0, 8).rows.first, every.within(0, 8).rows.last) == (0, 7)


def test_names_of_parts_say_where_they_are() -> None:
    with pytest.raises(ImportError, match=r"equimesh\.meshes\.cut is equimesh_cluster\.cut now"):
        from equimesh.meshes import cut  # noqa: F401
