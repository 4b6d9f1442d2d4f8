"""The rows of a mesh that a process holds to measure its cells."""

from __future__ import annotations

import numpy as np
import pytest

from equimesh.meshes.mesh import Grid, Mesh, MeshWindow, Rows

MESH = Mesh.uniform(Grid(n_xi=1400, n_eta=90))


def test_the_uniform_mesh_is_known_by_rows() -> None:
    rows = Rows(shape=MESH.x.shape, begin=3, first=4, last=8)
    window = MeshWindow.uniform(rows, 7)
    assert np.array_equal(window.x, MESH.x[3:10])
    assert np.array_equal(window.nodes(4, 8)[1], MESH.y[4:9])


def test_names_of_parts_say_where_they_are() -> None:
    with pytest.raises(ImportError, match=r"equimesh\.meshes\.cut is equimesh_cluster\.cut now"):
        from equimesh.meshes import cut  # noqa: F401


def test_all_rows_are_joined_and_summed_as_they_are() -> None:
    rows, found = Rows.whole(MESH.x.shape), np.arange(6.0).reshape(3, 2)
    assert rows.are_all
    assert rows.joined(found) is found
    assert rows.summed(found) is found
