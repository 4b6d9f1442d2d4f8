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
from equimesh.meshes.cell_edges import CellEdges, originals_of
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.compiled import compiled, inlined
from equimesh.numerics.types import Array, IntArray, Pair
from equimesh.quality.cell_maps import locate
from equimesh.quality.cells import CellPoints, QuadCells
from equimesh.quality.elements import Element, at_point, determinant, gradient, quadrilateral
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
        numbers = unknowns(mesh.cells, count, mesh.ties)
        matrices, loads = np.zeros((nodes.shape[1], 4, 4)), np.zeros((nodes.shape[1], 4))
        assemble(corners, np.ascontiguousarray(nodal[nodes]), (u_x, u_y), quadrilateral(GAUSS_POINTS), matrices, loads)
        if not (np.isfinite(matrices).all() and np.isfinite(loads).all()):
            return UNKNOWN
        added = _solved(numbers[nodes.T], matrices, loads)
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


def unknowns(corners: IntArray, count: int, ties: IntArray) -> IntArray:
    """The number of the unknown at each of ``count`` nodes, -1 on the boundary; tied nodes are one unknown.

    ``corners`` are the nodes of every cell. Without a boundary the solution is unique up to a constant, and one node is
    fixed.
    """
    edges = CellEdges.of(corners, count, ties)
    cell, place = edges.cells[edges.is_outer, 0], edges.places[edges.is_outer, 0]
    original = originals_of(count, ties)
    is_unknown = original == np.arange(count)
    for step in (0, 1):
        is_unknown[original[corners[cell, (place + step) % 4]]] = False
    if not cell.size:
        is_unknown[original[0]] = False
    numbers = np.where(is_unknown, np.cumsum(is_unknown) - 1, -1)
    return np.asarray(numbers[original])


def _solved(numbers: IntArray, matrices: Array, loads: Array) -> Array:
    """The values at the unknowns, from the matrices and loads of the elements; ``numbers`` of shape (elements, 4)."""
    count = int(numbers.max(initial=-1)) + 1
    if count == 0:
        return np.zeros(1)
    rows, columns = np.broadcast_arrays(numbers[:, :, None], numbers[:, None])
    free, known = (rows >= 0) & (columns >= 0), numbers >= 0
    matrix = scipy.sparse.csc_matrix((matrices[free], (rows[free], columns[free])), shape=(count, count))
    factors = scipy.sparse.linalg.splu(
        matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    )
    return np.asarray(factors.solve(np.bincount(numbers[known], loads[known], count)))


@compiled
def assemble(corners: Array, values: Array, by: Pair, element: Element, matrices: Array, loads: Array) -> None:
    """The matrix and the load of every element.

    ``corners`` of shape ``(8, n)`` are x and then y, ``values`` of shape ``(4, n)`` those of the interpolant there,
    ``by`` the gradient of u at the points. ``matrices`` have the shape ``(n, 4, 4)``, ``loads`` ``(n, 4)``.
    """
    corner, parts = np.empty((3, 4)), np.empty((2, 4))
    for c in range(corners.shape[1]):
        for k in range(4):
            corner[0, k], corner[1, k], corner[2, k] = corners[k, c], corners[4 + k, c], values[k, c]
        local = matrices[c]
        add_system(element, c, corner, by, parts, local, loads[c])
        for k in range(4):
            for j in range(k):
                local[j, k] = local[k, j]


@inlined
def add_system(element: Element, c: int, corner: Array, by: Pair, parts: Array, matrix: Array, load: Array) -> bool:
    """Add the matrix of element c on and below the diagonal, and its load; False where the element is folded.

    The rows of ``corner`` are x, y and the interpolant at the corners, ``by`` is the gradient of u at the points of all
    elements, and ``parts`` is an array to work in, of shape ``(2, corners)``. Entries of the load are the integrals of
    ``grad (u - I u) . grad`` of the shape function of each corner.
    """
    for q in range(element.weights.size):
        moved, _, _ = at_point(element, q, load.size, corner, 0, 0.0)
        det, weight = determinant(moved), element.weights[q]
        if det <= 0.0:
            return False
        share, e_x, e_y = weight / det, weight * by[0][q, c], weight * by[1][q, c]
        for k in range(load.size):
            parts[0, k], parts[1, k] = gradient(element.along_s[q, k], element.along_t[q, k], moved, 1.0)
            e_x -= share * parts[0, k] * corner[2, k]
            e_y -= share * parts[1, k] * corner[2, k]
        for k in range(load.size):
            load[k] += e_x * parts[0, k] + e_y * parts[1, k]
            for j in range(k + 1):
                matrix[k, j] += share * (parts[0, k] * parts[0, j] + parts[1, k] * parts[1, j])
    return True
