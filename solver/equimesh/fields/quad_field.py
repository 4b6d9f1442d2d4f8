"""u by values at the nodes of a mesh of quadrilaterals: cubics on the edges, blended inside the cells."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from equimesh.fields.mesh_map import require_unfolded
from equimesh.fields.nodal_field import COUNT, MAX_SLOPE, bend, bump, nodal_values, patch_gradients, slope
from equimesh.meshes.cell_edges import MAX_SPOKES, QuadLinks, spokes_of
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.quad_search import QuadPlaces, QuadSearch
from equimesh.meshes.unrolled import Unrolled
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array, BoolArray, IntArray, Pair

# Gradients of u at the nodes of a mesh of quadrilaterals, from differences of the nodal values along its edges.

MAX_TURNS = (0.1, 0.8)
"""The largest turn of a line at a node, in radians, at which its derivatives are those of a parabola.

First only nodes with small turns have a gradient and give it to their neighbours, then those with larger ones.
"""
MIN_SINE = 0.02
"""The smallest sine of the angle between two directions that give a gradient together."""
MIN_FIT_SINE = 0.3
"""The same for a gradient that is fitted to the slopes along edges."""
ROUNDS = 2
"""How often the gradients that are still missing are sought by those of neighbours."""


def quad_gradients(nodes: Pair, links: QuadLinks, values: Array) -> Pair:
    """``(u_x, u_y)`` at the nodes of a valid mesh; x and y of the ``nodes`` and ``values`` have the shape ``(n,)``.

    Where four cells meet and both lines through the node are nearly straight, the gradient is that of
    :func:`~equimesh.fields.nodal_field.nodal_gradients`, which is exact for linear functions, and has an error of
    O(h^2) for smooth u on smooth lines. Elsewhere, as at a side, at a kink of the lines, and where three or five cells
    meet, u is taken as quadratic along each edge: the change of u is the mean of the two slopes at its ends, of which
    one is known. The gradient fits these slopes best. Where too few are known, it is the mean of those in the cells
    around the node, by area.
    """
    gradients = np.zeros((2, values.size))
    known = np.zeros(values.size, dtype=np.bool_)
    for turn in MAX_TURNS:
        along_lines(nodes, links, values, np.cos(turn), (gradients, known))
        for _ in range(ROUNDS):
            if from_neighbours(nodes, links, values, np.cos(turn), (gradients, known)) == 0:
                break
    mean_of_cells(nodes, links, values, gradients, known)
    return gradients[0], gradients[1]


@compiled
def slope_along(nodes: Pair, values: Array, before: int, node: int, after: int, slopes: Array) -> float:
    """The derivatives of x, y and u by the length of the line through three nodes, at the middle one, in ``slopes``.

    Returns the cosine of the turn of the line.
    """
    x, y = nodes
    ax, ay, bx, by = x[node] - x[before], y[node] - y[before], x[after] - x[node], y[after] - y[node]
    a, b = np.hypot(ax, ay), np.hypot(bx, by)
    share = a / (a + b)
    slopes[0] = (1.0 - share) * (ax / a) + share * (bx / b)
    slopes[1] = (1.0 - share) * (ay / a) + share * (by / b)
    slopes[2] = (1.0 - share) * ((values[node] - values[before]) / a) + share * ((values[after] - values[node]) / b)
    return float((ax * bx + ay * by) / (a * b))


@compiled
def along_lines(nodes: Pair, links: QuadLinks, values: Array, straight: float, found: tuple[Array, BoolArray]) -> None:
    """Fill in missing gradients where two lines meet whose turns have a cosine of at least ``straight``."""
    gradients, known = found
    spokes, one, other = np.empty(MAX_SPOKES, dtype=np.int64), np.empty(3), np.empty(3)
    for node in range(values.size):
        if known[node] or links.starts[node + 1] - links.starts[node] != 4:
            continue
        count, closed = spokes_of(node, links, spokes)
        if not (closed and count == 4):
            continue
        if slope_along(nodes, values, spokes[0], node, spokes[2], one) < straight:
            continue
        if slope_along(nodes, values, spokes[1], node, spokes[3], other) < straight:
            continue
        det = one[0] * other[1] - one[1] * other[0]
        if abs(det) < MIN_SINE * np.hypot(one[0], one[1]) * np.hypot(other[0], other[1]):
            continue
        gradients[0, node] = (one[2] * other[1] - other[2] * one[1]) / det
        gradients[1, node] = (other[2] * one[0] - one[2] * other[0]) / det
        known[node] = True


@compiled
def from_neighbours(
    nodes: Pair, links: QuadLinks, values: Array, straight: float, found: tuple[Array, BoolArray]
) -> int:
    """Fill in missing gradients by those that are known before; returns how many were found."""
    (x, y), (gradients, known) = nodes, found
    spokes, line, new = np.empty(MAX_SPOKES, dtype=np.int64), np.empty(3), np.zeros(values.size, dtype=np.bool_)
    number = 0
    for node in range(values.size):
        if known[node] or links.starts[node + 1] == links.starts[node]:
            continue
        count, closed = spokes_of(node, links, spokes)
        a = b = d = p = q = 0.0  # the normal equations of all slopes by directions of length 1
        for k in range(count):
            to = spokes[k]
            if known[to]:
                ex, ey = x[to] - x[node], y[to] - y[node]
                length = np.hypot(ex, ey)
                ex, ey = ex / length, ey / length
                slope = 2.0 * (values[to] - values[node]) / length - gradients[0, to] * ex - gradients[1, to] * ey
                a, b, d, p, q = a + ex * ex, b + ex * ey, d + ey * ey, p + slope * ex, q + slope * ey
        if count == (4 if closed else 3):
            for k in range(count - 2):
                if slope_along(nodes, values, spokes[k], node, spokes[k + 2], line) >= straight:
                    ex, ey, slope = line[0], line[1], line[2]
                    a, b, d, p, q = a + ex * ex, b + ex * ey, d + ey * ey, p + slope * ex, q + slope * ey
        det = a * d - b * b
        if det > MIN_FIT_SINE * MIN_FIT_SINE:
            gradients[0, node], gradients[1, node] = (d * p - b * q) / det, (a * q - b * p) / det
            new[node] = True
            number += 1
    for node in range(values.size):
        known[node] = known[node] or new[node]
    return number


@compiled
def mean_of_cells(nodes: Pair, links: QuadLinks, values: Array, gradients: Array, known: BoolArray) -> None:
    """Fill in what is missing still: the mean of the gradients in the cells around the node, by area."""
    x, y = nodes
    for node in range(values.size):
        if known[node]:
            continue
        g = h = area = 0.0
        for at in range(links.starts[node], links.starts[node + 1]):
            c = links.cells[links.places[at] // 4]
            ax, ay, bx, by = x[c[2]] - x[c[0]], y[c[2]] - y[c[0]], x[c[3]] - x[c[1]], y[c[3]] - y[c[1]]
            u, v = values[c[2]] - values[c[0]], values[c[3]] - values[c[1]]
            # By Green's formula the integral of the gradient; the area is half of the product.
            g, h, area = g + u * by - v * ay, h + v * ax - u * bx, area + ax * by - ay * bx
        if area > 0.0:
            gradients[0, node], gradients[1, node] = g / area, h / area


EDGE_ENDS = ((0, 1), (3, 2), (0, 3), (1, 2))
"""The corners at the begin and the end of the four edges of a cell: lower and upper, left and right."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False, init=False)
class QuadField:
    """u from ``values`` of shape ``(n,)`` at the nodes of ``mesh``, as cubics on the edges.

    On an edge u is the cubic with the slopes of :func:`~equimesh.fields.quad_field.quad_gradients` at its ends.
    Where it is ``limited``, these are cut to between 0 and three times the slope of the edge: it is monotone, so that
    layers thinner than a cell do not overshoot. In a cell the edges are blended over the bilinear map. This is
    :class:`~equimesh.fields.nodal_field.HermiteField` on any mesh of quadrilaterals: linear functions are exact; for
    smooth u the error is O(h^3), at extrema O(h^2) where it is limited. Where it is ``fitted``, slopes are those of
    :func:`~equimesh.fields.nodal_field.patch_gradients`, and not limited. A point outside of the mesh has the
    value of the nearest point of the boundary; across a periodic join u goes on.

    Implements :class:`~equimesh.fields.expression.Field`. Raises :class:`~equimesh.errors.SamplesError`, which names
    the first bad index, and :class:`~equimesh.errors.InputError` for a folded mesh.
    """

    mesh: Mesh
    values: Array
    limited: bool
    _unrolled: Unrolled
    _values: Array
    _bumps: Array

    def __init__(
        self,
        *,
        mesh: Mesh,
        values: npt.ArrayLike,
        limited: bool = True,
        fitted: bool = False,
        unrolled: Unrolled | None = None,
    ) -> None:
        checked = nodal_values(values, mesh)
        if unrolled is None:
            require_unfolded(mesh)
            unrolled = Unrolled.of(mesh)
        own = np.array(checked[unrolled.nodes])
        bumps = edge_bumps(unrolled.search, own, limited, fitted)
        for name, value in {
            "mesh": mesh, "values": checked, "limited": limited,
            "_unrolled": unrolled, "_values": own, "_bumps": bumps,
        }.items():  # fmt: skip
            object.__setattr__(self, name, value)

    def evaluate(self, x: Array, y: Array, order: int = 0) -> tuple[Array, ...]:
        """u and its partial derivatives up to ``order``, each of the points' shape: see ``Field.evaluate``."""
        x, y = np.broadcast_arrays(x, y)
        rows = self.at(self._unrolled.search.find(x, y), order)
        return tuple(row.reshape(x.shape) for row in rows)

    def at(self, places: QuadPlaces, order: int = 0) -> Array:
        """u and its derivatives up to ``order`` at places in cells, shape ``(1, 3 or 6, points)``."""
        search = self._unrolled.search
        rows = np.empty((COUNT[order], places.s.size))
        evaluate_places(places, search.nodes, search.links.cells, self._values, self._bumps, rows)
        return rows

    def __repr__(self) -> str:
        return f"QuadField({len(self.mesh.points)} nodes, {len(self.mesh.cells)} cells)"


