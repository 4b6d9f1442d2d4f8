"""Strips of rows, and the binary tree over them by which sums over all rows are added.

A strip is a block of rows whose intermediate arrays stay in the cache. Strips depend on the grid alone, and so does the
tree: the strips ``first`` to ``last - 1`` are cut in the middle into two nodes, until a node is one strip. A sum over
all rows is added up this tree, whoever adds it; so no result depends on the number of threads or of parts, to the last
bit.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from equimesh.errors import InputError
from equimesh.numerics.types import IntArray

# Nodes of a strip of rows: its intermediate arrays stay in the cache.
STRIP_NODES = 32_768
# Rows of a strip, at least: each strip also reads one row beyond either end.
MIN_STRIP_ROWS = 16
# Parts whose number is no power of two are cut at nodes that are deeper in the tree by so much: their sizes are then
# nearly equal, and few sums travel.
EXTRA_DEPTH = 2


class Node(NamedTuple):
    """The strips ``first`` to ``last - 1``, cut before the strip ``middle``."""

    first: int
    middle: int
    last: int

    @classmethod
    def of(cls, first: int, last: int) -> Node:
        """The node of these strips; one strip is not cut, and has itself for ``middle``."""
        return cls(first, (first + last) // 2, last)


@lru_cache(maxsize=256)
def strips_of(shape: tuple[int, int]) -> tuple[tuple[int, int], ...]:
    """The first row and the row after the last one of each strip: all rows but the first and the last of the grid."""
    rows, columns = shape
    height = max(MIN_STRIP_ROWS, -(-STRIP_NODES // columns))
    return tuple((first, min(first + height, rows - 1)) for first in range(1, rows - 1, height))


@lru_cache(maxsize=256)
def cuts_of(strips: int, parts: int) -> tuple[int, ...]:
    """The first strip of each of ``parts`` parts, and the number of ``strips``.

    Parts are cut at nodes of the tree. Those of a power of two in number are nodes themselves; others have nearly equal
    numbers of strips. Raises :class:`~equimesh.errors.InputError` for more parts than strips.
    """
    if not 1 <= parts <= strips:
        raise InputError(f"the rows of this grid can be cut into at most {strips} parts, not {parts}", field="parts")
    depth = (parts - 1).bit_length()
    if parts == 2**depth:
        return 0, *(node.middle for node in _inner_nodes(strips, depth)), strips
    ends = sorted({0, strips, *(node.middle for node in _inner_nodes(strips, depth + EXTRA_DEPTH))})
    return tuple(min(ends, key=lambda end: abs(end * parts - k * strips)) for k in range(parts + 1))


def _inner_nodes(strips: int, depth: int) -> list[Node]:
    """The nodes of fewer than ``depth`` cuts that have more than one strip, in the order of their middles."""
    found: list[Node] = []

    def visit(node: Node, level: int) -> None:
        if level < depth and node.last - node.first > 1:
            visit(Node.of(node.first, node.middle), level + 1)
            found.append(node)
            visit(Node.of(node.middle, node.last), level + 1)

    visit(Node.of(0, strips), 0)
    return found


@lru_cache(maxsize=1024)
def nodes_inside(strips: int, first: int, last: int) -> tuple[Node, ...]:
    """The largest nodes of the tree over ``strips`` strips that lie within these, in their order."""
    found: list[Node] = []

    def visit(node: Node) -> None:
        if first <= node.first and node.last <= last:
            found.append(node)
        elif node.first < last and first < node.last:
            visit(Node.of(node.first, node.middle))
            visit(Node.of(node.middle, node.last))

    visit(Node.of(0, strips))
    return tuple(found)


@lru_cache(maxsize=1024)
def nodes_across(strips: int, cuts: tuple[int, ...]) -> tuple[Node, ...]:
    """The nodes that lie in more than one part, each before the nodes inside it; ``cuts`` as of :func:`cuts_of`."""
    found: list[Node] = []

    def visit(node: Node) -> None:
        if any(node.first < cut < node.last for cut in cuts):
            found.append(node)
            visit(Node.of(node.first, node.middle))
            visit(Node.of(node.middle, node.last))

    visit(Node.of(0, strips))
    return tuple(found)


@lru_cache(maxsize=1024)
def subtree(first: int, last: int) -> IntArray:
    """All nodes of more than one strip in the node of these strips, shape ``(k, 3)``, each before those inside it."""
    found: list[Node] = []

    def visit(node: Node) -> None:
        if node.last - node.first > 1:
            found.append(node)
            visit(Node.of(node.first, node.middle))
            visit(Node.of(node.middle, node.last))

    visit(Node.of(first, last))
    return np.array(found, dtype=np.int64).reshape(-1, 3)
