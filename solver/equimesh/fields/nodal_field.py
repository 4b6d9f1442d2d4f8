"""u by values at the nodes of a mesh, as a function of x and y."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import scipy

from equimesh.errors import SamplesError
from equimesh.fields.bicubic import Bicubic, slopes_on_mesh
from equimesh.fields.mesh_map import (
    MIN_STEP_CELLS,
    MeshMap,
    Places,
    find_cells,
    known_points,
    place_in_cells,
    require_unfolded,
    through,
)
from equimesh.formulas.vocabulary import LIMITS
from equimesh.inputs import AT_PLACES, brackets, shaped_array
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.quad_search import KeptCells
from equimesh.numerics.compiled import compiled, inlined
from equimesh.numerics.types import Array, IntArray, IntPair, Pair


@dataclass(frozen=True, kw_only=True, eq=False, repr=False, init=False)
class NodalField:
    """u from ``values`` of shape ``(n_xi, n_eta)`` at the nodes of ``mesh``.

    u and the map of the mesh are bicubic splines over its grid, so that linear functions are exact on every mesh; for a
    smooth map and smooth u the values are accurate to O(h^4), the gradient to O(h^3), second derivatives to O(h^2).
    Where the spline of a strongly graded mesh cannot be inverted, u is bilinear in the cell; outside the mesh the
    nearest point of its side is used.

    Implements :class:`~equimesh.fields.expression.Field`. Raises :class:`~equimesh.errors.SamplesError`, which names
    the first bad index, and :class:`~equimesh.errors.InputError` for a folded mesh.
    """

    mesh: Mesh
    values: Array
    mesh_map: MeshMap
    _spline: Bicubic

    def __init__(self, *, mesh: Mesh, values: npt.ArrayLike) -> None:
        checked = nodal_values(values, mesh)
        for name, value in {
            "mesh": mesh, "values": checked, "mesh_map": MeshMap.of(mesh), "_spline": through(checked),
        }.items():  # fmt: skip
            object.__setattr__(self, name, value)

    def evaluate(self, x: Array, y: Array, order: int = 0) -> tuple[Array, ...]:
        """u and its partial derivatives up to ``order``, each of the points' shape: see ``Field.evaluate``."""
        x, y = np.broadcast_arrays(x, y)
        if order == 0 and np.array_equal(x, self.mesh.x) and np.array_equal(y, self.mesh.y):
            return (self.values.copy(),)
        places = self.mesh_map.locate(x, y)
        parts = list(self._derivatives(places, order))
        if not places.smooth.all():
            rough = np.flatnonzero(~places.smooth)
            for part, bilinear in zip(parts, in_cells(self.mesh_map.mesh, self.values, places, rough), strict=False):
                part[rough] = bilinear
        nowhere = np.isnan(x) | np.isnan(y)
        if not nowhere.any():
            return tuple(part.reshape(x.shape) for part in parts)
        return tuple(np.where(nowhere, np.nan, part.reshape(x.shape)) for part in parts)

    def __repr__(self) -> str:
        return f"NodalField({self.mesh.grid})"

    def _derivatives(self, places: Places, order: int) -> tuple[Array, ...]:
        """By the chain rule from those over the grid."""
        patches = self._spline.polynomials, self.mesh_map.x.polynomials, self.mesh_map.y.polynomials
        if order == 1 and patches[0] is not None and patches[1] is not None and patches[2] is not None:
            rows, axes = np.empty((3, places.s.size)), (self._spline.along_x, self._spline.along_y)
            slopes_on_mesh(places.s, places.t, *axes, patches[0], (patches[1], patches[2]), rows)
            return tuple(rows)
        u, *of_u = self._spline.evaluate(places.s, places.t, order)
        if order == 0:
            return (u,)
        along = self.mesh_map.x, self.mesh_map.y
        (_, *of_x), (_, *of_y) = (part.evaluate(places.s, places.t, order) for part in along)
        (x_s, x_t), (y_s, y_t) = of_x[:2], of_y[:2]
        with np.errstate(all="ignore"):  # where it is not smooth, these values are replaced
            per_det = 1.0 / (x_s * y_t - x_t * y_s)
            s_x, s_y, t_x, t_y = y_t * per_det, -x_t * per_det, -y_s * per_det, x_s * per_det
            u_x, u_y = of_u[0] * s_x + of_u[1] * t_x, of_u[0] * s_y + of_u[1] * t_y
            if order == 1:
                return u, u_x, u_y
            ss, st, tt = (of_u[k] - u_x * of_x[k] - u_y * of_y[k] for k in (2, 3, 4))
            u_xx = s_x * (ss * s_x + st * t_x) + t_x * (st * s_x + tt * t_x)
            u_xy = s_x * (ss * s_y + st * t_y) + t_x * (st * s_y + tt * t_y)
            u_yy = s_y * (ss * s_y + st * t_y) + t_y * (st * s_y + tt * t_y)
        return u, u_x, u_y, u_xx, u_xy, u_yy


