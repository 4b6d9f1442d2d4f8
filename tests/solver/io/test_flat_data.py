"""The data of a mesh as files take them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from block_cases import data_of, l_shape
from equimesh.io.write import cell_data, corners_of, node_groups, per_quad, point_data, side_data
from solver.io.files import DATA


def test_fields_are_rows_and_only_grids_have_computational_coordinates() -> None:
    data = data_of(l_shape())
    found = point_data(data)
    assert [*found] == ["u", "rho", "flow"]
    assert found["flow"].shape == (65, 3)
    assert not found["flow"][:, 2].any()
    assert [*point_data(DATA)] == ["u", "xi", "eta"]
    many = replace(data, fields={"all": np.arange(65 * 4.0).reshape(65, 4)})
    assert point_data(many)["all_3"][:2].tolist() == [3.0, 7.0]


def test_triangles_inherit_the_values_of_their_quadrilateral() -> None:
    data = data_of(l_shape())
    quads, triangles = cell_data(data, "quad"), cell_data(data, "triangle")
    for name, values in quads.items():
        assert np.array_equal(np.repeat(values, per_quad("triangle"), axis=0), triangles[name]), name
    assert corners_of(data, "triangle").shape == (96, 3)
    assert corners_of(data, "quad") is data.mesh.cells


def test_sides_of_blocks_are_arrays_of_edges_and_groups_of_nodes() -> None:
    data = data_of(l_shape())
    assert {name: len(edges) for name, edges in side_data(data).items()} == {
        "sides/inlet": 8,
        "sides/outlet": 4,
        "sides/wall": 20,
    }
    assert side_data(DATA) == {}
    groups = node_groups(data)
    assert groups[data.mesh.blocks[0][0, 0]] == 13
    assert {*groups.tolist()} == {0, 1, 2, 3, 13, 23}


def test_ten_sides_have_two_digits_each() -> None:
    mesh = l_shape()
    wall = mesh.sides["wall"]
    sides = {"inlet": mesh.sides["inlet"], "outlet": mesh.sides["outlet"]}
    sides |= {f"wall {k}": wall[2 * k : 2 * k + 2] for k in range(10)}
    found = node_groups(data_of(replace(mesh, sides=sides)))
    assert found.max() == 1112
    assert found[mesh.blocks[0][0, 0]] == 103
