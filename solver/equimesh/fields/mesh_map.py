"""The map of a structured mesh from its grid to the plane, as a bicubic spline through the nodes, and its inverse.

Grid coordinates ``(s, t)`` count cells: node ``(i, j)`` is at ``s = i, t = j``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy

from equimesh.errors import InputError
from equimesh.fields.bicubic import ORDER, Axis, Bicubic, at_patch, at_piece, buckets_per_length, piece, slopes_at_piece
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.quad_search import (
    BLOCK_POINTS,
    WORK_ROWS,
    X0,
    X1,
    X2,
    X3,
    Y0,
    Y1,
    Y2,
    Y3,
    A,
    B,
    X,
    Y,
    invert_bilinear,
)
from equimesh.numerics.compiled import compiled, inlined, vectorised
from equimesh.numerics.types import Array, BoolArray, IntPair, Pair

MAX_STEPS = 20  # of Newton's method
MIN_START_STEP_CELLS = 0.01  # near enough to start Newton's method on the splines
MIN_STEP_CELLS = 1e-8  # the next step after a smaller one would be lost in rounding
MAX_DISTANCE_CELLS = 1.0  # between the point by the spline and by the bilinear cell that holds it
RIM_SHARE = 0.25  # of the length of a cell: how far from its edge a curved side may lie
MAX_HOPS = 3  # from cell to cell, before a point is looked for by itself
MAX_HOP = 64  # cells
INSIDE, RIM = X, Y  # rows of a search of cells, once the point is no longer needed
EDGE_SHARE = 1e-9  # of its size: a point so near to an edge of a cell is looked for by itself, too
NO_PATCHES = np.empty((0, 0, ORDER, ORDER))
PATCH_POINTS = 64  # whose polynomials are next to each other in the fastest cache
MAX_PATCH_STEPS = 5
# Where the same begin for points that stay on their piece of the splines: the polynomials of x and y, the point, its
# place from the begin of the piece, where that was at first, the end of the piece, and whether it moves, and has left.
PATCH_ROWS = 42
OF_X, OF_Y = 0, 16 * PATCH_POINTS
PX, PY, PA, PB, A0, B0, END_A, END_B, GOES, LEFT = range(32 * PATCH_POINTS, PATCH_ROWS * PATCH_POINTS, PATCH_POINTS)


class Places(NamedTuple):
    """Grid coordinates of points, flat arrays; where not ``smooth`` they are those of the bilinear cells."""

    s: Array
    t: Array
    smooth: BoolArray


class MapSplines(NamedTuple):
    """The splines of x and y over the grid coordinates: their axes, and their coefficients.

    ``patches`` are the coefficients of their polynomials, empty where these would be too many.
    """

    along_s: Axis
    along_t: Axis
    of_x: Array
    of_y: Array
    patches: Pair


def require_unfolded(mesh: Mesh) -> None:
    """Raise :class:`~equimesh.errors.InputError` for a folded mesh."""
    if mesh.is_folded:
        raise InputError(
            "the mesh is folded, or has a coordinate that is not finite: no function on its nodes is one of x and"
            " y; give a mesh whose min_jacobian is positive: x and y of a grid have xi first, as from"
            " numpy.meshgrid(..., indexing='ij')",
            field="mesh",
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class MeshMap:
    """The bicubic splines through the node coordinates of ``mesh``, and their inverse.

    For a mesh that is the image of its grid under a smooth map, the spline differs from that by O(h^4). Raises
    :class:`~equimesh.errors.InputError` for a folded mesh, whose map has no inverse.
    """

    mesh: Mesh
    x: Bicubic
    y: Bicubic

    @classmethod
    def of(cls, mesh: Mesh) -> MeshMap:
        """The map of a mesh."""
        require_unfolded(mesh)
        mesh = Mesh(np.ascontiguousarray(mesh.x, dtype=float), np.ascontiguousarray(mesh.y, dtype=float))
        return cls(mesh=mesh, x=through(mesh.x), y=through(mesh.y))

    def locate(self, x: Array, y: Array) -> Places:
        """The grid coordinates of points, flat; for a point outside the mesh, those of the nearest point of its side.

        They are 0 for points that are not finite.
        """
        points, _, columns = known_points(x, y, self.mesh)
        places = Places(np.empty(points[0].size), np.empty(points[0].size), np.empty(points[0].size, dtype=np.bool_))
        locate_points(points, (self.mesh.x, self.mesh.y), self._splines, columns, places)
        return places

    @property
    def _splines(self) -> MapSplines:
        of_x, of_y = self.x.polynomials, self.y.polynomials
        patches = (NO_PATCHES, NO_PATCHES) if of_x is None or of_y is None else (of_x, of_y)
        return MapSplines(self.x.along_x, self.x.along_y, self.x.coefficients, self.y.coefficients, patches)


def through(values: Array) -> Bicubic:
    """The bicubic spline through values at all nodes, over the grid coordinates."""
    s, t = (np.arange(float(n)) for n in values.shape)
    return Bicubic.of(scipy.interpolate.RectBivariateSpline(s, t, values, s=0), often=True)


def known_points(x: Array, y: Array, mesh: Mesh) -> tuple[Pair, BoolArray | None, int]:
    """Points as flat arrays, those that are not finite at a node of ``mesh``; which these are, or None; and columns.

    ``columns`` is the length of a row of the points: their last dimension.
    """
    columns, x, y = x.shape[-1] if x.ndim else 1, np.ravel(x), np.ravel(y)
    lost = ~(np.isfinite(x) & np.isfinite(y))
    if not lost.any():
        return (np.ascontiguousarray(x, dtype=float), np.ascontiguousarray(y, dtype=float)), None, columns
    return (np.where(lost, mesh.x[0, 0], x), np.where(lost, mesh.y[0, 0], y)), lost, columns


@compiled
def locate_points(points: Pair, nodes: Pair, splines: MapSplines, columns: int, places: Places) -> None:
    """Fill in the grid coordinates of points, which come in rows of ``columns``."""
    (px, py), (s, t, smooth) = points, places
    n = px.size
    cells, starts = (np.full(n, -1), np.full(n, -1)), (np.empty(n), np.empty(n))
    find_cells(points, nodes, columns, cells)
    place_in_cells(points, nodes, cells, MIN_START_STEP_CELLS, starts)
    rough = 0
    smooth[:] = False
    if splines.patches[0].shape[0] > 0:
        place_in_patches(points, splines, starts, places)
    for begin in range(0, n, BLOCK_POINTS):
        rough += place_by_splines(points, splines, starts, begin, min(n, begin + BLOCK_POINTS), places)
    if rough == 0:
        return
    at, where, found = (np.empty(rough), np.empty(rough)), np.empty(rough, np.int64), (np.empty(rough), np.empty(rough))
    of_rough, k = (np.empty(rough, np.int64), np.empty(rough, np.int64)), 0
    for p in range(n):
        if not smooth[p]:
            where[k], at[0][k], at[1][k] = p, px[p], py[p]
            of_rough[0][k], of_rough[1][k] = cells[0][p], cells[1][p]
            k += 1
    place_in_cells(at, nodes, of_rough, MIN_STEP_CELLS, found)
    for k in range(rough):
        s[where[k]], t[where[k]] = found[0][k], found[1][k]


@compiled
def find_cells(points: Pair, nodes: Pair, columns: int, cells: IntPair) -> None:
    """Fill in the ``cells`` of points, which come in rows of ``columns``, where -1 stands, or a cell nearby.

    It is fast where each point is near the one before it, faster where it is near the given cell, the one in the row
    before, or, where the points are as many as the nodes, in rows and columns, the node of the same number. Of the
    cells of an edge a point has the one that a walk comes to first: the given cell does not change that.
    """
    (px, py), (x, y), (of_i, of_j) = points, nodes, cells
    are_nodes, joined = px.size == x.size and columns == x.shape[1], (meets(x, y), meets(x.T, y.T))
    i = j = other_i = other_j = row = column = end = 0
    for p in range(px.size):
        if p == end:
            end = min(p + min(columns, BLOCK_POINTS), px.size)
            hop(points, nodes, columns, p, end, cells)
        if are_nodes:
            other_i, other_j = max(row - 1, 0), max(column - 1, 0)
        elif p >= columns:
            other_i, other_j = of_i[p - columns], of_j[p - columns]
        if of_i[p] >= 0:
            if not are_nodes and p < columns and is_nearer(px[p], py[p], x, y, (other_i, other_j), (i, j)):
                other_i, other_j = of_i[p], of_j[p]
            i, j = of_i[p], of_j[p]
        elif is_nearer(px[p], py[p], x, y, (other_i, other_j), (i, j)):
            i, j = walk(px[p], py[p], x, y, joined, (other_i, other_j))
            other_i, other_j = i, j
        else:
            i, j = walk(px[p], py[p], x, y, joined, (i, j))
        of_i[p], of_j[p] = i, j
        column += 1
        if column == columns:
            row, column = row + 1, 0


@compiled
def hop(points: Pair, nodes: Pair, columns: int, begin: int, end: int, cells: IntPair) -> None:
    """Fill in the ``cells`` of the points from ``begin`` to before ``end`` that lie inside of one; of others, -1.

    From the given cell, of the point above, or of the node, one step of Newton's method for the bilinear map leads to
    the next. All points go before any goes again, by vector instructions and without a branch, of which the processor
    would guess every other one wrongly. A point on an edge has several cells, so that :func:`find_cells` decides.
    There are at most :data:`~equimesh.meshes.quad_search.BLOCK_POINTS` points.
    """
    (px, py), (x, y), (of_i, of_j) = points, nodes, cells
    last_i, last_j = x.shape[0] - 2, x.shape[1] - 2
    are_nodes, count, todo = px.size == x.size and columns == x.shape[1], 0, np.empty(end - begin, np.int64)
    for p in range(begin, end):
        if of_i[p] < 0:
            if are_nodes:
                of_i[p], of_j[p] = max(p // columns - 1, 0), max(p % columns - 1, 0)
            elif p >= columns:
                of_i[p], of_j[p] = of_i[p - columns], of_j[p - columns]
            else:
                continue
        todo[count] = p
        count += 1
    w = np.empty(WORK_ROWS * BLOCK_POINTS)
    for _ in range(MAX_HOPS):
        for k in range(count):
            p = todo[k]
            i, j = np.uintp(of_i[p]), np.uintp(of_j[p])  # which are not looked at for a sign
            i_end, j_end = i + np.uintp(1), j + np.uintp(1)
            w[X0 + k], w[X1 + k], w[X2 + k], w[X3 + k] = x[i, j], x[i_end, j], x[i_end, j_end], x[i, j_end]
            w[Y0 + k], w[Y1 + k], w[Y2 + k], w[Y3 + k] = y[i, j], y[i_end, j], y[i_end, j_end], y[i, j_end]
            w[X + k], w[Y + k] = px[p], py[p]
        for k in range(count):
            at_x, at_y = w[X + k], w[Y + k]
            x0, x1, x2, x3 = w[X0 + k] - at_x, w[X1 + k] - at_x, w[X2 + k] - at_x, w[X3 + k] - at_x
            y0, y1, y2, y3 = w[Y0 + k] - at_y, w[Y1 + k] - at_y, w[Y2 + k] - at_y, w[Y3 + k] - at_y
            w[INSIDE + k] = min(min(x0 * y1 - x1 * y0, x1 * y2 - x2 * y1), min(x2 * y3 - x3 * y2, x3 * y0 - x0 * y3))
            # From the centre, times 4; and the derivatives, times 2.
            r, q = x0 + x1 + x2 + x3, y0 + y1 + y2 + y3
            x_a, x_b, y_a, y_b = x1 + x2 - x0 - x3, x2 + x3 - x0 - x1, y1 + y2 - y0 - y3, y2 + y3 - y0 - y1
            per_det = 0.5 / (x_a * y_b - x_b * y_a)
            w[RIM + k] = EDGE_SHARE * (x_a * x_a + x_b * x_b + y_a * y_a + y_b * y_b)
            a, b = 0.5 + (q * x_b - r * y_b) * per_det, 0.5 + (r * y_a - q * x_a) * per_det
            w[A + k], w[B + k] = min(max(a, -MAX_HOP), MAX_HOP), min(max(b, -MAX_HOP), MAX_HOP)
        left = 0
        for k in range(count):
            p, inside, rim = todo[k], w[INSIDE + k], w[RIM + k]
            i, j = of_i[p], of_j[p]
            # Conversion to whole numbers rounds towards zero, and these down.
            to_i, to_j = i + int(w[A + k] + MAX_HOP) - MAX_HOP, j + int(w[B + k] + MAX_HOP) - MAX_HOP
            to_i, to_j = min(max(to_i, 0), last_i), min(max(to_j, 0), last_j)
            ends = inside >= -rim
            of_i[p] = (i if inside > rim else -1) if ends else to_i
            of_j[p] = j if ends else to_j
            todo[left] = p
            left += 0 if ends else 1
        count = left
    for k in range(count):
        of_i[todo[k]] = -1


@compiled
def place_in_cells(points: Pair, nodes: Pair, cells: IntPair, smallest: float, places: Pair) -> None:
    """Fill in the grid coordinates of points by the bilinear maps of their ``cells``, or of points on the cells' rims.

    Newton's method ends with a step shorter than ``smallest``.
    """
    (px, py), (x, y), (of_i, of_j), (s, t) = points, nodes, cells, places
    w = np.empty(WORK_ROWS * BLOCK_POINTS)  # one array, or the compiler could not tell that rows do not overlap
    for begin in range(0, px.size, BLOCK_POINTS):
        count = min(BLOCK_POINTS, px.size - begin)
        for k in range(count):
            i, j = of_i[begin + k], of_j[begin + k]
            w[X + k], w[Y + k] = px[begin + k], py[begin + k]
            w[X0 + k], w[X1 + k], w[X2 + k], w[X3 + k] = x[i, j], x[i + 1, j], x[i + 1, j + 1], x[i, j + 1]
            w[Y0 + k], w[Y1 + k], w[Y2 + k], w[Y3 + k] = y[i, j], y[i + 1, j], y[i + 1, j + 1], y[i, j + 1]
        invert_bilinear(w, count, smallest, 0.0)
        for k in range(count):
            s[begin + k], t[begin + k] = of_i[begin + k] + w[A + k], of_j[begin + k] + w[B + k]


@vectorised
def place_in_patches(points: Pair, splines: MapSplines, starts: Pair, places: Places) -> None:
    """Fill in the grid coordinates of those points that stay on the piece of the splines where they start.

    They are ``smooth`` afterwards. Newton's method takes them as :func:`place_by_splines` does. The polynomials of each
    point are copied, so that the steps of all points of a block are vector instructions.
    """
    (px, py), (s0, t0), (s, t, smooth) = points, starts, places
    breaks_s, breaks_t = splines.along_s.breaks, splines.along_t.breaks
    of_x, of_y = splines.patches
    scale_s, scale_t = buckets_per_length(splines.along_s), buckets_per_length(splines.along_t)
    w, k, m = np.zeros(PATCH_ROWS * PATCH_POINTS), np.empty(PATCH_POINTS, np.int64), np.empty(PATCH_POINTS, np.int64)
    for begin in range(0, px.size, PATCH_POINTS):
        count = min(PATCH_POINTS, px.size - begin)
        for n in range(count):
            a, b = s0[begin + n], t0[begin + n]
            i, j = piece(a, splines.along_s, scale_s), piece(b, splines.along_t, scale_t)
            for row in range(ORDER):
                for column in range(ORDER):
                    at = (ORDER * row + column) * PATCH_POINTS + n
                    w[OF_X + at], w[OF_Y + at] = of_x[i, j, row, column], of_y[i, j, row, column]
            k[n], m[n] = i, j
            w[PX + n], w[PY + n] = px[begin + n], py[begin + n]
            w[PA + n], w[PB + n] = a - breaks_s[i], b - breaks_t[j]
            w[A0 + n], w[B0 + n] = w[PA + n], w[PB + n]
            w[END_A + n], w[END_B + n] = breaks_s[i + 1] - breaks_s[i], breaks_t[j + 1] - breaks_t[j]
            w[GOES + n], w[LEFT + n] = 1.0, 0.0
        for _ in range(MAX_PATCH_STEPS):
            step_in_patches(w)
            goes = 0.0
            for n in range(count):
                goes += w[GOES + n]
            if goes == 0.0:
                break
        for n in range(count):
            if w[GOES + n] == 0.0 and w[LEFT + n] == 0.0:
                s[begin + n], t[begin + n] = breaks_s[k[n]] + w[PA + n], breaks_t[m[n]] + w[PB + n]
                smooth[begin + n] = True


@vectorised
def step_in_patches(w: Array) -> None:
    """A step of Newton's method for all points of a block, whose numbers are in ``w``."""
    for n in range(PATCH_POINTS):
        a, b, goes = w[PA + n], w[PB + n], w[GOES + n]
        x, x_s, x_t = at_rows(w, OF_X + n, a, b)
        y, y_s, y_t = at_rows(w, OF_Y + n, a, b)
        r, q = w[PX + n] - x, w[PY + n] - y
        det = x_s * y_t - x_t * y_s
        per_det = 1.0 / (det if det > 0.0 else 1.0)
        da, db = (r * y_t - q * x_t) * per_det, (q * x_s - r * y_s) * per_det
        to_a, to_b = a + da, b + db
        inside = min(min(to_a, w[END_A + n] - to_a), min(to_b, w[END_B + n] - to_b))
        far = max(abs(to_a - w[A0 + n]), abs(to_b - w[B0 + n]))
        left = 0.0 if min(inside, det) > 0.0 else 1.0
        left = left if far <= MAX_DISTANCE_CELLS else 1.0
        w[PA + n] = to_a if goes > 0.0 else a
        w[PB + n] = to_b if goes > 0.0 else b
        w[LEFT + n] = max(w[LEFT + n], left * goes)
        ends = max(left, 1.0 if abs(da) + abs(db) < MIN_STEP_CELLS else 0.0)
        w[GOES + n] = 0.0 if ends > 0.0 else goes