def nodal_values(values: npt.ArrayLike, mesh: Mesh) -> Array:
    """Finite numbers at all nodes of any mesh; raises :class:`~equimesh.errors.SamplesError` for ``values``."""
    checked = shaped_array(values, "values", mesh.node_shape, AT_PLACES["nodes"])
    large = np.abs(checked) > LIMITS.magnitude
    if large.any():
        index = tuple(np.argwhere(large)[0])
        raise SamplesError(
            f"values{brackets(index)} = {checked[index]:.6g}: at most {LIMITS.magnitude:g} in size is allowed; rescale"
            " it",
            field="values",
        )
    return np.ascontiguousarray(checked)


def in_cells(mesh: Mesh, values: Array, places: Places, which: npt.NDArray[np.int64]) -> tuple[Array, ...]:
    """u, u_x, u_y of the bilinear cells, and second derivatives, which are set to zero."""
    i = np.minimum(places.s[which].astype(int), mesh.x.shape[0] - 2)
    j = np.minimum(places.t[which].astype(int), mesh.x.shape[1] - 2)
    a, b = places.s[which] - i, places.t[which] - j

    def at(nodal: Array) -> tuple[Array, Array, Array]:
        lower, upper = nodal[i, j] + b * (nodal[i, j + 1] - nodal[i, j]), nodal[i + 1, j]
        upper = upper + b * (nodal[i + 1, j + 1] - nodal[i + 1, j])
        across = nodal[i, j + 1] - nodal[i, j]
        return lower + a * (upper - lower), upper - lower, across + a * (nodal[i + 1, j + 1] - nodal[i + 1, j] - across)

    (u, u_s, u_t), (_, x_s, x_t), (_, y_s, y_t) = at(values), at(mesh.x), at(mesh.y)
    det, nothing = x_s * y_t - x_t * y_s, np.zeros(which.size)
    return u, (u_s * y_t - u_t * y_s) / det, (u_t * x_s - u_s * x_t) / det, nothing, nothing, nothing


# Gradients of u at the nodes of a mesh, from differences of the nodal values along its grid lines.

MIN_SINE = 0.02
"""The smallest sine of the angle between the two grid lines of a node at which both lines give its gradient."""


def nodal_gradients(x: Array, y: Array, values: Array) -> Pair:
    """``(u_x, u_y)`` at the nodes of a mesh without folds; all arrays have the shape ``(n_xi, n_eta)``.

    By the chain rule from the derivatives of x, y and u along both grid lines of a node. These are those of the
    parabola through three neighbouring nodes over the length of the line, one-sided at a side. Linear functions are
    exact; for a smooth u on smooth meshes the error is O(h^2). Where both lines have nearly one direction, the mean
    of the gradients in the cells around the node is taken, weighted by their areas.
    """
    x_s, y_s, u_s = _along(x, y, values)
    x_t, y_t, u_t = (part.T for part in _along(x.T, y.T, values.T))
    det = x_s * y_t - x_t * y_s
    poor = det < MIN_SINE * np.hypot(x_s, y_s) * np.hypot(x_t, y_t)
    per_det = 1.0 / np.where(poor, 1.0, det)
    u_x, u_y = (u_s * y_t - u_t * y_s) * per_det, (u_t * x_s - u_s * x_t) * per_det
    if poor.any():
        mean_x, mean_y = _cell_means(x, y, values)
        u_x, u_y = np.where(poor, mean_x, u_x), np.where(poor, mean_y, u_y)
    return u_x, u_y


