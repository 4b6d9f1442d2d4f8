"""What lies along the edges of blocks."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from block_cases import changed, channel, in_blocks, l_shape
from equimesh.meshes.interfaces import EDGES, Contact, contacts
from equimesh.meshes.mesh import Mesh
from solver.quality.handmade import wavy


def nodes_of(mesh: Mesh, block: int, edge: int, first: int, last: int) -> list[int]:
    lines = mesh.blocks[block][0], mesh.blocks[block][-1], mesh.blocks[block][:, 0], mesh.blocks[block][:, -1]
    step = 1 if last > first else -1
    return [int(lines[edge][k]) for k in range(first, last + step, step)]


def interfaces(mesh: Mesh) -> list[tuple[list[int], list[int]]]:
    return [
        (
            nodes_of(mesh, one.block, one.edge, one.first, one.last),
            nodes_of(mesh, one.other, one.other_edge, one.other_first, one.other_last),
        )
        for one in contacts(mesh)
        if one.side is None
    ]


def covered(mesh: Mesh) -> int:
    """The edges of cells that the contacts cover, with those of both blocks of an interface."""
    return sum((one.last - one.first) * (1 if one.side else 2) for one in contacts(mesh))


def test_interfaces_meet_in_the_same_nodes_and_all_edges_are_covered() -> None:
    for mesh in (l_shape(), in_blocks(wavy()).mesh):
        assert all(one == two for one, two in interfaces(mesh))
        assert len(interfaces(mesh)) == len(mesh.blocks) - 1
        assert covered(mesh) == sum(2 * (sum(block.shape) - 2) for block in mesh.blocks)
        for one in contacts(mesh):
            if one.side:
                line = nodes_of(mesh, one.block, one.edge, one.first, one.last)
                of_side = {frozenset(edge) for edge in mesh.sides[one.side].tolist()}
                assert {frozenset(pair) for pair in pairwise(line)} <= of_side


def test_a_turned_block_is_counted_in_the_other_direction() -> None:
    (found,) = [one for one in contacts(in_blocks(wavy()).mesh) if one.side is None]
    assert EDGES[found.edge] == "i_max"
    assert EDGES[found.other_edge].startswith("j")
    assert abs(found.other_last - found.other_first) == found.last - found.first == 8


def test_joined_sides_are_an_interface_of_the_block_with_itself() -> None:
    mesh = channel()
    found = contacts(mesh)
    assert found[0] == Contact(block=0, edge=0, first=0, last=4, other=0, other_edge=1, other_first=0, other_last=4)
    assert [one.side for one in found[1:]] == ["floor", "roof"]


def test_an_edge_may_touch_several_sides() -> None:
    mesh = l_shape()
    wall = mesh.sides["wall"]
    parted = changed(mesh, sides={**mesh.sides, "wall": wall[2:], "valve": wall[:2]})
    along = [(one.first, one.last, one.side) for one in contacts(parted) if (one.block, one.edge) == (0, 2)]
    assert along == [(0, 2, "valve"), (2, 4, "wall")]
    assert np.array_equal(mesh.points, parted.points)
