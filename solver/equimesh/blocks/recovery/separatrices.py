"""The blocks of a mesh of quadrilaterals: lines from its irregular nodes cut it into rectangles of cells.

A line goes straight on through regular nodes, to the boundary or to another irregular node. Lines may cross. What they
leave is rectangles, and closed rings, which are cut once.

Source: Bommes, Lempfer, Kobbelt: Global structure optimization of quadrilateral meshes, Computer Graphics Forum 30
(2011), section 3, "base complex".
"""

import numpy as np

from equimesh.blocks.recovery.half_edges import HalfEdges
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import BoolArray, IntArray


def blocks_of(edges: HalfEdges, vertices: BoolArray) -> tuple[list[IntArray], list[IntArray]]:
    """The numbers of the nodes of each block, shape ``(n_i, n_j)``, right-handed; and of its cells.

    Lines begin at irregular nodes and at the other ``vertices``, shape ``(n,)``, which are boundary nodes. The blocks
    are in the order of the lowest of their cells in a corner; in it, i runs from its first node to its second, where
    both are on a line. A closed ring without irregular nodes is cut at the first of its cells: its first and last row
    are the same nodes.
    """
    cells, twin = edges.cells, edges.twin
    starts = edges.irregular | vertices
    marked = trace(cells, twin, edges.leaving, edges.degree, starts)
    while (cut := first_of_ring(cells, twin, marked)) >= 0:
        here = np.zeros(len(starts), np.bool_)
        here[cut] = True
        marked |= trace(cells, twin, edges.leaving, edges.degree, here)
    shapes, firsts = block_shapes(twin, marked)
    sizes = shapes.prod(axis=1), (shapes - 1).prod(axis=1)
    nodes, own = block_nodes(cells, twin, shapes, firsts, int(sizes[0].sum()), int(sizes[1].sum()))
    return _cut(nodes, sizes[0], shapes), _cut(own, sizes[1], shapes - 1)


def _cut(flat: IntArray, sizes: IntArray, shapes: IntArray) -> list[IntArray]:
    """The parts of ``flat``, each in its shape."""
    ends = np.cumsum(sizes)
    places = zip((ends - sizes).tolist(), ends.tolist(), shapes.tolist(), strict=True)
    return [flat[first:end].reshape(shape) for first, end, shape in places]


@compiled
def trace(cells: IntArray, twin: IntArray, leaving: IntArray, degree: IntArray, starts: BoolArray) -> BoolArray:
    """Which half-edges are on the boundary, or on a line that begins at one of ``starts``; shape ``(4 m,)``."""
    marked = twin < 0
    for first in range(len(twin)):
        if not starts[cells[first >> 2, first & 3]]:
            continue
        h = first
        while not marked[h]:
            marked[h] = marked[twin[h]] = True
            end = cells[h >> 2, (h + 1) & 3]
            if leaving[end] >= 0 or degree[end] != 4:
                break
            across = twin[(h & ~3) | ((h + 1) & 3)]
            h = (across & ~3) | ((across + 1) & 3)
    return marked


@compiled
def first_of_ring(cells: IntArray, twin: IntArray, marked: BoolArray) -> int:
    """The first node on the rim of a closed ring of cells, which has no corner; -1 where there is no ring."""
    count = len(cells)
    seen, stack = np.zeros(count, np.bool_), np.empty(count, np.int64)
    for first in range(count):
        if seen[first]:
            continue
        seen[first], stack[0], size = True, first, 1
        corners, rim = 0, -1
        while size:
            size -= 1
            cell = stack[size]
            for k in range(4):
                h = 4 * cell + k
                if marked[h]:
                    corners += marked[4 * cell + (k + 3) % 4]
                    if rim < 0 or h < rim:
                        rim = h
                elif not seen[twin[h] >> 2]:
                    seen[twin[h] >> 2], stack[size] = True, twin[h] >> 2
                    size += 1
        if corners == 0:
            # The first corner of the cell, where the rim has it: there a structured grid has its seam.
            return int(cells[rim >> 2, 0 if rim & 3 == 3 else rim & 3])
    return -1


@compiled
def block_shapes(twin: IntArray, marked: BoolArray) -> tuple[IntArray, IntArray]:
    """The number of nodes of each block both ways, shape ``(b, 2)``, and the half-edge at its first corner."""
    count = len(twin) // 4
    seen, shapes, firsts, blocks = (
        np.zeros(count, np.bool_),
        np.empty((count, 2), np.int64),
        np.empty(count, np.int64),
        0,
    )
    for first in range(len(twin)):
        if seen[first >> 2] or not (marked[first] and marked[(first & ~3) | ((first + 3) & 3)]):
            continue
        rows, column = 1, first
        while True:
            columns, h = 1, column
            seen[h >> 2] = True
            while not marked[(h & ~3) | ((h + 1) & 3)]:
                across = twin[(h & ~3) | ((h + 1) & 3)]
                h = (across & ~3) | ((across + 1) & 3)
                seen[h >> 2] = True
                columns += 1
            above = (column & ~3) | ((column + 2) & 3)
            if marked[above]:
                break
            column = twin[above]
            rows += 1
        shapes[blocks], firsts[blocks] = (columns + 1, rows + 1), first
        blocks += 1
    return shapes[:blocks].copy(), firsts[:blocks].copy()


@compiled
def block_nodes(
    cells: IntArray, twin: IntArray, shapes: IntArray, firsts: IntArray, nodes: int, inside: int
) -> tuple[IntArray, IntArray]:
    """The nodes of all blocks one after the other, j fastest, and their cells in the same way."""
    found, own, at, cell = np.empty(nodes, np.int64), np.empty(inside, np.int64), 0, 0
    for b in range(len(shapes)):
        n_i, n_j = shapes[b]
        column = firsts[b]
        for j in range(n_j - 1):
            h = column
            for i in range(n_i - 1):
                own[cell + i * (n_j - 1) + j] = h >> 2
                place = at + i * n_j + j
                found[place] = cells[h >> 2, h & 3]
                found[place + n_j] = cells[h >> 2, (h + 1) & 3]
                found[place + n_j + 1] = cells[h >> 2, (h + 2) & 3]
                found[place + 1] = cells[h >> 2, (h + 3) & 3]
                if i < n_i - 2:
                    across = twin[(h & ~3) | ((h + 1) & 3)]
                    h = (across & ~3) | ((across + 1) & 3)
            if j < n_j - 2:
                column = twin[(column & ~3) | ((column + 2) & 3)]
        at += n_i * n_j
        cell += (n_i - 1) * (n_j - 1)
    return found, own