def _along(x: Array, y: Array, values: Array) -> tuple[Array, Array, Array]:
    """The derivatives of x, y and u along the lines of the first index, by the length of the line."""
    steps = np.hypot(np.diff(x, axis=0), np.diff(y, axis=0))
    before, after = steps[:-1], steps[1:]
    share = before / (before + after)

    def derivative(nodal: Array) -> Array:
        slopes = np.diff(nodal, axis=0) / steps
        out = np.empty_like(nodal)
        out[1:-1] = (1.0 - share) * slopes[:-1] + share * slopes[1:]
        out[0] = slopes[0] + (slopes[0] - out[1])
        out[-1] = slopes[-1] + (slopes[-1] - out[-2])
        return out

    return derivative(x), derivative(y), derivative(values)


def _cell_means(x: Array, y: Array, values: Array) -> Pair:
    """The gradients in the centres of the cells around each node, in the mean by area."""

    def diagonals(nodal: Array) -> Pair:
        return nodal[1:, 1:] - nodal[:-1, :-1], nodal[:-1, 1:] - nodal[1:, :-1]

    (x_a, x_b), (y_a, y_b), (u_a, u_b) = diagonals(x), diagonals(y), diagonals(values)
    # By Green's formula the integral of the gradient; the area is half of det.
    det = x_a * y_b - x_b * y_a
    parts = [_sum_at_nodes(part) for part in (u_a * y_b - u_b * y_a, u_b * x_a - u_a * x_b, det)]
    return parts[0] / parts[2], parts[1] / parts[2]


def _sum_at_nodes(cells: Array) -> Array:
    """The sum over the cells around each node."""
    out = np.zeros((cells.shape[0] + 1, cells.shape[1] + 1))
    for di in (0, 1):
        for dj in (0, 1):
            out[di : di + cells.shape[0], dj : dj + cells.shape[1]] += cells
    return out


# u by values at the nodes of a mesh, without overshoots: limited cubics on the edges, blended inside the cells.

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

    On an edge u is the cubic with the slopes of :func:`~equimesh.fields.nodal_field.nodal_gradients` at its ends,
    limited to between 0 and three times the slope of the edge: it is monotone, so that layers thinner than a cell do
    not overshoot (F. N. Fritsch and R. E. Carlson, *Monotone piecewise cubic interpolation*, SIAM J. Numer. Anal. 17,
    1980). In a cell the edges are blended (S. A. Coons, 1967) over the bilinear map, which always has an inverse.
    Linear functions are exact on every mesh; for smooth u and meshes the error is O(h^3), at extrema O(h^2). Where it
    is ``fitted``, slopes are those of :func:`patch_gradients` and not limited, so that
    the error is O(h^4). u is continuous, its gradient is so inside the cells and, where nothing is limited, at the
    nodes. A point outside of the mesh has the values of a point of its side.

    Implements :class:`~equimesh.fields.expression.Field`. Raises :class:`~equimesh.errors.SamplesError`, which names
    the first bad index, and :class:`~equimesh.errors.InputError` for a folded mesh.
    """

    mesh: Mesh
    values: Array
    _bumps: EdgeBumps
    _kept: KeptCells

    def __init__(self, *, mesh: Mesh, values: npt.ArrayLike, fitted: bool = False) -> None:
        checked = nodal_values(values, mesh)
        require_unfolded(mesh)
        # Copies that may be written to: Numba would compile the loops again for arrays of another kind.
        own, checked = Mesh(*(np.array(q, dtype=float, order="C") for q in (mesh.x, mesh.y))), checked.copy()
        for name, value in {
            "mesh": own, "values": checked, "_bumps": edge_bumps(own, checked, fitted),
            "_kept": KeptCells.of((own.x, own.y), own.x.size),
        }.items():  # fmt: skip
            object.__setattr__(self, name, value)

    def evaluate(self, x: Array, y: Array, order: int = 0) -> tuple[Array, ...]:
        """u and its partial derivatives up to ``order``, each of the points' shape: see ``Field.evaluate``."""
        x, y = np.broadcast_arrays(x, y)
        points, lost, columns = known_points(x, y, self.mesh)
        rows, call = np.empty((COUNT[order], points[0].size)), self._kept.call(points)
        before = self._kept.cells.get(call)
        cells = np.full((2, points[0].size), -1) if before is None else before.copy()
        of_cells = cells[0], cells[1]
        evaluate_points(points, (self.mesh.x, self.mesh.y), self.values, self._bumps, columns, of_cells, rows)
        self._kept.keep(call, cells)
        if lost is not None:
            rows[:, lost] = np.nan
        return tuple(row.reshape(x.shape) for row in rows)

    def __repr__(self) -> str:
        return f"HermiteField({self.mesh.grid})"