@inlined
def at_rows(w: Array, first: int, s: float, t: float) -> tuple[float, float, float]:
    """As :func:`~equimesh.fields.bicubic.at_patch`, of the polynomial whose coefficients begin at ``first``."""
    q00, q01, q02, q03 = w[first], w[first + 1 * PATCH_POINTS], w[first + 2 * PATCH_POINTS], w[first + 3 * PATCH_POINTS]
    first += 4 * PATCH_POINTS
    q10, q11, q12, q13 = w[first], w[first + 1 * PATCH_POINTS], w[first + 2 * PATCH_POINTS], w[first + 3 * PATCH_POINTS]
    first += 4 * PATCH_POINTS
    q20, q21, q22, q23 = w[first], w[first + 1 * PATCH_POINTS], w[first + 2 * PATCH_POINTS], w[first + 3 * PATCH_POINTS]
    first += 4 * PATCH_POINTS
    q30, q31, q32, q33 = w[first], w[first + 1 * PATCH_POINTS], w[first + 2 * PATCH_POINTS], w[first + 3 * PATCH_POINTS]
    r0, r1 = q00 + t * (q10 + t * (q20 + t * q30)), q01 + t * (q11 + t * (q21 + t * q31))
    r2, r3 = q02 + t * (q12 + t * (q22 + t * q32)), q03 + t * (q13 + t * (q23 + t * q33))
    d0, d1 = q10 + t * (2.0 * q20 + t * (3.0 * q30)), q11 + t * (2.0 * q21 + t * (3.0 * q31))
    d2, d3 = q12 + t * (2.0 * q22 + t * (3.0 * q32)), q13 + t * (2.0 * q23 + t * (3.0 * q33))
    return (
        r0 + s * (r1 + s * (r2 + s * r3)),
        r1 + s * (2.0 * r2 + s * (3.0 * r3)),
        d0 + s * (d1 + s * (d2 + s * d3)),
    )


