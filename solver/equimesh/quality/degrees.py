"""What elements of each degree get from a mesh, compared with the uniform mesh or another one of its size.

The interpolant of degree p has its nodes at the Gauss-Lobatto points of each cell, which its bilinear map places. Its
error follows the derivatives of order p + 1: a mesh on which one degree gains can be worse than none for another.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise

import numpy as np

from equimesh.fields.expression import Field
from equimesh.numerics.types import Array, IntArray, Pair
from equimesh.quality.cells import Cells, ChosenCells, MeshCells
from equimesh.quality.elements import Basis, CellKind, Element, basis, rule
from equimesh.quality.interpolation import InterpolationErrors, gain_of, noise
from equimesh.quality.resolution import scattered
from equimesh_coupling.parts import ANYWHERE, CUTS, better_cuts
from equimesh_schema.certificate import DegreeGain

DEGREES: Mapping[CellKind, tuple[int, ...]] = {"quad": (1, 2, 3), "triangle": (1, 2)}
"""The degrees whose gains a certificate tells."""
GAUSS_POINTS = 4
"""Gauss points per direction and cell; at fewer, the gradient of degree 3 has no error to leading order."""
MEASURED_CELLS = 384
"""Cells that are measured, about; all of a mesh with fewer than twice as many."""
BLOCK_CELLS = 256
"""Cells of a block, whose arrays stay in the cache."""


def gains_by_degree(
    cells: MeshCells, other: Cells, u: Field, errors: InterpolationErrors, kind: CellKind = "quad"
) -> tuple[DegreeGain, ...]:
    """The errors of interpolation on the cells of an ``other`` mesh over those on ``cells``, for each degree.

    Both meshes are valid and have the same number of cells; ``errors`` are those of degree 1. On more than 767 cells
    the others are estimated from scattered cells, the same of both meshes: to some percent where u is smooth, to some
    tens where a thin front meets few of them. A gain is 1 where both errors are rounding. It is NaN where ``errors``
    say that a layer lies inside a cell.
    """
    degrees = tuple(degree for degree in DEGREES[kind] if degree != 1)
    chosen, one_of = ChosenCells.of(cells.rows), cells.count // MEASURED_CELLS
    if one_of > 1:
        chosen = ChosenCells.of(cells.rows, chosen.numbers[scattered(chosen.numbers, one_of)])
    bases, element = [basis(kind, degree, GAUSS_POINTS) for degree in degrees], rule(kind, GAUSS_POINTS)
    with np.errstate(all="ignore"):
        found = [squared_errors(one, chosen, u, bases, element, kind) for one in (cells, other)]
        squares = chosen.total(np.concatenate(found).reshape(-1, chosen.numbers.size))
        here, there = np.sqrt(squares * cells.count / chosen.count()).reshape(2, len(degrees), 2)
    rounding, gains = noise(cells, errors.size), [DegreeGain(degree=1, l2=errors.gain_l2, h1=errors.gain_h1)]
    for degree, mine, others in zip(degrees, here, there, strict=True):
        pair = [
            gain_of(float(its), float(own), part) if known else math.nan
            for its, own, part, known in zip(others, mine, rounding, errors.resolved, strict=True)
        ]
        gains.append(DegreeGain(degree=degree, l2=pair[0], h1=pair[1]))
    return tuple(gains)


def squared_errors(
    cells: Cells, chosen: ChosenCells, u: Field, bases: Sequence[Basis], element: Element, kind: CellKind = "quad"
) -> Array:
    """The integrals of the squared errors of u and of its gradient over the ``chosen`` cells.

    They are those of the interpolants with each of the ``bases``, by the rule of ``element``: an array of the shape
    ``(bases, 2, cells)``. u is evaluated at all points and nodes of a block of cells at once. Blocks, and
    with them the last digits, are the same for any number of holders.
    """
    places = np.concatenate([element.shape, *(one.places for one in bases)])
    result = np.empty((len(bases), 2, chosen.numbers.size))
    for block in _blocks(chosen):
        x, y = corners_of(cells, chosen.numbers[block], kind)
        u_everywhere, u_x, u_y = u.evaluate(places @ x, places @ y, order=1)
        for k, squares in enumerate(_squares(element, bases, (x, y), u_everywhere, (u_x, u_y))):
            result[k, :, block] = squares.reshape(2, block.stop - block.start, -1).sum(axis=-1)
    return result


def _blocks(chosen: ChosenCells) -> Iterator[slice]:
    for start, end in pairwise(map(int, chosen.ends)):
        for first in range(start, end, BLOCK_CELLS):
            yield slice(first, min(first + BLOCK_CELLS, end))


def _squares(element: Element, bases: Sequence[Basis], corners: Pair, values: Array, slopes: Pair) -> Iterator[Array]:
    """The integrals for each basis over each element, of the shape ``(2, elements)``.

    ``values`` and ``slopes`` are those of u: at the points of the rule, and after them at the nodes of each basis.
    """
    (x, y), count = corners, element.weights.size
    x_s, y_s, x_t, y_t = element.along_s @ x, element.along_s @ y, element.along_t @ x, element.along_t @ y
    det = x_s * y_t - x_t * y_s
    shares, first = element.weights[:, None] * det, count
    for one in bases:
        nodal = values[first : first + len(one.places)]
        first += len(one.places)
        error, v_s, v_t = one.value @ nodal - values[:count], one.along_s @ nodal, one.along_t @ nodal
        error_x = (v_s * y_t - v_t * y_s) / det - slopes[0][:count]
        error_y = (v_t * x_s - v_s * x_t) / det - slopes[1][:count]
        yield np.stack([(shares * error**2).sum(axis=0), (shares * (error_x**2 + error_y**2)).sum(axis=0)])


def corners_of(cells: Cells, numbers: IntArray, kind: CellKind = "quad", through: Mapping[int, int] = ANYWHERE) -> Pair:
    """x and y of the corners of cells, or of the triangles into which they are cut, shape ``(corners, elements)``.

    The cells at the places in ``through`` have the cut given there.
    """
    corners = cells.corners(numbers).reshape(2, 4, -1)
    if kind == "quad":
        return corners[0], corners[1]
    cuts = CUTS[better_cuts(corners.transpose(2, 1, 0), through)].reshape(-1, 3)
    triangles = corners[:, cuts.T, np.repeat(np.arange(numbers.size), 2)]
    return triangles[0], triangles[1]
