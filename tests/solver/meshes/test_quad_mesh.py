"""Meshes of blocks: numbers of cells, Jacobians, folds, triangles."""

from __future__ import annotations

import math

import numpy as np
import pytest

import equimesh as em
from equimesh.meshes.mesh import Mesh, quads_of_block


def two_blocks(points: np.ndarray | None = None) -> Mesh:
    """Two blocks of 2 x 2 and 1 x 2 cells side by side; the second one begins on the right."""
    left = np.arange(9).reshape(3, 3)
    right = np.array([[6, 7, 8], [9, 10, 11]])
    x, y = np.meshgrid([0.0, 1.0, 2.0, 3.0], [0.0, 1.0, 2.0], indexing="ij")
    places = np.column_stack([x.ravel(), y.ravel()]) if points is None else points
    cells = np.concatenate([quads_of_block(left), quads_of_block(right)])
    return Mesh(points=places, cells=cells, sides={"inlet": np.array([[2, 1], [1, 0]])}, blocks=(left, right))


def test_shapes_names_and_views() -> None:
    mesh = two_blocks()
    assert (mesh.node_shape, mesh.cell_shape, mesh.block_names) == ((12,), (6,), ("block0", "block1"))
    assert mesh.x[9] == 3.0
    assert mesh.block_mesh(1).x.tolist() == [[2.0] * 3, [3.0] * 3]
    uniform = em.Mesh.uniform(em.Grid(n_xi=5, n_eta=4))
    assert (uniform.node_shape, uniform.cell_shape) == ((5, 4), (4, 3))


def test_cells_of_a_block_are_found_in_any_order() -> None:
    mesh = two_blocks()
    assert [cells.tolist() for cells in mesh.block_cells] == [[[0, 1], [2, 3]], [[4, 5]]]
    order = np.array([3, 5, 0, 1, 4, 2])
    turned = np.roll(mesh.cells[order], 1, axis=1)
    shuffled = Mesh(points=mesh.points, cells=turned, sides={}, blocks=mesh.blocks)
    for mine, other in zip(mesh.block_cells, shuffled.block_cells, strict=True):
        assert (order[other] == mine).all()
    short = Mesh(points=mesh.points, cells=mesh.cells[:-1], sides={}, blocks=mesh.blocks)
    with pytest.raises(em.InputError, match=r"\[7, 8, 10, 11\], which is no cell"):
        _ = short.block_cells


def test_jacobians_are_relative_to_the_mean_cell() -> None:
    mesh = two_blocks()
    assert np.allclose(mesh.corner_jacobians(), np.ones((4, 6)))
    assert mesh.cell_areas() == pytest.approx(np.ones(6))
    points = mesh.points.copy()
    points[4] += [0.25, 0.0]
    bent = mesh.moved(points)
    assert bent.min_jacobian == pytest.approx(bent.corner_jacobians().min()) == pytest.approx(0.75)
    assert bent.distance(mesh) == 0.25
    assert bent.block_cells[1].tolist() == [[4, 5]]


@pytest.mark.parametrize("value", [2.0, 2.5, math.nan, math.inf])
def test_a_node_beyond_the_next_one_folds(value: float) -> None:
    mesh = two_blocks()
    assert not mesh.is_folded
    points = mesh.points.copy()
    points[4, 0] = value
    assert mesh.moved(points).is_folded


def test_threads_see_each_cell() -> None:
    x, y = np.meshgrid(np.arange(260.0), np.arange(140.0), indexing="ij")
    block = np.arange(x.size).reshape(x.shape)
    points = np.column_stack([x.ravel(), y.ravel()])
    mesh = Mesh(points=points, cells=quads_of_block(block), sides={}, blocks=(block,))
    assert not mesh.is_folded_on(2)
    for node in (block[1, 1], block[-2, -2]):
        moved = points.copy()
        moved[node] += 2.0
        assert mesh.moved(moved).is_folded_on(2)


def test_triangles_fill_the_cells_and_have_one_edge_on_the_boundary() -> None:
    mesh = two_blocks()
    parts = mesh.mesh_parts("triangle")
    assert parts.shape is None
    corners = parts.points[parts.cells]
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    assert np.allclose(0.5 * (one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]), 0.5)
    edges = np.sort(np.stack([parts.cells, np.roll(parts.cells, -1, axis=1)], axis=-1), axis=-1).reshape(-1, 3, 2)
    keys = edges[..., 0] * 100 + edges[..., 1]
    free = np.array([[np.count_nonzero(keys == key) == 1 for key in row] for row in keys])
    assert free.sum(axis=1).max() == 1
    assert np.array_equal(parts.mesh_parts("quad").cells, mesh.cells)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"points": np.zeros((3, 3))}, r"points has shape \(3, 3\)"),
        ({"cells": np.zeros((3, 3), dtype=int)}, r"cells has shape"),
        ({"cells": np.array([[0, 1, 2, 12]])}, r"cells\[0\]\[3\] = 12"),
        ({"sides": {"wall": np.array([[0, -1]])}}, r"sides.wall\[0\]\[1\] = -1"),
        ({"blocks": (np.array([[0, 1, 2]]),)}, r"blocks\[0\] has shape"),
        ({"block_names": ("one",)}, "1 names for 2 blocks"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(change: dict, message: str) -> None:
    mesh = two_blocks()
    given = {"points": mesh.points, "cells": mesh.cells, "sides": {}, "blocks": mesh.blocks} | change
    with pytest.raises(em.InputError, match=message):
        Mesh(**given)