@compiled
def place_by_splines(points: Pair, splines: MapSplines, starts: Pair, begin: int, end: int, places: Places) -> int:
    """Fill in the grid coordinates of the points from ``begin`` to before ``end`` that are not ``smooth`` yet.

    They are those of the splines of the mesh. The ``starts`` are their grid coordinates by bilinear maps. Returns the
    number of points that have no others. All points take a step of Newton's method before the next: so the processor
    works at several of them.
    """
    (px, py), (s0, t0), (s, t, smooth) = points, starts, places
    along_s, along_t = splines.along_s, splines.along_t
    breaks_s, breaks_t = along_s.breaks, along_t.breaks
    of_x, of_y = splines.patches
    scale_s, scale_t = buckets_per_length(along_s), buckets_per_length(along_t)
    last_s, last_t = breaks_s[-1], breaks_t[-1]
    last_k, last_m = breaks_s.size - 2, breaks_t.size - 2
    left, lost = 0, 0
    moving = np.empty(end - begin, np.int64)
    for p in range(begin, end):
        if not smooth[p]:
            moving[left], s[p], t[p] = p, s0[p], t0[p]
            left += 1
    for _ in range(MAX_STEPS):
        count, left = left, 0
        for n in range(count):
            p = moving[n]
            a, b = s[p], t[p]
            k, m = min(max(int(a) - 1, 0), last_k), min(max(int(b) - 1, 0), last_m)
            if not breaks_s[k] <= a < breaks_s[k + 1]:
                k = piece(a, along_s, scale_s)
            if not breaks_t[m] <= b < breaks_t[m + 1]:
                m = piece(b, along_t, scale_t)
            da, db = a - breaks_s[k], b - breaks_t[m]
            if of_x.shape[0] > 0:
                r, x_s, x_t = at_patch(of_x[k, m], da, db)
                q, y_s, y_t = at_patch(of_y[k, m], da, db)
            else:
                r, x_s, x_t, q, y_s, y_t = by_splines(splines, k, m, da, db)
            r, q = px[p] - r, py[p] - q
            det = x_s * y_t - x_t * y_s
            if not det > 0.0:
                lost += 1
                continue
            per_det = 1.0 / det
            da, db = (r * y_t - q * x_t) * per_det, (q * x_s - r * y_s) * per_det
            # At a side that the step leads out of, the nearest point is sought along the side.
            if (a <= 0.0 and da < 0.0) or (a >= last_s and da > 0.0):
                da, db = 0.0, (r * x_t + q * y_t) / (x_t * x_t + y_t * y_t)
                if (b <= 0.0 and db < 0.0) or (b >= last_t and db > 0.0):
                    db = 0.0
            elif (b <= 0.0 and db < 0.0) or (b >= last_t and db > 0.0):
                da, db = (r * x_s + q * y_s) / (x_s * x_s + y_s * y_s), 0.0
                if (a <= 0.0 and da < 0.0) or (a >= last_s and da > 0.0):
                    da = 0.0
            a, b = min(max(a + da, 0.0), last_s), min(max(b + db, 0.0), last_t)
            s[p], t[p] = a, b
            if not (abs(a - s0[p]) <= MAX_DISTANCE_CELLS and abs(b - t0[p]) <= MAX_DISTANCE_CELLS):
                lost += 1
            elif abs(da) + abs(db) < MIN_STEP_CELLS:
                smooth[p] = True
            else:
                moving[left] = p
                left += 1
        if left == 0:
            break
    return lost + left


