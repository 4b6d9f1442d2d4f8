"""The map of a structured mesh from its grid to the plane, as a bicubic spline through the nodes, and its inverse.

Grid coordinates ``(s, t)`` count cells: node ``(i, j)`` is at ``s = i, t = j``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy

from equimesh.domains.domain import Domain, map_mesh
from equimesh.errors import InputError
from equimesh.fields.bicubic import ORDER, Axis, Bicubic, at_patch, at_piece, buckets_per_length, piece, slopes_at_piece
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.compiled import compiled, inlined, vectorised
from equimesh.numerics.types import Array, BoolArray, Pair

MAX_STEPS = 20  # of Newton's method
POLISHING_STEPS = 4  # of Newton's method on the map of a domain, from the result of its spline
MAX_FAR_SHARE = 1e-9  # of the extent of a domain: a node further from the image of its place has another place
MIN_START_STEP_CELLS = 0.01  # near enough to start Newton's method on the splines
MIN_STEP_CELLS = 1e-8  # the next step after a smaller one would be lost in rounding
MAX_DISTANCE_CELLS = 1.0  # between the point by the spline and by the bilinear cell that holds it
RIM_SHARE = 0.25  # of the length of a cell: how far from its edge a curved side may lie
NO_PATCHES = np.empty((0, 0, ORDER, ORDER))


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
            " y; give a mesh whose min_jacobian is positive",
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
        x, y = np.ravel(x), np.ravel(y)
        lost = ~(np.isfinite(x) & np.isfinite(y))
        if lost.any():
            x, y = np.where(lost, self.mesh.x[0, 0], x), np.where(lost, self.mesh.y[0, 0], y)
        places = Places(np.empty(x.size), np.empty(x.size), np.empty(x.size, dtype=np.bool_))
        points = np.ascontiguousarray(x, dtype=float), np.ascontiguousarray(y, dtype=float)
        locate_points(points, (self.mesh.x, self.mesh.y), self._splines, places)
        return places

    @property
    def _splines(self) -> MapSplines:
        of_x, of_y = self.x.polynomials, self.y.polynomials
        patches = (NO_PATCHES, NO_PATCHES) if of_x is None or of_y is None else (of_x, of_y)
        return MapSplines(self.x.along_x, self.x.along_y, self.x.coefficients, self.y.coefficients, patches)


def reference_of(mesh: Mesh, domain: Domain) -> Mesh:
    """The mesh of the reference square whose image on ``domain`` is ``mesh``: the inverse of ``map_mesh``."""
    uniform = Mesh.uniform(mesh.grid)
    places = MeshMap.of(map_mesh(uniform, domain)).locate(mesh.x, mesh.y)
    s, t = (along.reshape(mesh.x.shape) / (n - 1) for along, n in zip((places.s, places.t), mesh.x.shape, strict=True))
    s[0], s[-1], t[:, 0], t[:, -1] = 0.0, 1.0, 0.0, 1.0  # where a ring is cut, the place alone does not tell the side
    s, t, far = _polished(mesh, domain, s, t)
    if far.max() > MAX_FAR_SHARE * max(np.ptp(mesh.x), np.ptp(mesh.y)):  # inner nodes near a cut, from its other side
        for start in ((s, 1.0 - t), (1.0 - s, t)):
            other_s, other_t, other_far = _polished(mesh, domain, *start)
            nearer = other_far < far
            s, t = np.where(nearer, other_s, s), np.where(nearer, other_t, t)
            far = np.minimum(far, other_far)
    return Mesh.of_unit_square(s, t)


def _polished(mesh: Mesh, domain: Domain, s: Array, t: Array) -> tuple[Array, Array, Array]:
    """The places of nodes in the reference square by Newton's method, and how far their images are from the nodes."""
    for _ in range(POLISHING_STEPS):
        x, y = domain.map(s, t)
        x_s, x_t, y_s, y_t = domain.jacobian(s, t)
        det = x_s * y_t - x_t * y_s
        r, q = mesh.x - x, mesh.y - y
        s = np.clip(s + (r * y_t - q * x_t) / det, 0.0, 1.0)
        t = np.clip(t + (q * x_s - r * y_s) / det, 0.0, 1.0)
    x, y = domain.map(s, t)
    return s, t, np.hypot(mesh.x - x, mesh.y - y)


def through(values: Array) -> Bicubic:
    """The bicubic spline through values at all nodes, over the grid coordinates."""
    s, t = (np.arange(float(n)) for n in values.shape)
    return Bicubic.of(scipy.interpolate.RectBivariateSpline(s, t, values, s=0), often=True)


