"""The cell of a mesh of quadrilaterals that holds a point, and the place of the point in it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from equimesh.meshes.cell_edges import QuadLinks, links_of
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array, IntArray, Pair

ROUNDING = 1e-12
"""How far beyond an edge, as a share of its length, a point may lie that counts as one of the cell."""
MAX_STEPS = 20
"""Steps of Newton's method, at most, to the place in a cell."""
MIN_STEP = 1e-8
"""The next step after a smaller one would be lost in rounding."""
FEW_STEPS, STEPS_ACROSS = 64, 8
"""Steps from cell to cell, at most: so many, and so many times the cells across a square mesh."""
NEAR_EDGE = 1e-9
"""A point this near to an edge, as a share of its length, may count as one of several cells: of a slit, too."""
MOVED_STEPS = 6
"""Steps, at most, from the cell that the point of the same number had in the call before."""
MAX_LOST, LOST_SHARE = 8, 4
"""Points that may be farther away than that: so many, and one of so many; then those cells are not tried."""
UNCLEAR, FAR = -1, -2
"""No cell surely holds a point: it is near to an edge or outside, or too many steps away."""
MAX_KEPT, MAX_CALLS = 1_000_000, 256
"""The cells of at most so many points are kept for the next such call, of at most so many different calls."""
WELL_INSIDE = 1e-4
"""A place this far from the sides of the unit square is in no other cell, whatever rounding does."""
BLOCK_POINTS = 256
"""Points that all take a step of Newton's method before the next."""
WORK_ROWS = 13
"""Rows of numbers of a block of points."""
X, Y, X0, X1, X2, X3, Y0, Y1, Y2, Y3, A, B, MOVING = range(0, BLOCK_POINTS * WORK_ROWS, BLOCK_POINTS)
"""Where the rows begin: the point, the corners of its cell, its place in the cell, and whether it still moves."""
MAX_BOXES = 4_000_000
"""Boxes, at most, into which cells are sorted."""


class Boxes(NamedTuple):
    """Equal rectangles around all nodes, each with the cells whose own boxes meet it."""

    low: Array
    """The least x and y of all nodes."""
    per_length: Array
    """Boxes per length, along x and y."""
    counts: IntArray
    """Boxes along x and y."""
    starts: IntArray
    """Where the entries of each box begin in ``entries``."""
    entries: IntArray
    """The cells of the boxes."""


