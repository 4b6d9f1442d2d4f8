"""u by values at the nodes of a mesh, without overshoots: limited cubics on the edges, blended inside the cells."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from equimesh.errors import InputError
from equimesh.fields.mesh_map import MIN_STEP_CELLS, walk, within
from equimesh.fields.nodal_field import nodal_values
from equimesh.fields.nodal_gradients import nodal_gradients
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.compiled import compiled, inlined
from equimesh.numerics.types import Array, Pair

COUNT = (1, 3, 6)
"""The number of values up to each order: u; u_x, u_y; u_xx, u_xy, u_yy."""
MAX_SLOPE = 3.0
"""The steepest end of a cubic over the slope of its edge: up to it the cubic is monotone."""


class EdgeBumps(NamedTuple):
    """What the cubics on the edges add to linear interpolation: ``a (1 - a) (p (1 - a) - q a)``, a from 0 to 1.

    p and q are in the last index: of the edges along xi, shape ``(n_xi - 1, n_eta, 2)``, and of those along eta,
    ``(n_xi, n_eta - 1, 2)``.
    """

    along_xi: Array
    along_eta: Array


@dataclass(frozen=True, kw_only=True, eq=False, repr=False, init=False)
class HermiteField:
    """u from ``values`` of shape ``(n_xi, n_eta)`` at the nodes of ``mesh``, as limited cubics.

    On an edge u is the cubic with the slopes of :func:`~equimesh.fields.nodal_gradients.nodal_gradients` at its ends,
    limited to between 0 and three times the slope of the edge: it is monotone, so that layers thinner than a cell do
    not overshoot (F. N. Fritsch and R. E. Carlson, *Monotone piecewise cubic interpolation*, SIAM J. Numer. Anal. 17,
    1980). In a cell the edges are blended (S. A. Coons, 1967) over the bilinear map, which always has an inverse.
    Linear functions are exact on every mesh; for smooth u and meshes the error is O(h^3), at extrema O(h^2). u is
    continuous, its gradient is so inside the cells and, where nothing is limited, at the nodes. A point outside of the
    mesh has the values of a point of its side.

    Implements :class:`~equimesh.fields.field.Field`. Raises :class:`~equimesh.errors.SamplesError`, which names the
    first bad index, and :class:`~equimesh.errors.InputError` for a folded mesh.
    """

    mesh: Mesh
    values: Array
    _bumps: EdgeBumps

    def __init__(self, *, mesh: Mesh, values: npt.ArrayLike) -> None:
        checked = nodal_values(values, mesh, "values")
        if mesh.is_folded:
            raise InputError(
                "the mesh is folded, or has a coordinate that is not finite: no function on its nodes is one of x and"
                " y; give a mesh whose min_jacobian is positive",
                field="mesh",
            )
        # Copies that may be written to: Numba would compile the loops again for arrays of another kind.
        own, checked = Mesh(*(np.array(q, dtype=float, order="C") for q in (mesh.x, mesh.y))), checked.copy()
        for name, value in {"mesh": own, "values": checked, "_bumps": edge_bumps(own, checked)}.items():
            object.__setattr__(self, name, value)

    def evaluate(self, x: Array, y: Array, order: int = 0) -> tuple[Array, ...]:
        """u and its partial derivatives up to ``order``, each of the points' shape: see ``Field.evaluate``."""
        x, y = np.broadcast_arrays(x, y)
        flat = np.ascontiguousarray(x, dtype=float).reshape(-1), np.ascontiguousarray(y, dtype=float).reshape(-1)
        rows = np.empty((COUNT[order], flat[0].size))
        evaluate_points(flat, (self.mesh.x, self.mesh.y), self.values, self._bumps, rows)
        return tuple(row.reshape(x.shape) for row in rows)

    def __repr__(self) -> str:
        return f"HermiteField({self.mesh.grid})"


def edge_bumps(mesh: Mesh, values: Array) -> EdgeBumps:
    """What the limited cubics add on all edges."""
    x, y = mesh.x, mesh.y
    u_x, u_y = nodal_gradients(x, y, values)
    along_xi = _bumps(x, y, values, u_x, u_y)
    along_eta = _bumps(x.T, y.T, values.T, u_x.T, u_y.T).transpose(1, 0, 2)
    return EdgeBumps(np.ascontiguousarray(along_xi), np.ascontiguousarray(along_eta))


def _bumps(x: Array, y: Array, values: Array, u_x: Array, u_y: Array) -> Array:
    """Those of the edges along the first index."""
    dx, dy, rise = np.diff(x, axis=0), np.diff(y, axis=0), np.diff(values, axis=0)
    low, high = np.minimum(0.0, MAX_SLOPE * rise), np.maximum(0.0, MAX_SLOPE * rise)
    ends = [np.clip(u_x[part] * dx + u_y[part] * dy, low, high) - rise for part in (np.s_[:-1], np.s_[1:])]
    return np.stack(ends, axis=-1)


