"""Domains from arrays: every node is on its curve, numbers stay, and what is no mesh is refused."""

from __future__ import annotations

import numpy as np
import pytest

from equimesh.blocks.blocks import Blocks
from equimesh.blocks.curves import Circle
from equimesh.blocks.recovery.recovered import recover
from equimesh.blocks.sliding import FIXED, FREE
from equimesh.errors import InputError
from solver.blocks.recovery.meshes import Arrays, boundary_of, disc, grid, ring, without

MESHES = {
    "grid": grid(5, 4),
    "L": without(grid(6, 6), (0.5, 1, 0.5, 1)),
    "hole": without(grid(6, 6), (0.3, 0.7, 0.3, 0.7)),
    "disc": disc(4),
    "ring": ring(16, 3),
}


@pytest.mark.parametrize("name", MESHES)
def test_nodes_of_the_boundary_lie_on_their_curves(name: str) -> None:
    points, cells = MESHES[name]
    domain = Blocks.of_mesh(points, cells, {})
    np.testing.assert_array_equal(domain.mesh.points, points)
    np.testing.assert_array_equal(domain.mesh.cells, cells)
    edge = np.zeros(len(points), bool)
    edge[boundary_of((points, cells))] = True
    np.testing.assert_array_equal(domain.node_curve != FREE, edge)
    for k, curve in enumerate(domain.curves):
        on = domain.node_curve == k
        x, y, *_ = curve.evaluate(domain.node_parameter[on])
        np.testing.assert_allclose(np.column_stack([x, y]), points[on], rtol=0, atol=1e-12)
    if name in ("disc", "ring"):
        assert all(isinstance(curve, Circle) for curve in domain.curves)
        assert not (domain.node_curve == FIXED).any()
        assert domain.area == pytest.approx(np.pi * (2.25 if name == "disc" else 3.0), rel=1e-12)


def test_cells_of_blocks_are_those_of_the_mesh() -> None:
    points, cells = MESHES["disc"]
    mesh = recover(points, cells, {}).mesh
    kept = mesh.block_cells
    del vars(mesh)["block_cells"]
    for one, other in zip(kept, mesh.block_cells, strict=True):
        np.testing.assert_array_equal(one, other)


def test_any_order_and_direction_gives_the_same_blocks_and_sides() -> None:
    points, cells = without(grid(8, 8), (0.5, 1, 0.5, 1))
    random, sides = np.random.default_rng(5), {"all": boundary_of((points, cells))}
    one = recover(points, cells, sides)
    shuffled = cells[random.permutation(len(cells))]
    shuffled[::2] = shuffled[::2, [0, 3, 2, 1]]
    other = recover(points, shuffled, {"all": random.permutation(sides["all"])[:, ::-1]})
    assert sorted(sorted(block.shape) for block in other.mesh.blocks) == sorted(
        sorted(block.shape) for block in one.mesh.blocks
    )
    assert {tuple(edge) for edge in other.mesh.sides["all"].tolist()} == {
        tuple(edge) for edge in one.mesh.sides["all"].tolist()
    }
    assert not other.mesh.is_folded


def test_a_mesh_of_one_cell_and_one_of_a_single_row() -> None:
    for mesh in (grid(1, 1), grid(7, 1)):
        domain = Blocks.of_mesh(*mesh, {})
        assert domain.layout.block_count == 1
        assert (domain.node_curve == FIXED).sum() == 4


def test_sides_get_other_names() -> None:
    points, cells = grid(3, 2)
    found = recover(points, cells, {}, names={"side_1": "wall", "side_3": "wall", "side_2": "out"})
    assert {name: len(edges) for name, edges in found.mesh.sides.items()} == {"wall": 6, "out": 2, "side_4": 2}
    with pytest.raises(InputError, match="names has 'low', but the sides are side_1, side_2"):
        recover(points, cells, {}, names={"low": "wall"})


def bad(mesh: Arrays, change: object) -> str:
    points, cells = mesh
    with pytest.raises(InputError) as caught:
        change(points, cells)  # type: ignore[operator]
    return f"{caught.value.field}: {caught.value.message}"


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda p, c: recover(p, c[:, :3], {}), "cells: cells has three columns, which are triangles"),
        (lambda p, c: recover(p, c + 1, {}), "cells: cells[3] has the nodes"),
        (lambda p, c: recover(p, c.astype(float), {}), "cells: cells has the shape (4, 4) and the type float64"),
        (lambda p, c: recover(p, c[:0], {}), "cells: cells is empty"),
        (lambda p, c: recover(p, c[:2], {}), "points: node 6 is in no cell"),
        (lambda p, c: recover(p[:, :1], c, {}), "points: points has shape (9, 1)"),
        (lambda p, c: recover(np.where(p > 0.7, np.nan, p), c, {}), "points: points[2][1] is NaN"),
        (lambda p, c: recover(1e200 * p, c, {}), "points: node 2 is at [0.0, 1e+200]: coordinates of at most"),
        (lambda p, c: recover(p, c, {"low": [[0, 12]]}), "sides.low: sides.low[0] has the nodes [0, 12]"),
    ],
)
def test_what_is_no_mesh_is_refused(change: object, told: str) -> None:
    assert told in bad(grid(2, 2), change)