@vectorised
def by_splines(
    splines: MapSplines, k: int, m: int, s: float, t: float
) -> tuple[float, float, float, float, float, float]:
    """x and y, each with its derivatives, at (s, t) from the begin of the pieces ``k`` and ``m``."""
    cubics_s, cubics_t, of_x, of_y = splines.along_s.cubics, splines.along_t.cubics, splines.of_x, splines.of_y
    f_s, g_s = at_piece(cubics_s, k, s), slopes_at_piece(cubics_s, k, s)
    f_t, g_t = at_piece(cubics_t, m, t), slopes_at_piece(cubics_t, m, t)
    x = x_s = x_t = y = y_s = y_t = 0.0
    for c in range(ORDER):
        for d in range(ORDER):
            w, w_s, w_t = f_s[c] * f_t[d], g_s[c] * f_t[d], f_s[c] * g_t[d]
            x += of_x[k + c, m + d] * w
            x_s += of_x[k + c, m + d] * w_s
            x_t += of_x[k + c, m + d] * w_t
            y += of_y[k + c, m + d] * w
            y_s += of_y[k + c, m + d] * w_s
            y_t += of_y[k + c, m + d] * w_t
    return x, x_s, x_t, y, y_s, y_t


@compiled
def meets(x: Array, y: Array) -> bool:
    """Whether the last line of nodes is the first one again, as where a ring is cut."""
    size = np.abs(x[1] - x[0]).max() + np.abs(y[1] - y[0]).max()
    return bool(np.abs(x[-1] - x[0]).max() + np.abs(y[-1] - y[0]).max() <= EDGE_SHARE * size)


