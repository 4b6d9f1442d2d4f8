"""The errors of interpolating u on the triangles into which a mesh is cut, compared with the uniform mesh.

A triangle is a bilinear cell with two corners at one point, and a linear interpolant is bilinear on it. So the pieces
of cells also measure triangles, and divide them where a layer lies inside one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from equimesh.fields.expression import Field
from equimesh.meshes.mesh import MeshRows
from equimesh.numerics.types import Array
from equimesh.quality.cell_maps import locate
from equimesh.quality.cells import AnyMesh, CellPoints, ChosenCells, MeshCells, cells_of
from equimesh.quality.interpolation import (
    NO_ERROR,
    UNKNOWN,
    Extremes,
    InterpolationErrors,
    LargestError,
    Norms,
    compared,
    noise,
    require_same_cells,
    sample,
)
from equimesh.quality.resolution import BLOCK_PIECES, Pieces, resolved_integrals
from equimesh.quality.tally import add_errors
from equimesh_coupling.parts import ANYWHERE, CUTS, better_cuts

GAUSS_POINTS = 3
"""Gauss points per direction of a triangle: exact for the squared error of a quadratic u."""
MIDDLE = (0.5, 1.0 / 3.0)
"""The place of the centre of a triangle in the cell with two corners at one point."""


def triangle_errors(mesh: AnyMesh, u: Field, uniform: AnyMesh | None = None) -> InterpolationErrors:
    """The errors of linear interpolation of u on the triangles of ``mesh`` and of ``uniform``.

    Both are cut as :meth:`~equimesh.meshes.mesh_data.MeshData.triangles` cuts them. ``uniform`` is the uniform mesh of
    the domain, by default of the unit square; of blocks it is the mesh to compare with. On more than 25 000 cells the
    errors are those of a sample, as in :func:`~equimesh.quality.interpolation.interpolation_errors`.
    """
    with np.errstate(all="ignore"):
        first = cells_of(mesh)
        if mesh.is_grid and uniform is None:
            uniform = MeshRows.uniform(first.rows)
        second = None if uniform is None else cells_of(uniform)
        require_same_cells(first, second)
        return compared(first, _norms(first, u), UNKNOWN if second is None else _norms(second, u))


def halves(cells: Pieces, through: Mapping[int, int] = ANYWHERE) -> Pieces:
    """The triangles of whole cells: cell ``k`` gives ``2 k`` and ``2 k + 1``. Their last two corners are one point.

    Cells are cut as :func:`~equimesh_coupling.parts.better_cuts` says, those in ``through`` along the diagonal given.
    """
    corners = cells.corners.reshape(2, 4, -1)
    cuts = CUTS[better_cuts(corners.transpose(2, 1, 0), through)].reshape(-1, 3)
    which, cell = np.concatenate([cuts, cuts[:, 2:]], axis=1).T, np.repeat(np.arange(cells.count), 2)
    return Pieces(corners[:, which, cell].reshape(8, -1), cells.values[which, cell])


def squared_errors(cells: MeshCells, u: Field) -> Array:
    """The integral of the squared error over the two triangles of every own cell, shape ``(cells,)``."""
    chosen = ChosenCells.of(cells.rows)
    pieces = Pieces.of(cells, chosen.numbers, _values(cells, u, chosen))
    (squares, _), _, _ = _leanly(halves(pieces, cells.cuts), u)
    return np.asarray(squares.reshape(-1, 2).sum(axis=1))


def _values(cells: MeshCells, u: Field, chosen: ChosenCells) -> Array:
    """u at the corners of the ``chosen`` cells, shape ``(4, cells)``."""
    corners = cells.corners(chosen.numbers)
    return u.evaluate(corners[:4], corners[4:])[0]


def _norms(cells: MeshCells, u: Field) -> Norms:
    if not cells.all_valid:
        return Norms(math.inf, math.inf, math.nan)
    numbers = sample(cells.rows)
    chosen = ChosenCells.of(cells.rows, numbers)
    values = _values(cells, u, chosen)
    # of a sample the four cells at the corners, if they are in it at all, change nothing that could be seen
    through = cells.cuts if numbers is None else ANYWHERE
    triangles = halves(Pieces.of(cells, chosen.numbers, values), through)
    sums, largest, ends = _leanly(triangles, u)
    ends = min(ends[0], float(values.min(initial=math.inf))), max(ends[1], float(values.max(initial=-math.inf)))
    extremes = Extremes.of(cells.rows, values, ends, _peak(triangles, largest))
    allowed = noise(cells, extremes.size)
    squares = (allowed[0] * allowed[0], allowed[1] * allowed[1])
    found = resolved_integrals(triangles.some, chosen.repeated(2), sums, u, squares)
    l2, h1 = (math.sqrt(square * 2 * cells.count / found.cells) for square in found.squares)
    return Norms(l2, h1, extremes.size, found.resolved, extremes.variation, extremes.peak)


def _peak(triangles: Pieces, largest: Array) -> LargestError:
    if not largest.size:
        return NO_ERROR
    worst = int(largest.argmax())
    x, y = np.empty((2, 1, 1))
    locate(triangles.corners[:, worst : worst + 1].copy(), np.array(MIDDLE[:1]), np.array(MIDDLE[1:]), x, y)
    return LargestError(float(largest[worst]), float(x[0, 0]), float(y[0, 0]))


def _leanly(triangles: Pieces, u: Field) -> tuple[Array, Array, tuple[float, float]]:
    """The integrals of squared errors over every triangle, the largest errors, and the range of u at the points."""
    points = CellPoints.gauss(GAUSS_POINTS)
    parts, largest = np.zeros((4, triangles.count)), np.zeros(triangles.count)
    low, high = math.inf, -math.inf
    for start in range(0, triangles.count, BLOCK_PIECES):
        block = slice(start, start + BLOCK_PIECES)
        corners, values = triangles.corners[:, block].copy(), triangles.values[:, block].copy()
        x, y = np.empty((2, points.s.size, values.shape[1]))
        locate(corners, points.s, points.t, x, y)
        sums = np.zeros((4, values.shape[1]))
        there, u_x, u_y = (np.ascontiguousarray(part) for part in u.evaluate(x, y, order=1))
        add_errors(corners, values, there, (u_x, u_y), points, sums, largest[block])
        parts[:, block] = sums
        low, high = min(low, float(there.min())), max(high, float(there.max()))
    return parts[:2], largest, (low, high)