@compiled
def evaluate_points(points: Pair, nodes: Pair, values: Array, bumps: EdgeBumps, rows: Array) -> None:
    """Fill ``rows`` of shape ``(1, 3 or 6, points)``. It is fast where each point is near the one before it."""
    (px, py), (x, y) = points, nodes
    of_xi, of_eta = bumps
    count = rows.shape[0]
    i = j = 0
    for k in range(px.size):
        if not (np.isfinite(px[k]) and np.isfinite(py[k])):
            for row in range(count):
                rows[row, k] = np.nan
            continue
        i, j = walk(px[k], py[k], x, y, i, j)
        s, t = within(px[k], py[k], x, y, i, j, MIN_STEP_CELLS)
        s, t = s - i, t - j
        v00, v10, v11, v01 = values[i, j], values[i + 1, j], values[i + 1, j + 1], values[i, j + 1]
        pb, qb, pt, qt = of_xi[i, j, 0], of_xi[i, j, 1], of_xi[i, j + 1, 0], of_xi[i, j + 1, 1]
        pl, ql, pr, qr = of_eta[i, j, 0], of_eta[i, j, 1], of_eta[i + 1, j, 0], of_eta[i + 1, j, 1]
        b, c, left, right = bump(pb, qb, s), bump(pt, qt, s), bump(pl, ql, t), bump(pr, qr, t)
        lower, upper = v00 + s * (v10 - v00), v01 + s * (v11 - v01)
        rows[0, k] = lower + t * (upper - lower) + b + t * (c - b) + left + s * (right - left)
        if count == 1:
            continue
        db, dc, dl, dr = slope(pb, qb, s), slope(pt, qt, s), slope(pl, ql, t), slope(pr, qr, t)
        u_s = (1.0 - t) * (v10 - v00 + db) + t * (v11 - v01 + dc) + right - left
        u_t = upper - lower + c - b + (1.0 - s) * dl + s * dr
        x_s = (1.0 - t) * (x[i + 1, j] - x[i, j]) + t * (x[i + 1, j + 1] - x[i, j + 1])
        y_s = (1.0 - t) * (y[i + 1, j] - y[i, j]) + t * (y[i + 1, j + 1] - y[i, j + 1])
        x_t = (1.0 - s) * (x[i, j + 1] - x[i, j]) + s * (x[i + 1, j + 1] - x[i + 1, j])
        y_t = (1.0 - s) * (y[i, j + 1] - y[i, j]) + s * (y[i + 1, j + 1] - y[i + 1, j])
        per_det = 1.0 / (x_s * y_t - x_t * y_s)
        s_x, s_y, t_x, t_y = y_t * per_det, -x_t * per_det, -y_s * per_det, x_s * per_det
        u_x, u_y = u_s * s_x + u_t * t_x, u_s * s_y + u_t * t_y
        rows[1, k], rows[2, k] = u_x, u_y
        if count == 3:
            continue
        x_st = x[i, j] - x[i + 1, j] + x[i + 1, j + 1] - x[i, j + 1]
        y_st = y[i, j] - y[i + 1, j] + y[i + 1, j + 1] - y[i, j + 1]
        ss = (1.0 - t) * bend(pb, qb, s) + t * bend(pt, qt, s)
        tt = (1.0 - s) * bend(pl, ql, t) + s * bend(pr, qr, t)
        st = v00 - v10 + v11 - v01 + dc - db + dr - dl - u_x * x_st - u_y * y_st
        rows[3, k] = s_x * (ss * s_x + st * t_x) + t_x * (st * s_x + tt * t_x)
        rows[4, k] = s_x * (ss * s_y + st * t_y) + t_x * (st * s_y + tt * t_y)
        rows[5, k] = s_y * (ss * s_y + st * t_y) + t_y * (st * s_y + tt * t_y)


@inlined
def bump(p: float, q: float, a: float) -> float:
    """What a cubic adds to its edge."""
    return a * (1.0 - a) * (p * (1.0 - a) - q * a)


@inlined
def slope(p: float, q: float, a: float) -> float:
    """Its first derivative along the edge."""
    return p * (1.0 - a) * (1.0 - 3.0 * a) - q * a * (2.0 - 3.0 * a)


@inlined
def bend(p: float, q: float, a: float) -> float:
    """Its second derivative."""
    return p * (6.0 * a - 4.0) - q * (2.0 - 6.0 * a)