@compiled
def walk(
    px: float, py: float, x: Array, y: Array, joined: tuple[bool, bool], start: tuple[int, int]
) -> tuple[int, int]:
    """The cell of a point, or one near it at a side, found by steps from cell to cell from the ``start``.

    Steps go on across a cut at which two sides are ``joined``. Where a domain is not convex they can end at a side, far
    from the point: then all cells are searched.
    """
    rows, columns, (i, j), (round_i, round_j) = x.shape[0] - 1, x.shape[1] - 1, start, joined
    for _ in range(4 * (rows + columns)):
        worst, to_i, to_j = -1e-12, i, j
        x0, x1, x2, x3 = x[i, j] - px, x[i + 1, j] - px, x[i + 1, j + 1] - px, x[i, j + 1] - px
        y0, y1, y2, y3 = y[i, j] - py, y[i + 1, j] - py, y[i + 1, j + 1] - py, y[i, j + 1] - py
        # Few edges have the point on their outer side: only their lengths are needed.
        below, right, above, left = x0 * y1 - x1 * y0, x1 * y2 - x2 * y1, x2 * y3 - x3 * y2, x3 * y0 - x0 * y3
        if min(below, right, above, left) >= 0.0:
            return i, j
        if below < 0.0 and (j > 0 or round_j) and below < worst * ((x1 - x0) ** 2 + (y1 - y0) ** 2):
            worst, to_i, to_j = below / ((x1 - x0) ** 2 + (y1 - y0) ** 2), i, (j - 1) % columns
        if right < 0.0 and (i < rows - 1 or round_i) and right < worst * ((x2 - x1) ** 2 + (y2 - y1) ** 2):
            worst, to_i, to_j = right / ((x2 - x1) ** 2 + (y2 - y1) ** 2), (i + 1) % rows, j
        if above < 0.0 and (j < columns - 1 or round_j) and above < worst * ((x3 - x2) ** 2 + (y3 - y2) ** 2):
            worst, to_i, to_j = above / ((x3 - x2) ** 2 + (y3 - y2) ** 2), i, (j + 1) % columns
        if left < 0.0 and (i > 0 or round_i) and left < worst * ((x0 - x3) ** 2 + (y0 - y3) ** 2):
            worst, to_i, to_j = left / ((x0 - x3) ** 2 + (y0 - y3) ** 2), (i - 1) % rows, j
        if to_i == i and to_j == j:
            if is_near(px, py, x, y, i, j):
                return i, j
            break
        i, j = to_i, to_j
    return search(px, py, x, y)  # the walk was a circle, or ended far away


