"""The cell of a mesh of quadrilaterals that holds a point, and the place of the point in it."""

from __future__ import annotations

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
"""A point this near to an edge, as a share of its length, may count as one of several cells."""
ON_SIDE = -0.5 * ROUNDING
"""The same for an edge of the boundary, which has no other cell beyond it."""
MOVED_STEPS = 6
"""Steps, at most, from the cell that the point of the same number had in the call before."""
MAX_LOST, LOST_SHARE = 8, 4
"""Points that may be farther away than that: so many, and one of so many; then those cells are not tried."""
UNCLEAR, FAR = -1, -2
"""No cell surely holds a point: it is near to an edge or outside, or too many steps away."""
MAX_KEPT, MAX_CALLS = 32_768, 64
"""The cells of at most so many points are kept for the next such call, for at most so many different calls."""
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
class QuadSearch:
    """Finds points in a valid mesh of quadrilaterals.

    The search goes from cell to neighbouring cell, from the cell of the point before. Where it meets the boundary, as
    at a hole, the cells nearby are tried, and at last the nearest edge of the boundary. A point well inside a cell is
    in no other one, so for such a point the search may begin anywhere: it begins in the cell that the point of the same
    number had in the last call with as many points around the same place. A descent moves its points little from call
    to call.
    """

    nodes: Pair
    """x and y of the nodes."""
    links: QuadLinks
    boxes: Boxes
    edges: IntArray
    """The edges of the boundary, as ``4 cell + edge``."""
    corners: Array
    """x and y of the corners of every cell, shape ``(m, 4, 2)``."""
    before: dict[tuple[int, int, int], IntArray] = field(default_factory=dict, repr=False)
    """The cells of the last call with so many points whose middle one was in this box. No result depends on them."""

    @classmethod
    def of(cls, points: Array, cells: IntArray) -> QuadSearch:
        """From ``points`` of shape ``(n, 2)`` and ``cells`` of shape ``(m, 4)``, counter-clockwise."""
        links = links_of(cells, len(points))
        nodes = np.array(points[:, 0], dtype=float), np.array(points[:, 1], dtype=float)
        boxes, corners = boxes_of(nodes, links.cells), np.stack(nodes, axis=1)[links.cells]
        return cls(nodes=nodes, links=links, boxes=boxes, edges=links.boundary(), corners=corners)

    def find(self, x: Array, y: Array, beyond: float = 0.0) -> QuadPlaces:
        """The places of points, flat. A point outside of the mesh has that of the nearest point of the boundary.

        Such a place may lie ``beyond`` the unit square by this share of its side. The cell of a point that is not
        finite is -1.
        """
        points = tuple(np.array(q, dtype=float).reshape(-1) for q in (x, y))
        size = points[0].size
        call = (size, *box_of(points[0][size // 2], points[1][size // 2], self.boxes)) if size else (0, 0, 0)
        before = self.before.get(call)
        cells = np.full(size, -1) if before is None else before.copy()
        places = QuadPlaces(cells, np.empty(size), np.empty(size))
        of_mesh = self.nodes, self.links, self.boxes, self.edges, self.corners
        find_points((points[0], points[1]), *of_mesh, beyond, places)
        if size <= MAX_KEPT:
            if before is None and len(self.before) >= MAX_CALLS:
                self.before.clear()
            self.before[call] = cells.copy()
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

    It is fast where each point is near such a cell, or near the point before it. What it begins with changes no place.
    """
    (px, py), cell, lost = points, 0, 0
    for p in range(px.size):
        if not (np.isfinite(px[p]) and np.isfinite(py[p])):
            places.cell[p], places.s[p], places.t[p] = -1, 0.0, 0.0
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
        places.s[p], places.t[p] = place_in(px[p], py[p], corners[cell], beyond)


@compiled
def walk_clear(px: float, py: float, corners: Array, neighbours: IntArray, cell: int, steps: int) -> int:
    """The only cell that holds a point, found by at most so many steps from ``cell``; else ``UNCLEAR`` or ``FAR``."""
    for _ in range(steps):
        least, to, is_clear = 0.0, UNCLEAR, True
        for edge in range(4):
            after = (edge + 1) % 4
            ex, ey = corners[cell, after, 0] - corners[cell, edge, 0], corners[cell, after, 1] - corners[cell, edge, 1]
            inside = ex * (py - corners[cell, edge, 1]) - ey * (px - corners[cell, edge, 0])
            is_outer = neighbours[cell, edge] < 0
            if not inside > (ON_SIDE if is_outer else NEAR_EDGE) * (ex * ex + ey * ey):
                is_clear = False
                if inside < least and not is_outer:
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
def place_in(px: float, py: float, corners: Array, beyond: float) -> tuple[float, float]:
    """The place of a point in the unit square of a cell by its bilinear map; at most so far ``beyond`` the square."""
    x0, x1, x2, x3 = corners[0, 0], corners[1, 0], corners[2, 0], corners[3, 0]
    y0, y1, y2, y3 = corners[0, 1], corners[1, 1], corners[2, 1], corners[3, 1]
    s = t = 0.5
    for _ in range(MAX_STEPS):
        lower_x, upper_x = x0 + s * (x1 - x0), x3 + s * (x2 - x3)
        lower_y, upper_y = y0 + s * (y1 - y0), y3 + s * (y2 - y3)
        x_s, y_s = (1.0 - t) * (x1 - x0) + t * (x2 - x3), (1.0 - t) * (y1 - y0) + t * (y2 - y3)
        x_t, y_t = upper_x - lower_x, upper_y - lower_y
        r, q = px - lower_x - t * x_t, py - lower_y - t * y_t
        det = x_s * y_t - x_t * y_s
        ds, dt = (r * y_t - q * x_t) / det, (q * x_s - r * y_s) / det
        s, t = min(max(s + ds, -beyond), 1.0 + beyond), min(max(t + dt, -beyond), 1.0 + beyond)
        if abs(ds) + abs(dt) < MIN_STEP:
            break
    return s, t