@compiled
def locate_points(points: Pair, nodes: Pair, splines: MapSplines, places: Places) -> None:
    """Fill in the grid coordinates of points. It is fast where each point is near the one before it."""
    (px, py), (x, y), (s, t, smooth) = points, nodes, places
    along_s, along_t = splines.along_s, splines.along_t
    breaks_s, breaks_t = along_s.breaks, along_t.breaks
    of_x, of_y = splines.patches
    scale_s, scale_t = buckets_per_length(along_s), buckets_per_length(along_t)
    last_s, last_t = float(x.shape[0] - 1), float(x.shape[1] - 1)
    i = j = row_i = row_j = 0
    for p in range(px.size):
        if is_nearer(px[p], py[p], x, y, (row_i, row_j), (i, j)):
            row_i, row_j = walk(px[p], py[p], x, y, row_i, row_j)
            i, j = row_i, row_j
        else:
            i, j = walk(px[p], py[p], x, y, i, j)
        s0, t0 = within(px[p], py[p], x, y, i, j, MIN_START_STEP_CELLS)
        smooth[p] = False
        a, b = s0, t0
        k, m = min(max(i - 1, 0), breaks_s.size - 2), min(max(j - 1, 0), breaks_t.size - 2)
        for _ in range(MAX_STEPS):
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
                break
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
            if not (abs(a - s0) <= MAX_DISTANCE_CELLS and abs(b - t0) <= MAX_DISTANCE_CELLS):
                break
            if abs(da) + abs(db) < MIN_STEP_CELLS:
                s[p], t[p], smooth[p] = a, b, True
                break
        if not smooth[p]:
            s[p], t[p] = within(px[p], py[p], x, y, i, j, MIN_STEP_CELLS)


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
def walk(px: float, py: float, x: Array, y: Array, i: int, j: int) -> tuple[int, int]:
    """The cell of a point, or one near it at a side, found by steps from cell to cell from (i, j).

    Where a domain is not convex the steps can end at a side, far from the point: then all cells are searched.
    """
    rows, columns = x.shape[0] - 1, x.shape[1] - 1
    for _ in range(4 * (rows + columns)):
        worst, to_i, to_j = -1e-12, i, j
        x0, x1, x2, x3 = x[i, j] - px, x[i + 1, j] - px, x[i + 1, j + 1] - px, x[i, j + 1] - px
        y0, y1, y2, y3 = y[i, j] - py, y[i + 1, j] - py, y[i + 1, j + 1] - py, y[i, j + 1] - py
        # Few edges have the point on their outer side: only their lengths are needed.
        below, right, above, left = x0 * y1 - x1 * y0, x1 * y2 - x2 * y1, x2 * y3 - x3 * y2, x3 * y0 - x0 * y3
        if below < 0.0 and j > 0 and below < worst * ((x1 - x0) ** 2 + (y1 - y0) ** 2):
            worst, to_i, to_j = below / ((x1 - x0) ** 2 + (y1 - y0) ** 2), i, j - 1
        if right < 0.0 and i < rows - 1 and right < worst * ((x2 - x1) ** 2 + (y2 - y1) ** 2):
            worst, to_i, to_j = right / ((x2 - x1) ** 2 + (y2 - y1) ** 2), i + 1, j
        if above < 0.0 and j < columns - 1 and above < worst * ((x3 - x2) ** 2 + (y3 - y2) ** 2):
            worst, to_i, to_j = above / ((x3 - x2) ** 2 + (y3 - y2) ** 2), i, j + 1
        if left < 0.0 and i > 0 and left < worst * ((x0 - x3) ** 2 + (y0 - y3) ** 2):
            worst, to_i, to_j = left / ((x0 - x3) ** 2 + (y0 - y3) ** 2), i - 1, j
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


@compiled
def within(px: float, py: float, x: Array, y: Array, i: int, j: int, smallest: float) -> tuple[float, float]:
    """The grid coordinates of a point by the bilinear map of the cell (i, j), or of one on the cell's rim.

    Newton's method ends with a step shorter than ``smallest``.
    """
    a = b = 0.5
    for _ in range(MAX_STEPS):
        lower_x, upper_x = x[i, j] + a * (x[i + 1, j] - x[i, j]), x[i, j + 1] + a * (x[i + 1, j + 1] - x[i, j + 1])
        lower_y, upper_y = y[i, j] + a * (y[i + 1, j] - y[i, j]), y[i, j + 1] + a * (y[i + 1, j + 1] - y[i, j + 1])
        x_a = (1.0 - b) * (x[i + 1, j] - x[i, j]) + b * (x[i + 1, j + 1] - x[i, j + 1])
        y_a = (1.0 - b) * (y[i + 1, j] - y[i, j]) + b * (y[i + 1, j + 1] - y[i, j + 1])
        x_b, y_b = upper_x - lower_x, upper_y - lower_y
        r, q = px - lower_x - b * x_b, py - lower_y - b * y_b
        det = x_a * y_b - x_b * y_a
        da, db = (r * y_b - q * x_b) / det, (q * x_a - r * y_a) / det
        a, b = min(max(a + da, 0.0), 1.0), min(max(b + db, 0.0), 1.0)
        if abs(da) + abs(db) < smallest:
            break
    return i + a, j + b