@inlined
def is_nearer(px: float, py: float, x: Array, y: Array, one: tuple[int, int], other: tuple[int, int]) -> bool:
    """Whether a point is nearer to the first node of the cell ``one`` than to that of an ``other`` cell.

    Points mostly come in rows: the first point of a row is near to that of the row before, and far from the last one.
    """
    dx, dy, ex, ey = x[one] - px, y[one] - py, x[other] - px, y[other] - py
    return bool(dx * dx + dy * dy < ex * ex + ey * ey)


@compiled
def is_near(px: float, py: float, x: Array, y: Array, i: int, j: int) -> bool:
    """Whether a point lies in the box around the cell (i, j), or as near to it as a curved side to its edge."""
    x_low, x_high = min(x[i, j], x[i + 1, j], x[i + 1, j + 1], x[i, j + 1]), max(x[i, j], x[i + 1, j])
    y_low, y_high = min(y[i, j], y[i + 1, j], y[i + 1, j + 1], y[i, j + 1]), max(y[i, j], y[i + 1, j])
    x_high, y_high = max(x_high, x[i + 1, j + 1], x[i, j + 1]), max(y_high, y[i + 1, j + 1], y[i, j + 1])
    rim = RIM_SHARE * max(x_high - x_low, y_high - y_low)
    return bool(x_low - rim <= px <= x_high + rim and y_low - rim <= py <= y_high + rim)


