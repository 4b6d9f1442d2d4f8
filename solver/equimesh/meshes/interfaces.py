"""Neighbours along the four edges of each block of a mesh: other blocks, and named sides."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from equimesh.meshes.cell_edges import CellEdges, originals_of
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.types import IntArray

EDGES: Final = ("i_min", "i_max", "j_min", "j_max")
"""The edges of a block, in the order of their numbers. Nodes are counted along j on the first two, then along i."""


@dataclass(frozen=True, kw_only=True)
class Contact:
    """The nodes ``first`` to ``last`` of the ``edge`` of a block, and what lies there.

    That is the side with the name ``side``, or the nodes ``other_first`` to ``other_last`` of the edge ``other_edge``
    of the block ``other``; they fall where the two are counted in opposite directions. Numbers begin at 0.
    """

    block: int
    edge: int
    first: int
    last: int
    side: str | None = None
    other: int = -1
    other_edge: int = -1
    other_first: int = 0
    other_last: int = 0


@dataclass(frozen=True)
class _Line:
    """The nodes along one edge of a block, by their originals, and the numbers of the edges of the mesh there."""

    block: int
    edge: int
    nodes: IntArray
    numbers: IntArray


def contacts(mesh: Mesh) -> tuple[Contact, ...]:
    """The contacts of all blocks, those of periodic joins among them; each of two blocks once, from the first one."""
    lines = [*_lines(mesh)]
    at: dict[int, list[tuple[int, int]]] = {}
    for number, line in enumerate(lines):
        for k, edge in enumerate(line.numbers.tolist()):
            at.setdefault(edge, []).append((number, k))
    sides = {(a, b): name for name, edges in mesh.sides.items() for a, b in edges.tolist()}
    sides |= {(b, a): name for (a, b), name in sides.items()}
    found: list[Contact] = []
    for number, line in enumerate(lines):
        raw = _nodes_along(mesh.blocks[line.block])[line.edge].tolist()
        for k, edge in enumerate(line.numbers.tolist()):
            others = [place for place in at[edge] if place != (number, k)]
            if not others:
                new = _on_side(line, k, sides.get((raw[k], raw[k + 1]), ""))
            elif others[0] < (number, k):
                continue
            else:
                new = _on_block(line, k, lines[others[0][0]], others[0][1])
            found[-1:] = _joined(found[-1], new) if found else [new]
    return tuple(found)


def _lines(mesh: Mesh) -> Iterator[_Line]:
    edges = CellEdges.of(mesh.cells, len(mesh.points), mesh.ties)
    originals = originals_of(len(mesh.points), mesh.ties)
    for block, (numbers, cells) in enumerate(zip(mesh.blocks, mesh.block_cells, strict=True)):
        beside = (cells[0], cells[-1], cells[:, 0], cells[:, -1])
        for edge, (nodes, there) in enumerate(zip(_nodes_along(numbers), beside, strict=True)):
            corners = mesh.cells[there]
            ahead, one, two = np.roll(corners, -1, axis=1), nodes[:-1, None], nodes[1:, None]
            here = ((corners == one) & (ahead == two)) | ((corners == two) & (ahead == one))
            found = edges.of_cells[there, here.argmax(axis=1)]
            yield _Line(block, edge, originals[nodes], found)


def _nodes_along(block: IntArray) -> tuple[IntArray, IntArray, IntArray, IntArray]:
    return block[0], block[-1], block[:, 0], block[:, -1]


def _on_side(line: _Line, k: int, name: str) -> Contact:
    return Contact(block=line.block, edge=line.edge, first=k, last=k + 1, side=name)


def _on_block(line: _Line, k: int, other: _Line, there: int) -> Contact:
    rises = line.nodes[k] == other.nodes[there]
    ends = (there, there + 1) if rises else (there + 1, there)
    return Contact(
        block=line.block,
        edge=line.edge,
        first=k,
        last=k + 1,
        other=other.block,
        other_edge=other.edge,
        other_first=ends[0],
        other_last=ends[1],
    )


def _joined(one: Contact, two: Contact) -> list[Contact]:
    """The two contacts, as one where the second continues the first."""
    continues = (one.block, one.edge, one.last) == (two.block, two.edge, two.first) and one.side == two.side
    if continues and two.side is None:
        steps = one.other_last - one.other_first, two.other_last - two.other_first
        there = (one.other, one.other_edge, one.other_last) == (two.other, two.other_edge, two.other_first)
        continues = there and (steps[0] > 0) == (steps[1] > 0)
    return [replace(one, last=two.last, other_last=two.other_last)] if continues else [one, two]
