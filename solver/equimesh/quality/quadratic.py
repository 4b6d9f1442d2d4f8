"""What quadratic elements get from a mesh, compared with the uniform mesh or another one of its size.

A mesh of small errors of the bilinear interpolant follows the second derivatives of u, and that of the biquadratic
interpolant the third ones: it may gain less, or lose.
"""

from __future__ import annotations

import numpy as np

from equimesh.fields.field import Field
from equimesh.meshes.mesh_window import WindowCells
from equimesh.numerics.types import Array, IntArray
from equimesh.quality.cells import CellPoints, Cells
from equimesh.quality.interpolation import gain_of, noise
from equimesh.quality.selection import scattered

GAUSS_POINTS = 3
"""Gauss points per direction and cell."""
MEASURED_CELLS = 256
"""Cells that are measured, about; all of a mesh with fewer than twice as many."""
NODES = np.array([0.0, 0.5, 1.0])
"""The Gauss-Lobatto nodes of the interpolant along each direction of a cell."""


def quadratic_gain(cells: Cells, other: Cells, u: Field, size: float) -> float:
    """The L2 error of the biquadratic interpolant of u on the cells of an ``other`` mesh over that on ``cells``.

    Both meshes are valid and have the same number of cells. The nodes of a cell lie at 0, 1/2 and 1 along s and t, and
    its bilinear map places them. On more than 511 cells both errors are estimated from scattered cells, the same of
    both meshes: to some percent where u is smooth, to some tens where a thin front meets few of them. It is 1 where
    both errors are rounding of values of at most ``size``. Where processes share the mesh, all of them call this.
    """
    chosen, one_of = WindowCells.of(cells.rows), cells.count // MEASURED_CELLS
    if one_of > 1:
        chosen = WindowCells.of(cells.rows, chosen.numbers[scattered(chosen.numbers, one_of)])
    with np.errstate(all="ignore"):
        squares = chosen.total(np.stack([_squares(one, chosen.numbers, u) for one in (cells, other)]))
        here, there = np.sqrt(squares * cells.count / chosen.count())
    return gain_of(float(there), float(here), noise(cells, size)[0])


def _squares(cells: Cells, numbers: IntArray, u: Field) -> Array:
    """The integrals of the squared error over the cells with these numbers."""
    gauss = CellPoints.gauss(GAUSS_POINTS)
    s, t = (q.ravel() for q in np.meshgrid(NODES, NODES, indexing="ij"))
    count = gauss.s.size
    every = CellPoints(np.concatenate([gauss.s, s]), np.concatenate([gauss.t, t]), np.ones(count + s.size))
    at = cells.at(every, numbers)
    (values,) = u.evaluate(at.x, at.y)
    errors = _interpolation(gauss) @ values[count:] - values[:count]
    return np.asarray(gauss.weights @ (at.det[:count] * errors**2))


def _interpolation(points: CellPoints) -> Array:
    """The values of the nine shape functions at some points, shape ``(points, 9)``."""
    along_s, along_t = (np.stack([_shape(k, q) for k in range(NODES.size)], axis=-1) for q in (points.s, points.t))
    return np.asarray((along_s[:, :, None] * along_t[:, None, :]).reshape(points.s.size, -1))


def _shape(k: int, q: Array) -> Array:
    """The quadratic that is 1 at one of the nodes, and 0 at the others."""
    others = np.delete(NODES, k)
    return np.asarray((q - others[0]) * (q - others[1]) / ((NODES[k] - others[0]) * (NODES[k] - others[1])))