@compiled
def search(px: float, py: float, x: Array, y: Array) -> tuple[int, int]:
    """The cell of a point, or the one with the nearest centre, among all cells."""
    best_i = best_j = 0
    least = np.inf
    for i in range(x.shape[0] - 1):
        for j in range(x.shape[1] - 1):
            if holds(px, py, x, y, i, j):
                return i, j
            across = 0.25 * (x[i, j] + x[i + 1, j] + x[i + 1, j + 1] + x[i, j + 1]) - px
            up = 0.25 * (y[i, j] + y[i + 1, j] + y[i + 1, j + 1] + y[i, j + 1]) - py
            distance = across * across + up * up
            if distance < least:
                least, best_i, best_j = distance, i, j
    return best_i, best_j


@compiled
def holds(px: float, py: float, x: Array, y: Array, i: int, j: int) -> bool:
    """Whether a point lies in the cell (i, j)."""
    for side in range(4):
        i0, j0 = i + (side == 1 or side == 2), j + (side == 2 or side == 3)
        i1, j1 = i + (side == 0 or side == 1), j + (side == 1 or side == 2)
        ex, ey = x[i1, j1] - x[i0, j0], y[i1, j1] - y[i0, j0]
        if ex * (py - y[i0, j0]) - ey * (px - x[i0, j0]) < 0.0:
            return False
    return True