def edge_bumps(mesh: Mesh, values: Array, fitted: bool = False) -> EdgeBumps:
    """What the limited cubics add on all edges, or those with the slopes of cubics that are fitted."""
    x, y = mesh.x, mesh.y
    if fitted:
        u_x, u_y = (slope.reshape(x.shape) for slope in patch_gradients(mesh.points, mesh.cells, values.ravel()))
    else:
        u_x, u_y = nodal_gradients(x, y, values)
    along_xi = _bumps(x, y, values, u_x, u_y, fitted)
    along_eta = _bumps(x.T, y.T, values.T, u_x.T, u_y.T, fitted).transpose(1, 0, 2)
    return EdgeBumps(np.ascontiguousarray(along_xi), np.ascontiguousarray(along_eta))


def _bumps(x: Array, y: Array, values: Array, u_x: Array, u_y: Array, fitted: bool) -> Array:
    """End slopes less the chord, of the edges along the first index, shape ``(n_xi - 1, n_eta, 2)``."""
    dx, dy, rise = np.diff(x, axis=0), np.diff(y, axis=0), np.diff(values, axis=0)
    ends = [u_x[part] * dx + u_y[part] * dy for part in (np.s_[:-1], np.s_[1:])]
    if not fitted:
        low, high = np.minimum(0.0, MAX_SLOPE * rise), np.maximum(0.0, MAX_SLOPE * rise)
        ends = [np.clip(end, low, high) for end in ends]
    return np.stack([end - rise for end in ends], axis=-1)


@compiled
def evaluate_points(
    points: Pair, nodes: Pair, values: Array, bumps: EdgeBumps, columns: int, cells: IntPair, rows: Array
) -> None:
    """Fill ``rows`` of shape ``(1, 3 or 6, points)``, and ``cells`` as :func:`~equimesh.fields.mesh_map.find_cells`."""
    (px, _), (x, y) = points, nodes
    of_xi, of_eta = bumps
    count = rows.shape[0]
    places = np.empty(px.size), np.empty(px.size)
    find_cells(points, nodes, columns, cells)
    place_in_cells(points, nodes, cells, MIN_STEP_CELLS, places)
    for k in range(px.size):
        i, j = cells[0][k], cells[1][k]
        s, t = places[0][k] - i, places[1][k] - j
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
    """The first derivative of the cubic along the edge."""
    return p * (1.0 - a) * (1.0 - 3.0 * a) - q * a * (2.0 - 3.0 * a)


@inlined
def bend(p: float, q: float, a: float) -> float:
    """The second derivative of the cubic along the edge."""
    return p * (6.0 * a - 4.0) - q * (2.0 - 6.0 * a)


# Gradients at the nodes of a mesh from cubics that are fitted to the values at the nodes around.