def edge_bumps(search: QuadSearch, values: Array, limited: bool, fitted: bool = False) -> Array:
    """What the cubics add to linear interpolation on the edges of each cell, shape ``(m, 4, 2)``.

    The edges are the lower, upper, left and right one; see :class:`~equimesh.fields.nodal_field.EdgeBumps`.
    """
    (x, y), cells = search.nodes, search.links.cells
    if fitted:
        u_x, u_y = patch_gradients(np.column_stack(search.nodes), cells, values)
    else:
        u_x, u_y = quad_gradients(search.nodes, search.links, values)
    bumps = np.empty((len(cells), 4, 2))
    for edge, (begin, end) in enumerate(EDGE_ENDS):
        a, b = cells[:, begin], cells[:, end]
        dx, dy, rise = x[b] - x[a], y[b] - y[a], values[b] - values[a]
        low, high = np.minimum(0.0, MAX_SLOPE * rise), np.maximum(0.0, MAX_SLOPE * rise)
        for side, node in enumerate((a, b)):
            at = u_x[node] * dx + u_y[node] * dy
            bumps[:, edge, side] = (np.clip(at, low, high) if limited and not fitted else at) - rise
    return bumps


@compiled
def evaluate_places(places: QuadPlaces, nodes: Pair, cells: IntArray, values: Array, bumps: Array, rows: Array) -> None:
    """Fill ``rows`` of shape ``(1, 3 or 6, points)`` with u and its derivatives at places in cells; NaN in no cell."""
    (cell, s_in, t_in), (x, y) = places, nodes
    for k in range(cell.size):
        if cell[k] < 0:
            rows[:, k] = np.nan
            continue
        c, s, t, of = cells[cell[k]], s_in[k], t_in[k], bumps[cell[k]]
        v00, v10, v11, v01 = values[c[0]], values[c[1]], values[c[2]], values[c[3]]
        low, up = bump(of[0, 0], of[0, 1], s), bump(of[1, 0], of[1, 1], s)
        left, right = bump(of[2, 0], of[2, 1], t), bump(of[3, 0], of[3, 1], t)
        lower, upper = v00 + s * (v10 - v00), v01 + s * (v11 - v01)
        rows[0, k] = lower + t * (upper - lower) + low + t * (up - low) + left + s * (right - left)
        if rows.shape[0] == 1:
            continue
        d_low, d_up = slope(of[0, 0], of[0, 1], s), slope(of[1, 0], of[1, 1], s)
        d_left, d_right = slope(of[2, 0], of[2, 1], t), slope(of[3, 0], of[3, 1], t)
        u_s = (1.0 - t) * (v10 - v00) + t * (v11 - v01) + d_low + t * (d_up - d_low) + right - left
        u_t = upper - lower + up - low + d_left + s * (d_right - d_left)
        x_s, y_s = (1.0 - t) * (x[c[1]] - x[c[0]]) + t * (x[c[2]] - x[c[3]]), (1.0 - t) * (y[c[1]] - y[c[0]])
        x_t, y_t = (1.0 - s) * (x[c[3]] - x[c[0]]) + s * (x[c[2]] - x[c[1]]), (1.0 - s) * (y[c[3]] - y[c[0]])
        y_s, y_t = y_s + t * (y[c[2]] - y[c[3]]), y_t + s * (y[c[2]] - y[c[1]])
        per_det = 1.0 / (x_s * y_t - x_t * y_s)
        s_x, s_y, t_x, t_y = y_t * per_det, -x_t * per_det, -y_s * per_det, x_s * per_det
        u_x, u_y = u_s * s_x + u_t * t_x, u_s * s_y + u_t * t_y
        rows[1, k], rows[2, k] = u_x, u_y
        if rows.shape[0] == 3:
            continue
        x_st, y_st = x[c[0]] - x[c[1]] + x[c[2]] - x[c[3]], y[c[0]] - y[c[1]] + y[c[2]] - y[c[3]]
        ss = (1.0 - t) * bend(of[0, 0], of[0, 1], s) + t * bend(of[1, 0], of[1, 1], s)
        tt = (1.0 - s) * bend(of[2, 0], of[2, 1], t) + s * bend(of[3, 0], of[3, 1], t)
        st = v00 - v10 + v11 - v01 + d_up - d_low + d_right - d_left - u_x * x_st - u_y * y_st
        rows[3, k] = s_x * (ss * s_x + st * t_x) + t_x * (st * s_x + tt * t_x)
        rows[4, k] = s_x * (ss * s_y + st * t_y) + t_x * (st * s_y + tt * t_y)
        rows[5, k] = s_y * (ss * s_y + st * t_y) + t_y * (st * s_y + tt * t_y)
