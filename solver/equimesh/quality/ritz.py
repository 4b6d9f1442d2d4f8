"""What a solver gets from a mesh: the error of finite elements for Poisson's equation with u as solution.

The solution u_h of bilinear elements is the Ritz projection of u: ``a(u_h, v) = a(u, v)`` for all v of the elements
that vanish on the boundary, with ``a(u, v)`` the integral of ``grad u . grad v``, and u_h = u at the boundary nodes.
The load is assembled from the gradient of u itself, so that no source is needed. The error has two parts. The
interpolant ``I u`` differs from u, and the solver adds ``w = u_h - I u``, with ``a(w, v) = a(u - I u, v)``: this part
is large on distorted cells. On triangles the elements are linear.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy

from equimesh.fields.expression import Field
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array, IntArray, Pair
from equimesh.quality.cell_maps import locate
from equimesh.quality.cells import CellPoints, QuadCells
from equimesh.quality.interpolation import gain_of, noise
from equimesh.quality.tally import add_errors
from equimesh_coupling.parts import CUTS, better_cuts, cuts_at_corners
from equimesh_schema.certificate import SolverGain

GAUSS_POINTS = 3
"""Gauss points per direction and cell, of the load, of the matrix and of the errors."""
MAX_GRID_POINTS = 65 * 65
"""Nodes, at most, on which a grid is measured: on larger ones every second, third, ... node is taken."""
MAX_BLOCK_POINTS = 129 * 129
"""Nodes, at most, of blocks that are measured: a direct solve takes a tenth of a second there."""
PAIRS = ((0, 0), (0, 1), (0, 2), (0, 3), (1, 1), (1, 2), (1, 3), (2, 2), (2, 3), (3, 3))
"""The pairs of corners of a cell, in the order of the entries of its matrix."""


@dataclass(frozen=True, kw_only=True)
class RitzErrors:
    """The errors of the Ritz projection of u: ``l2`` of u in its units times a length, ``h1`` of its gradient."""

    l2: float
    h1: float
    rounding: tuple[float, float] = (0.0, 0.0)
    """The parts of the two that rounding causes."""

    def gain(self, there: RitzErrors, norm: Literal["l2", "h1"]) -> float:
        """How many times smaller the error in ``norm`` is than that ``there``, on another mesh; NaN if not known."""
        if norm == "l2":
            return gain_of(there.l2, self.l2, self.rounding[0])
        return gain_of(there.h1, self.h1, self.rounding[1])


UNKNOWN = RitzErrors(l2=math.nan, h1=math.nan)
"""The errors on a folded mesh, and of a u whose gradient is not finite."""


def solver_gain(mesh: Mesh, uniform: Mesh, u: Field, *, triangles: bool = False) -> SolverGain | None:
    """How many times smaller the error of a solver is on ``mesh`` than on ``uniform``, in L2 and in H1.

    ``uniform`` is the uniform mesh of the domain, of blocks the initial one: a mesh with the same cells. With
    ``triangles`` the elements are linear on the triangles into which the cells are cut. On more than
    ``MAX_GRID_POINTS`` points of a grid both errors are those on every second, third, ... node, and ``points`` tells
    how many. ``None`` for a larger mesh of blocks. NaN where an error is not known.
    """
    if not mesh.is_grid and len(mesh.points) > MAX_BLOCK_POINTS:
        return None
    found = [coarsened(one) for one in (mesh, uniform)]
    here, there = (ritz_errors(one, u, triangles=triangles) for one in found)
    return SolverGain(l2=here.gain(there, "l2"), h1=here.gain(there, "h1"), points=len(found[0].points))


def coarsened(mesh: Mesh) -> Mesh:
    """The mesh with one number for each node; of a grid with many points every second, third, ... line and the last."""
    if not mesh.is_grid:
        return mesh
    step = next(step for step in range(1, mesh.x.size) if _kept(mesh.x.shape, step) <= MAX_GRID_POINTS)
    lines = [_lines(count, step) for count in mesh.x.shape]
    number = np.full(mesh.x.shape, -1)
    number[np.ix_(*lines)] = np.arange(lines[0].size * lines[1].size).reshape(lines[0].size, lines[1].size)
    kept = Mesh(*(np.ascontiguousarray(q[np.ix_(*lines)]) for q in (mesh.x, mesh.y)))
    tied = number.ravel()[mesh.ties]
    return Mesh(points=kept.points, cells=kept.cells, sides=kept.sides, ties=tied[(tied >= 0).all(axis=1)])


def _lines(count: int, step: int) -> IntArray:
    """The numbers of the lines that are kept: the first, the last, and others as evenly as can be."""
    cells = max(1, (count - 1) // step)
    return np.round(np.linspace(0, count - 1, cells + 1)).astype(np.int64)


def _kept(shape: tuple[int, ...], step: int) -> int:
    return math.prod(_lines(count, step).size for count in shape)


def ritz_errors(mesh: Mesh, u: Field, *, triangles: bool = False) -> RitzErrors:
    """The errors of the Ritz projection of u on all cells of ``mesh``, or on the ``triangles`` of them.

    One sparse direct solve; :data:`UNKNOWN` where the mesh is folded, or an error is not finite.
    """
    with np.errstate(all="ignore"):
        cells = QuadCells(mesh)
        if not cells.all_valid:
            return UNKNOWN
        nodes = _elements(mesh, triangles=triangles)
        points, count = CellPoints.gauss(GAUSS_POINTS), len(mesh.points)
        corners = np.ascontiguousarray(np.concatenate([mesh.x[nodes], mesh.y[nodes]]))
        x, y = np.empty((2, points.s.size, nodes.shape[1]))
        locate(corners, points.s, points.t, x, y)
        here, u_x, u_y = (np.ascontiguousarray(part) for part in u.evaluate(x, y, order=1))
        nodal = u.evaluate(np.ascontiguousarray(mesh.x), np.ascontiguousarray(mesh.y))[0]
        numbers = _unknowns(cells, count)
        matrices, loads = np.zeros((len(PAIRS), nodes.shape[1])), np.zeros((4, nodes.shape[1]))
        assemble(corners, np.ascontiguousarray(nodal[nodes]), (u_x, u_y), points, matrices, loads)
        if not (np.isfinite(matrices).all() and np.isfinite(loads).all()):
            return UNKNOWN
        added = _solved(numbers[nodes], matrices, loads)
        values = nodal + np.where(numbers < 0, 0.0, added[numbers])
        sums, largest = np.zeros((4, nodes.shape[1])), np.zeros(nodes.shape[1])
        add_errors(corners, np.ascontiguousarray(values[nodes]), here, (u_x, u_y), points, sums, largest)
        l2, h1 = (math.sqrt(total) if math.isfinite(total) else math.nan for total in sums[:2].sum(axis=1))
        return RitzErrors(l2=l2, h1=h1, rounding=noise(cells, float(np.abs(nodal).max())))


def _elements(mesh: Mesh, *, triangles: bool) -> IntArray:
    """The nodes of every element, shape ``(4, elements)``; a triangle is a cell whose last two corners are one."""
    if not triangles:
        return np.ascontiguousarray(mesh.cells.T)
    cuts = CUTS[better_cuts(mesh.points[mesh.cells], cuts_at_corners(mesh.cells))].reshape(-1, 3)
    which = np.concatenate([cuts, cuts[:, 2:]], axis=1)
    return np.ascontiguousarray(np.take_along_axis(np.repeat(mesh.cells, 2, axis=0), which, axis=1).T)


def _unknowns(cells: QuadCells, count: int) -> IntArray:
    """The number of the unknown at each node, -1 on the boundary; copies of tied nodes have that of their original.

    Without a boundary, one node is fixed.
    """
    mesh, edges = cells.mesh, cells.edges
    outer = edges.is_outer
    cell, place = edges.cells[outer, 0], edges.places[outer, 0]
    original = np.arange(count)
    original[mesh.ties[:, 0]] = mesh.ties[:, 1]
    original = original[original]
    fixed = np.zeros(count, dtype=bool)
    for step in (0, 1):
        fixed[original[mesh.cells[cell, (place + step) % 4]]] = True
    if not fixed.any():
        fixed[original[0]] = True
    is_unknown = ~fixed & (original == np.arange(count))
    numbers = np.where(is_unknown, np.cumsum(is_unknown) - 1, -1)
    return np.asarray(numbers[original])


def _solved(numbers: IntArray, matrices: Array, loads: Array) -> Array:
    """The values at the unknowns, from the matrices and loads of the elements; ``numbers`` of shape (4, elements)."""
    count = int(numbers.max(initial=-1)) + 1
    if count == 0:
        return np.zeros(1)
    rows = np.concatenate([numbers[a] for a, _ in PAIRS] + [numbers[b] for a, b in PAIRS if a != b])
    columns = np.concatenate([numbers[b] for _, b in PAIRS] + [numbers[a] for a, b in PAIRS if a != b])
    entries = np.concatenate([*matrices, *(row for row, (a, b) in zip(matrices, PAIRS, strict=True) if a != b)])
    free = (rows >= 0) & (columns >= 0)
    matrix = scipy.sparse.csc_matrix((entries[free], (rows[free], columns[free])), shape=(count, count))
    known = numbers.ravel() >= 0
    load = np.bincount(numbers.ravel()[known], loads.ravel()[known], count)
    factors = scipy.sparse.linalg.splu(
        matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    )
    return np.asarray(factors.solve(load))


@compiled
def assemble(corners: Array, values: Array, gradient: Pair, points: CellPoints, matrices: Array, loads: Array) -> None:
    """Add the matrix and the load of every element, by quadrature.

    ``corners`` of shape ``(8, n)`` are x and then y, ``values`` of shape ``(4, n)`` those of the interpolant there,
    ``gradient`` that of u at the points. ``matrices`` of shape ``(10, n)`` have the entries of :data:`PAIRS`, ``loads``
    of shape ``(4, n)`` the integrals of ``grad (u - I u) . grad`` of the shape function of each corner.
    """
    x0, x1, x2, x3 = corners[0], corners[1], corners[2], corners[3]
    y0, y1, y2, y3 = corners[4], corners[5], corners[6], corners[7]
    v0, v1, v2, v3 = values[0], values[1], values[2], values[3]
    m00, m01, m02, m03, m11 = matrices[0], matrices[1], matrices[2], matrices[3], matrices[4]
    m12, m13, m22, m23, m33 = matrices[5], matrices[6], matrices[7], matrices[8], matrices[9]
    f0, f1, f2, f3 = loads[0], loads[1], loads[2], loads[3]
    for p in range(points.s.size):
        s, t, weight = points.s[p], points.t[p], points.weights[p]
        u_x, u_y = gradient[0][p], gradient[1][p]
        for k in range(x0.size):
            x_s = (1.0 - t) * (x1[k] - x0[k]) + t * (x2[k] - x3[k])
            y_s = (1.0 - t) * (y1[k] - y0[k]) + t * (y2[k] - y3[k])
            x_t = (1.0 - s) * (x3[k] - x0[k]) + s * (x2[k] - x1[k])
            y_t = (1.0 - s) * (y3[k] - y0[k]) + s * (y2[k] - y1[k])
            det = x_s * y_t - x_t * y_s
            share = weight / det
            a_x, a_y = (1.0 - s) * y_s - (1.0 - t) * y_t, (1.0 - t) * x_t - (1.0 - s) * x_s
            b_x, b_y = (1.0 - t) * y_t + s * y_s, -s * x_s - (1.0 - t) * x_t
            c_x, c_y = t * y_t - s * y_s, s * x_s - t * x_t
            d_x, d_y = -t * y_t - (1.0 - s) * y_s, (1.0 - s) * x_s + t * x_t
            e_x = weight * u_x[k] - share * (a_x * v0[k] + b_x * v1[k] + c_x * v2[k] + d_x * v3[k])
            e_y = weight * u_y[k] - share * (a_y * v0[k] + b_y * v1[k] + c_y * v2[k] + d_y * v3[k])
            m00[k] += share * (a_x * a_x + a_y * a_y)
            m01[k] += share * (a_x * b_x + a_y * b_y)
            m02[k] += share * (a_x * c_x + a_y * c_y)
            m03[k] += share * (a_x * d_x + a_y * d_y)
            m11[k] += share * (b_x * b_x + b_y * b_y)
            m12[k] += share * (b_x * c_x + b_y * c_y)
            m13[k] += share * (b_x * d_x + b_y * d_y)
            m22[k] += share * (c_x * c_x + c_y * c_y)
            m23[k] += share * (c_x * d_x + c_y * d_y)
            m33[k] += share * (d_x * d_x + d_y * d_y)
            f0[k] += e_x * a_x + e_y * a_y
            f1[k] += e_x * b_x + e_y * b_y
            f2[k] += e_x * c_x + e_y * c_y
            f3[k] += e_x * d_x + e_y * d_y
