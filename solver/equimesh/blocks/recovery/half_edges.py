"""The half-edges of a mesh of quadrilaterals: which cells meet, where the boundary is, and checks that name a place.

Half-edge ``4 c + k`` leads from corner ``k`` of cell ``c`` to the next corner, with the cell on its left.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from equimesh.errors import InputError
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array, BoolArray, IntArray

# What is wrong with a pair of half-edges.
SAME_DIRECTION, THREE_CELLS = 1, 2
# A corner of a cell counts as flat where its cross product is below this part of the lengths of its edges.
FLAT = 1e-12


@dataclass(frozen=True, kw_only=True, eq=False)
class HalfEdges:
    """How the cells of a mesh meet.

    - ``cells``: the nodes of each cell, counter-clockwise, shape ``(m, 4)``.
    - ``twin``: for each half-edge the one of the other cell, shape ``(4 m,)``; -1 at the boundary.
    - ``degree``: the number of cells around each node, shape ``(n,)``.
    - ``leaving``: the boundary half-edge that leaves each node, shape ``(n,)``; -1 inside.
    """

    cells: IntArray
    twin: IntArray
    degree: IntArray
    leaving: IntArray

    @classmethod
    def of(cls, points: Array, cells: IntArray) -> HalfEdges:
        """The half-edges of ``cells``, shape ``(m, 4)``, counter-clockwise, between ``points``, shape ``(n, 2)``.

        Raises :class:`~equimesh.errors.InputError` for a cell that is not convex, cells that overlap, an edge of three
        cells, a node where the domain only touches itself, and a mesh of several pieces. The message names the place.
        """
        bad = first_bad_corner(points, cells)
        if bad >= 0:
            raise InputError(_folded(points, cells, bad), field="cells")
        twin, fault, one, other = match_edges(cells, len(points))
        if fault:
            raise InputError(_mismatch(points, cells, fault, one, other), field="cells")
        degree = np.bincount(cells.ravel(), minlength=len(points)).astype(np.int64)
        leaving, pinched = leaving_edges(cells, twin, len(points))
        if pinched >= 0:
            message = (
                f"the domain touches itself at {_node(points, pinched)}, or a cell ends there in the middle of the edge"
                " of another cell: every edge must be shared whole by two cells"
            )
            raise InputError(message, field="cells")
        apart = first_apart(twin)
        if apart >= 0:
            message = (
                f"the mesh has several pieces: cell {apart}, {_place(points, cells[apart])}, is not connected with"
                f" cell 0, {_place(points, cells[0])}: merge the nodes that both have, or send one piece"
            )
            raise InputError(message, field="cells")
        return cls(cells=cells, twin=twin, degree=degree, leaving=leaving)

    @property
    def boundary(self) -> BoolArray:
        """Which nodes are on the boundary, shape ``(n,)``."""
        return np.asarray(self.leaving >= 0)

    @property
    def irregular(self) -> BoolArray:
        """Which nodes have another number of cells than 4 inside, and 2 on the boundary."""
        return np.asarray(self.degree != np.where(self.leaving >= 0, 2, 4))

    def loops(self) -> list[IntArray]:
        """The closed lines of the boundary, each as its nodes in order, with the domain on the left.

        Each begins with the boundary edge of the lowest cell, and they are in the order of these cells.
        """
        nodes, ends = boundary_loops(self.cells, self.twin, self.leaving)
        return np.split(nodes, ends[:-1])


def counter_clockwise(points: Array, cells: IntArray) -> IntArray:
    """The cells, those that are clockwise turned around; the first node of each stays the first."""
    a, b, c, d = (points[cells[:, k]] for k in range(4))
    one, other = c - a, d - b
    turned = one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0] < 0.0
    if not turned.any():
        return cells
    result = cells.copy()
    result[turned, 1], result[turned, 3] = cells[turned, 3], cells[turned, 1]
    return result


@compiled
def first_bad_corner(points: Array, cells: IntArray) -> int:
    """The first corner ``4 c + k`` at which a cell is not strictly convex; -1 where there is none."""
    for c in range(len(cells)):
        for k in range(4):
            at, after, before = cells[c, k], cells[c, (k + 1) % 4], cells[c, (k + 3) % 4]
            ax, ay = points[after, 0] - points[at, 0], points[after, 1] - points[at, 1]
            bx, by = points[before, 0] - points[at, 0], points[before, 1] - points[at, 1]
            cross = ax * by - ay * bx
            if not (cross > 0.0 and cross * cross > FLAT * FLAT * (ax * ax + ay * ay) * (bx * bx + by * by)):
                return 4 * c + k
    return -1


@compiled
def match_edges(cells: IntArray, count: int) -> tuple[IntArray, int, int, int]:
    """The twin of each half-edge, and the first fault: its kind, 0 for none, and the two half-edges."""
    head, following = np.full(count, -1), np.empty(4 * len(cells), np.int64)
    twin = np.full(4 * len(cells), -1)
    for h in range(4 * len(cells)):
        start, end = cells[h >> 2, h & 3], cells[h >> 2, (h + 1) & 3]
        low, high = min(start, end), max(start, end)
        found = head[low]
        while found >= 0:
            one, other = cells[found >> 2, found & 3], cells[found >> 2, (found + 1) & 3]
            if max(one, other) == high:
                if twin[found] >= 0:
                    return twin, THREE_CELLS, found, h
                if one == start:
                    return twin, SAME_DIRECTION, found, h
                twin[found], twin[h] = h, found
                break
            found = following[found]
        if found < 0:
            following[h] = head[low]
            head[low] = h
    return twin, 0, -1, -1


@compiled
def leaving_edges(cells: IntArray, twin: IntArray, count: int) -> tuple[IntArray, int]:
    """The boundary half-edge that leaves each node, -1 inside; and the first node that two of them leave, or -1."""
    leaving = np.full(count, -1)
    for h in range(len(twin)):
        if twin[h] < 0:
            start = cells[h >> 2, h & 3]
            if leaving[start] >= 0:
                return leaving, start
            leaving[start] = h
    return leaving, -1


@compiled
def first_apart(twin: IntArray) -> int:
    """The first cell that cannot be reached from cell 0 through edges; -1 where all are reached."""
    count = len(twin) // 4
    seen, stack = np.zeros(count, np.bool_), np.empty(count, np.int64)
    seen[0], stack[0], size = True, 0, 1
    while size:
        size -= 1
        cell = stack[size]
        for k in range(4):
            other = twin[4 * cell + k] >> 2
            if other >= 0 and not seen[other]:
                seen[other], stack[size] = True, other
                size += 1
    for c in range(count):
        if not seen[c]:
            return c
    return -1


@compiled
def boundary_loops(cells: IntArray, twin: IntArray, leaving: IntArray) -> tuple[IntArray, IntArray]:
    """The nodes of all closed lines of the boundary one after the other, and the place after the last of each."""
    done = np.zeros(len(leaving), np.bool_)
    nodes, ends, count, loops = np.empty(len(leaving), np.int64), np.empty(len(leaving), np.int64), 0, 0
    for h in range(len(twin)):
        node = cells[h >> 2, h & 3]
        if twin[h] >= 0 or done[node]:
            continue
        while not done[node]:
            done[node], nodes[count] = True, node
            count += 1
            edge = leaving[node]
            node = cells[edge >> 2, (edge + 1) & 3]
        ends[loops] = count
        loops += 1
    return nodes[:count].copy(), ends[:loops].copy()


def _node(points: Array, node: int) -> str:
    """A node and its place, for a message."""
    x, y = points[node]
    return f"node {node} at ({x:.6g}, {y:.6g})"


def _place(points: Array, nodes: IntArray) -> str:
    """The place of a cell, for a message."""
    x, y = points[nodes].mean(axis=0)
    return f"with the nodes {nodes.tolist()} near ({x:.6g}, {y:.6g})"


def _folded(points: Array, cells: IntArray, corner: int) -> str:
    cell, k = divmod(corner, 4)
    return (
        f"cell {cell}, {_place(points, cells[cell])}, is folded or flat at {_node(points, cells[cell, k])}:"
        " every corner of a cell must be convex; repair the mesh there"
    )


def _mismatch(points: Array, cells: IntArray, fault: int, one: int, other: int) -> str:
    edge = [int(cells[other >> 2, other & 3]), int(cells[other >> 2, (other + 1) & 3])]
    x, y = points[edge].mean(axis=0)
    where = f"the edge between the nodes {edge[0]} and {edge[1]} near ({x:.6g}, {y:.6g})"
    if fault == THREE_CELLS:
        return (
            f"{where} belongs to more than two cells, {one >> 2} and {other >> 2} among them: remove the doubled cell"
        )
    return (
        f"the cells {one >> 2} and {other >> 2} lie on the same side of {where}: the mesh is folded there, or a cell"
        " is doubled; repair the mesh"
    )


# The blocks of a mesh of quadrilaterals: lines from its irregular nodes cut it into rectangles of cells.
#
# A line goes straight on through regular nodes, to the boundary or to another irregular node. Lines may cross. What
# they leave is rectangles, and closed rings, which are cut once.
#
# Source: Bommes, Lempfer, Kobbelt: Global structure optimization of quadrilateral meshes, Computer Graphics Forum 30
# (2011), section 3, "base complex".


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
        shapes[blocks, 0], shapes[blocks, 1], firsts[blocks] = columns + 1, rows + 1, first
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
