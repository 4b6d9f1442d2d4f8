"""u by values at the nodes of a mesh of quadrilaterals: cubics on the edges, blended inside the cells."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from equimesh.errors import InputError, SamplesError
from equimesh.fields.hermite_field import COUNT, MAX_SLOPE, bend, bump, slope
from equimesh.fields.quad_gradients import quad_gradients
from equimesh.formulas.vocabulary import LIMITS
from equimesh.inputs import real_array
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.meshes.quad_search import QuadPlaces, QuadSearch
from equimesh.meshes.unrolled import Unrolled
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array, IntArray, Pair

EDGE_ENDS = ((0, 1), (3, 2), (0, 3), (1, 2))
"""The corners at the begin and the end of the four edges of a cell: lower and upper, left and right."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False, init=False)
class QuadField:
    """u from ``values`` of shape ``(n,)`` at the nodes of ``mesh``, as cubics on the edges.

    On an edge u is the cubic with the slopes of :func:`~equimesh.fields.quad_gradients.quad_gradients` at its ends.
    Where it is ``limited``, these are cut to between 0 and three times the slope of the edge: it is monotone, so that
    layers thinner than a cell do not overshoot. In a cell the edges are blended over the bilinear map. This is
    :class:`~equimesh.fields.hermite_field.HermiteField` on any mesh of quadrilaterals: linear functions are exact; for
    smooth u the error is O(h^3), at extrema O(h^2) where it is limited. A point outside of the mesh has the value of
    the nearest point of the boundary; across a periodic join u goes on.

    Implements :class:`~equimesh.fields.field.Field`. Raises :class:`~equimesh.errors.SamplesError`, which names the
    first bad index, and :class:`~equimesh.errors.InputError` for a folded mesh.
    """

    mesh: QuadMesh
    values: Array
    limited: bool
    _unrolled: Unrolled
    _values: Array
    _bumps: Array

    def __init__(
        self, *, mesh: QuadMesh, values: npt.ArrayLike, limited: bool = True, unrolled: Unrolled | None = None
    ) -> None:
        checked = values_on_nodes(values, mesh, "values")
        if unrolled is None:
            if mesh.is_folded:
                raise InputError(
                    "the mesh is folded, or has a coordinate that is not finite: no function on its nodes is one of x"
                    " and y; give a mesh whose min_jacobian is positive",
                    field="mesh",
                )
            unrolled = Unrolled.of(mesh)
        own = np.array(checked[unrolled.nodes])
        bumps = edge_bumps(unrolled.search, own, limited)
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


def values_on_nodes(values: npt.ArrayLike, mesh: QuadMesh, name: str) -> Array:
    """Finite numbers at all nodes; raises :class:`~equimesh.errors.SamplesError` with ``name`` as its field."""
    checked = real_array(values, name, ndim=1)
    if checked.shape != mesh.node_shape:
        raise SamplesError(
            f"{name} has shape {checked.shape}, but the mesh has {len(mesh.points)} nodes: one value is needed at each",
            field=name,
        )
    large = np.abs(checked) > LIMITS.magnitude
    if large.any():
        k = int(np.argmax(large))
        raise SamplesError(
            f"{name}[{k}] = {checked[k]:.6g}: at most {LIMITS.magnitude:g} in size is allowed; rescale it", field=name
        )
    return checked


def edge_bumps(search: QuadSearch, values: Array, limited: bool) -> Array:
    """What the cubics add to linear interpolation on the edges of each cell, shape ``(m, 4, 2)``.

    The edges are the lower, upper, left and right one; see :class:`~equimesh.fields.hermite_field.EdgeBumps`.
    """
    (x, y), cells = search.nodes, search.links.cells
    u_x, u_y = quad_gradients(search.nodes, search.links, values)
    bumps = np.empty((len(cells), 4, 2))
    for edge, (begin, end) in enumerate(EDGE_ENDS):
        a, b = cells[:, begin], cells[:, end]
        dx, dy, rise = x[b] - x[a], y[b] - y[a], values[b] - values[a]
        low, high = np.minimum(0.0, MAX_SLOPE * rise), np.maximum(0.0, MAX_SLOPE * rise)
        for side, node in enumerate((a, b)):
            at = u_x[node] * dx + u_y[node] * dy
            bumps[:, edge, side] = (np.clip(at, low, high) if limited else at) - rise
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