class QuadPlaces(NamedTuple):
    """Where points lie: the number of the cell of each, and its place ``(s, t)`` in the unit square of that cell."""

    cell: IntArray
    s: Array
    t: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class KeptCells:
    """The cells of points in earlier calls of a search, from which the search in the next call can begin.

    A call is known by the number of its points and the place of the middle one: a descent moves its points little from
    call to call. No result of a search may depend on what is kept.
    """

    low: tuple[float, float]
    """The least x and y of all nodes."""
    per_length: tuple[float, float]
    """How many places along x and y are told apart per length."""
    cells: dict[tuple[int, int, int], IntArray] = field(default_factory=dict, repr=False)
    """The cells of each call."""

    @classmethod
    def of(cls, nodes: Pair, count: int) -> KeptCells:
        """For a mesh of so many cells with these ``nodes``."""
        (x, y), across = nodes, math.sqrt(count)
        return cls(low=(x.min(), y.min()), per_length=(across / np.ptp(x), across / np.ptp(y)))

    def call(self, points: Pair) -> tuple[int, int, int]:
        """What tells a call with these flat points from other ones."""
        size = points[0].size
        if not size:
            return 0, 0, 0
        at = [(q[size // 2] - low) * per for q, low, per in zip(points, self.low, self.per_length, strict=True)]
        i, j = (int(one) if abs(one) < MAX_BOXES else -1 for one in at)
        return size, i, j

    def keep(self, call: tuple[int, int, int], cells: IntArray) -> None:
        """Keep a copy of the ``cells`` of a call, whose last dimension is that of its points."""
        size = cells.shape[-1]
        if size > MAX_KEPT:
            return
        if call not in self.cells:
            kept = sum(points for points, *_ in list(self.cells))  # other threads may add to them
            if len(self.cells) >= MAX_CALLS or kept + size > MAX_KEPT:
                self.cells.clear()
        self.cells[call] = cells.copy()


@dataclass(frozen=True, kw_only=True, eq=False)
class QuadSearch:
    """Finds points in a valid mesh of quadrilaterals.

    The search goes from cell to neighbouring cell, from the cell of the point before. Where it meets the boundary, as
    at a hole, the cells nearby are tried, and at last the nearest edge of the boundary. A point well inside a cell is
    in no other one, so for such a point the search may begin anywhere: it begins in the cell that the point of the same
    number had in the last call with as many points around the same place.
    """

    nodes: Pair
    """x and y of the nodes."""
    links: QuadLinks
    boxes: Boxes
    edges: IntArray
    """The edges of the boundary, as ``4 cell + edge``."""
    corners: Array
    """x and y of the corners of every cell, shape ``(m, 4, 2)``."""
    kept: KeptCells
    """The cells of earlier calls."""

    @classmethod
    def of(cls, points: Array, cells: IntArray) -> QuadSearch:
        """From ``points`` of shape ``(n, 2)`` and ``cells`` of shape ``(m, 4)``, counter-clockwise."""
        links = links_of(cells, len(points))
        nodes = np.array(points[:, 0], dtype=float), np.array(points[:, 1], dtype=float)
        boxes, corners = boxes_of(nodes, links.cells), np.stack(nodes, axis=1)[links.cells]
        kept = KeptCells.of(nodes, len(cells))
        return cls(nodes=nodes, links=links, boxes=boxes, edges=links.boundary(), corners=corners, kept=kept)

    def find(self, x: Array, y: Array, beyond: float = 0.0) -> QuadPlaces:
        """The places of points, flat. A point outside of the mesh has that of the nearest point of the boundary.

        Such a place may lie ``beyond`` the unit square by this share of its side. The cell of a point that is not
        finite is -1.
        """
        points = np.array(x, dtype=float).reshape(-1), np.array(y, dtype=float).reshape(-1)
        size, call = points[0].size, self.kept.call(points)
        before = self.kept.cells.get(call)
        cells = np.full(size, -1) if before is None else before.copy()
        places = QuadPlaces(cells, np.empty(size), np.empty(size))
        of_mesh = self.nodes, self.links, self.boxes, self.edges, self.corners
        find_points(points, *of_mesh, beyond, places)
        self.kept.keep(call, cells)
        return places


def boxes_of(nodes: Pair, cells: IntArray) -> Boxes:
    """The cells in boxes, of which there are about as many as cells."""
    low = np.array([q.min() for q in nodes])
    size = np.array([q.max() for q in nodes]) - low
    count = min(len(cells), MAX_BOXES)
    across = np.sqrt(size[0] * size[1] / count)
    counts = np.clip(np.ceil(size / across), 1, count).astype(np.int64)
    per_length = counts / size
    starts = np.zeros(counts[0] * counts[1] + 1, dtype=np.int64)
    empty = Boxes(low, per_length, counts, starts, np.empty(0, dtype=np.int64))
    sort_cells(nodes, cells, empty, count_only=True)
    found = Boxes(low, per_length, counts, np.cumsum(starts), np.empty(starts.sum(), dtype=np.int64))
    sort_cells(nodes, cells, found, count_only=False)
    return found


@compiled
def sort_cells(nodes: Pair, cells: IntArray, boxes: Boxes, count_only: bool) -> None:
    """Add up how many cells meet each box, in the place after that of the box; or fill in the cells themselves."""
    x, y = nodes
    ends = boxes.starts.copy()
    for cell in range(cells.shape[0]):
        left = right = x[cells[cell, 0]]
        low = high = y[cells[cell, 0]]
        for corner in range(1, 4):
            node = cells[cell, corner]
            left, right = min(left, x[node]), max(right, x[node])
            low, high = min(low, y[node]), max(high, y[node])
        first_i, first_j = box_of(left, low, boxes)
        last_i, last_j = box_of(right, high, boxes)
        for i in range(first_i, last_i + 1):
            for j in range(first_j, last_j + 1):
                box = i * boxes.counts[1] + j
                if count_only:
                    boxes.starts[box + 1] += 1
                else:
                    boxes.entries[ends[box]] = cell
                    ends[box] += 1


@compiled
def box_of(px: float, py: float, boxes: Boxes) -> tuple[int, int]:
    """The box of a point, or the nearest one, as its numbers along x and y."""
    i = int(min(max((px - boxes.low[0]) * boxes.per_length[0], 0.0), boxes.counts[0] - 1.0))
    j = int(min(max((py - boxes.low[1]) * boxes.per_length[1], 0.0), boxes.counts[1] - 1.0))
    return i, j


@compiled
def find_points(
    points: Pair,
    nodes: Pair,
    links: QuadLinks,
    boxes: Boxes,
    edges: IntArray,
    corners: Array,
    beyond: float,
    places: QuadPlaces,
) -> None:
    """Fill in the places of points, whose cells are those where the search begins, or -1.

    It is fast where most points lie in the cells where it begins, or near these, or near the point before. What it
    begins with changes no place.
    """
    (px, py), cell, lost, w = points, 0, 0, np.empty(WORK_ROWS * BLOCK_POINTS)
    known, others = np.empty(BLOCK_POINTS, np.int64), np.empty(BLOCK_POINTS, np.int64)
    for begin in range(0, px.size, BLOCK_POINTS):
        end = min(begin + BLOCK_POINTS, px.size)
        size = rest = at = 0
        for p in range(begin, end):
            known[size] = p
            size += places.cell[p] >= 0 and np.isfinite(px[p]) and np.isfinite(py[p])
        place_block(points, corners, beyond, known[:size], places, w)
        for p in range(begin, end):
            if not (np.isfinite(px[p]) and np.isfinite(py[p])):
                places.cell[p], places.s[p], places.t[p] = -1, 0.0, 0.0
                continue
            if at < size and known[at] == p:
                s, t, is_moving = places.s[p], places.t[p], w[MOVING + at]
                at += 1
                if is_moving == 0.0 and min(min(s, t), 1.0 - max(s, t)) > WELL_INSIDE:
                    cell = places.cell[p]
                    continue
            found = FAR
            if places.cell[p] >= 0 and lost <= MAX_LOST + p // LOST_SHARE:
                found = walk_clear(px[p], py[p], corners, links.neighbours, places.cell[p], MOVED_STEPS)
                lost += found == FAR
            if found == FAR:
                found = walk_clear(px[p], py[p], corners, links.neighbours, cell, FEW_STEPS)
            if found < 0:
                found = find_cell(px[p], py[p], nodes, links, boxes, edges, cell)
            cell = found
            places.cell[p] = cell
            others[rest] = p
            rest += 1
        place_block(points, corners, beyond, others[:rest], places, w)


@compiled
def walk_clear(px: float, py: float, corners: Array, neighbours: IntArray, cell: int, steps: int) -> int:
    """The only cell that holds a point, found by at most so many steps from ``cell``; else ``UNCLEAR`` or ``FAR``."""
    for _ in range(steps):
        least, to, is_clear = 0.0, UNCLEAR, True
        for edge in range(4):
            after = (edge + 1) % 4
            ex, ey = corners[cell, after, 0] - corners[cell, edge, 0], corners[cell, after, 1] - corners[cell, edge, 1]
            inside = ex * (py - corners[cell, edge, 1]) - ey * (px - corners[cell, edge, 0])
            if not inside > NEAR_EDGE * (ex * ex + ey * ey):
                is_clear = False
                if inside < least and neighbours[cell, edge] >= 0:
                    least, to = inside, neighbours[cell, edge]
        if is_clear:
            return cell
        if to < 0:
            return UNCLEAR
        cell = to
    return FAR


@compiled
def find_cell(px: float, py: float, nodes: Pair, links: QuadLinks, boxes: Boxes, edges: IntArray, cell: int) -> int:
    """The cell that holds a point, or the one at the nearest edge of the boundary; the search begins at ``cell``."""
    found = walk_cells(px, py, nodes, links, cell)
    if found < 0:
        found = search_box(px, py, nodes, links.cells, boxes)
    if found < 0:
        found = nearest_edge(px, py, nodes, links.cells, edges) // 4
    return found


@compiled
def walk_cells(px: float, py: float, nodes: Pair, links: QuadLinks, cell: int) -> int:
    """The cell of a point, found by steps from cell to cell; -1 where the steps end at the boundary."""
    x, y = nodes
    cells, neighbours = links.cells, links.neighbours
    for _ in range(FEW_STEPS + STEPS_ACROSS * int(np.sqrt(cells.shape[0]))):  # more would be a circle
        worst, to, is_outside = -ROUNDING, -1, False
        for edge in range(4):
            a, b = cells[cell, edge], cells[cell, (edge + 1) % 4]
            ex, ey = x[b] - x[a], y[b] - y[a]
            beyond = (ex * (py - y[a]) - ey * (px - x[a])) / (ex * ex + ey * ey)
            if beyond < -ROUNDING:
                is_outside = True
                if beyond < worst and neighbours[cell, edge] >= 0:
                    worst, to = beyond, neighbours[cell, edge]
        if not is_outside:
            return cell
        if to < 0:
            return -1
        cell = to
    return -1


@compiled
def search_box(px: float, py: float, nodes: Pair, cells: IntArray, boxes: Boxes) -> int:
    """The cell of a point among those of its box; -1 where none holds it."""
    x, y = nodes
    i, j = box_of(px, py, boxes)
    box = i * boxes.counts[1] + j
    for at in range(boxes.starts[box], boxes.starts[box + 1]):
        cell, inside = boxes.entries[at], True
        for edge in range(4):
            a, b = cells[cell, edge], cells[cell, (edge + 1) % 4]
            ex, ey = x[b] - x[a], y[b] - y[a]
            if ex * (py - y[a]) - ey * (px - x[a]) < -ROUNDING * (ex * ex + ey * ey):
                inside = False
                break
        if inside:
            return int(cell)
    return -1


@compiled
def nearest_edge(px: float, py: float, nodes: Pair, cells: IntArray, edges: IntArray) -> int:
    """The edge of the boundary that is nearest to a point, as ``4 cell + edge``."""
    x, y = nodes
    best, least = edges[0], np.inf
    for at in range(edges.size):
        cell, edge = edges[at] // 4, edges[at] % 4
        a, b = cells[cell, edge], cells[cell, (edge + 1) % 4]
        ex, ey, qx, qy = x[b] - x[a], y[b] - y[a], px - x[a], py - y[a]
        along = min(max((qx * ex + qy * ey) / (ex * ex + ey * ey), 0.0), 1.0)
        distance = (qx - along * ex) ** 2 + (qy - along * ey) ** 2
        if distance < least:
            best, least = edges[at], distance
    return int(best)


@compiled
def place_block(points: Pair, corners: Array, beyond: float, which: IntArray, places: QuadPlaces, w: Array) -> None:
    """Fill in the places of a block of points in their cells by the bilinear maps; ``w`` is memory of their steps."""
    for k in range(which.size):
        p = which[k]
        c = places.cell[p]
        w[X + k], w[Y + k] = points[0][p], points[1][p]
        for corner in range(4):
            at = corner * BLOCK_POINTS + k
            w[X0 + at], w[Y0 + at] = corners[c, corner, 0], corners[c, corner, 1]
    invert_bilinear(w, which.size, MIN_STEP, beyond)
    for k in range(which.size):
        places.s[which[k]], places.t[which[k]] = w[A + k], w[B + k]


@compiled
def invert_bilinear(w: Array, count: int, smallest: float, beyond: float) -> None:
    """Fill in the places of a block of points in their cells, at most so far ``beyond`` the unit square.

    Newton's method ends with a step shorter than ``smallest``; those that have not ended have ``MOVING`` 1. All points
    take a step at once, those that have ended none: so the steps are vector instructions.
    """
    low, high = 0.0 - beyond, 1.0 + beyond
    for k in range(count):
        w[A + k], w[B + k], w[MOVING + k] = 0.5, 0.5, 1.0
    for _ in range(MAX_STEPS):
        for k in range(count):
            a, b, moving = w[A + k], w[B + k], w[MOVING + k]
            x0, x1, x2, x3 = w[X0 + k], w[X1 + k], w[X2 + k], w[X3 + k]
            y0, y1, y2, y3 = w[Y0 + k], w[Y1 + k], w[Y2 + k], w[Y3 + k]
            lower_x, upper_x = x0 + a * (x1 - x0), x3 + a * (x2 - x3)
            lower_y, upper_y = y0 + a * (y1 - y0), y3 + a * (y2 - y3)
            x_a, y_a = (1.0 - b) * (x1 - x0) + b * (x2 - x3), (1.0 - b) * (y1 - y0) + b * (y2 - y3)
            x_b, y_b = upper_x - lower_x, upper_y - lower_y
            r, q = w[X + k] - lower_x - b * x_b, w[Y + k] - lower_y - b * y_b
            det = x_a * y_b - x_b * y_a
            da, db = (r * y_b - q * x_b) / det, (q * x_a - r * y_a) / det
            w[A + k] = min(max(a + da, low), high) if moving > 0.0 else a
            w[B + k] = min(max(b + db, low), high) if moving > 0.0 else b
            w[MOVING + k] = 0.0 if abs(da) + abs(db) < smallest else moving
        left = False
        for k in range(count):
            if w[MOVING + k] > 0.0:
                left = True
                break
        if not left:
            break