POWERS = tuple((i, k - i) for k in (1, 2, 3) for i in range(k, -1, -1))
"""The monomials of a cubic without its constant, which is the value at the node; the first two are linear."""
RIDGE = 1e-15
"""The share of the mean of the diagonal that is added to it: patches of few layers do not determine all monomials."""
MAX_NODES = 4096
"""Nodes whose cubics are fitted at once."""


def patch_gradients(points: Array, cells: IntArray, values: Array) -> Pair:
    """``(u_x, u_y)`` at the nodes ``points``, shape ``(n, 2)``, of quadrilaterals ``(m, 4)``, from ``values`` ``(n,)``.

    The cubic through the value at a node fits the values at the nodes of two layers of cells around it best, of three
    at and next to the boundary, by squares over squared distances, which are measured by the shape of the patch. Cubics
    are exact on every mesh, so that gradients are accurate to O(h^3).

    Source: Z. Zhang and A. Naga, *A new finite element gradient recovery method: superconvergence property*, SIAM J.
    Sci. Comput. 26 (2005): polynomials of degree p + 1 for elements of degree p.
    """
    starts, patches = _patches(points, cells)
    sizes, gradients = np.diff(starts), np.empty((len(points), 2))
    for first in range(0, len(points), MAX_NODES):
        some = np.arange(first, min(first + MAX_NODES, len(points)))
        places = np.arange(int(sizes[some].max()))
        is_there = places < sizes[some, None]
        around = patches[np.minimum(starts[some, None] + places, len(patches) - 1)]
        around = np.where(is_there, around, some[:, None])
        gradients[some] = _fitted(points[around] - points[some, None], values[around] - values[some, None])
    return gradients[:, 0], gradients[:, 1]


def _patches(points: Array, cells: IntArray) -> tuple[IntArray, IntArray]:
    """Where the patch of each node begins, shape ``(n + 1,)``, and the nodes of all patches."""
    corners = np.repeat(np.arange(len(cells)), 4), cells.ravel()
    of_cells = scipy.sparse.csr_array((np.ones(cells.size), corners), shape=(len(cells), len(points)))
    near = of_cells.T @ of_cells
    near.data[:] = 1.0
    two = near @ near
    ends = np.sort(np.stack([cells, np.roll(cells, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    _, place, count = np.unique(ends[:, 0] << 32 | ends[:, 1], return_inverse=True, return_counts=True)
    at_boundary = np.zeros(len(points))
    at_boundary[ends[count[place] == 1]] = 1.0
    wide = np.asarray(near @ at_boundary > 0.0)
    rows = scipy.sparse.diags_array(wide.astype(float)).tocsr()
    rest = scipy.sparse.diags_array((~wide).astype(float)).tocsr()
    every = (rest @ two + (rows @ two) @ near).tocsr()
    every.eliminate_zeros()
    return every.indptr.astype(np.int64), every.indices.astype(np.int64)


def _fitted(offsets: Array, rises: Array) -> Array:
    """The gradients of cubics, shape ``(n, 2)``, from the places and values of patches, relative to those of the node.

    ``offsets`` have the shape ``(n, k, 2)``, ``rises`` ``(n, k)``; entries without an offset do not count.
    """
    spread = np.einsum("nki,nkj->nij", offsets, offsets)
    factor = np.linalg.cholesky(spread / max(1, offsets.shape[1]))
    local = np.linalg.solve(factor, offsets.swapaxes(1, 2))
    squares = (local**2).sum(axis=1)
    weights = np.divide(1.0, squares, out=np.zeros_like(squares), where=squares > 0.0)
    monomials = np.stack([local[:, 0] ** i * local[:, 1] ** j for i, j in POWERS], axis=1)
    weighted = monomials * weights[:, None]
    normal = weighted @ monomials.swapaxes(1, 2)
    ridge = RIDGE * np.trace(normal, axis1=1, axis2=2) / len(POWERS)
    normal += ridge[:, None, None] * np.eye(len(POWERS))
    slopes = np.linalg.solve(normal, weighted @ rises[..., None])[:, :2]
    return np.asarray(np.linalg.solve(factor.swapaxes(1, 2), slopes)[..., 0])
