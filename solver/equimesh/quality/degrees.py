"""What elements of each degree get from a mesh, compared with the uniform mesh or another one of its size.

The interpolant of degree p has its nodes at the Gauss-Lobatto points of each cell, which its bilinear map places. Its
error follows the derivatives of order p + 1: a mesh on which one degree gains can be worse than none for another.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from equimesh.fields.expression import Field
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array, BoolArray, IntArray, Pair
from equimesh.quality.cells import Cells, ChosenCells, MeshCells
from equimesh.quality.elements import CORNERS, Basis, CellKind, Element, basis, finer_rule, lagrange, rule, shapes_at
from equimesh.quality.interpolation import (
    FOLDED,
    NO_ERROR,
    UNKNOWN,
    Extremes,
    InterpolationErrors,
    LargestError,
    Norms,
    compared,
    gain_of,
    kept_of_uniform,
    noise,
    require_same_cells,
    sample,
)
from equimesh.quality.resolution import resolved_integrals, scattered_between
from equimesh_coupling.parts import ANYWHERE, CUTS, better_cuts
from equimesh_schema.certificate import DegreeGain

DEGREES: Mapping[CellKind, tuple[int, ...]] = {"quad": (1, 2, 3), "triangle": (1, 2)}
"""The degrees whose gains a certificate tells."""
GAUSS_POINTS = 4
"""Gauss points per direction and cell; at fewer, the gradient of degree 3 has no error to leading order."""
MEASURED_CELLS = 256
"""Cells that are measured, about; all of a mesh with fewer than twice as many."""
BLOCK_CELLS = 512
"""Cells of a block, whose arrays stay in the cache."""


def gains_by_degree(
    cells: MeshCells, other: Cells, u: Field, errors: InterpolationErrors, kind: CellKind = "quad"
) -> tuple[DegreeGain, ...]:
    """The errors of interpolation on the cells of an ``other`` mesh over those on ``cells``, for each degree.

    Both meshes are valid and have the same number of cells; ``errors`` are those of one degree. On more than 511 cells
    those of others are estimated from scattered cells, the same of both meshes: to some percent where u is smooth, to
    some tens where a thin front meets few of them, to a factor of several at a narrow peak. A gain is 1 where both
    errors are rounding. It is NaN where ``errors`` say that a layer lies inside a cell.
    """
    degrees = tuple(degree for degree in DEGREES[kind] if degree != errors.degree)
    rows, one_of = cells.rows, cells.count // MEASURED_CELLS
    some = scattered_between(rows.first, rows.last, one_of, cells.shape[1]) if one_of > 1 else None
    chosen = ChosenCells.of(rows, some)
    element = rule(kind, GAUSS_POINTS)
    bases = [basis(kind, degree, element) for degree in degrees]
    with np.errstate(all="ignore"):
        known = kept_of_uniform(u, other, (kind, degrees))
        meshes = [cells] if known else [cells, other]
        found = squared_errors(meshes, chosen, u, bases, element, kind)
        squares = chosen.total(found.reshape(-1, chosen.numbers.size))
        here, *there = np.sqrt(squares * cells.count / chosen.count()).reshape(len(meshes), len(degrees), 2)
        known += there
    rounding, gains = (
        noise(cells, errors.size),
        [DegreeGain(degree=errors.degree, l2=errors.gain_l2, h1=errors.gain_h1)],
    )
    for degree, mine, others in zip(degrees, here, known[0], strict=True):
        pair = [
            gain_of(float(its), float(own), part) if known else math.nan
            for its, own, part, known in zip(others, mine, rounding, errors.resolved, strict=True)
        ]
        gains.append(DegreeGain(degree=degree, l2=pair[0], h1=pair[1]))
    return tuple(sorted(gains, key=lambda one: one.degree))


def squared_errors(
    meshes: Sequence[Cells],
    chosen: ChosenCells,
    u: Field,
    bases: Sequence[Basis],
    element: Element,
    kind: CellKind = "quad",
) -> Array:
    """The integrals of the squared errors of u and of its gradient over the ``chosen`` cells of each of some meshes.

    They are those of the interpolants with each of the ``bases``, by the rule of ``element``: an array of the shape
    ``(meshes, bases, 2, cells)``. Blocks, and with them the last digits, are the same for any number of holders.
    """
    result = np.empty((len(meshes), len(bases), 2, chosen.numbers.size))
    for block, found in _samples(meshes, chosen, u, bases, element, kind):
        for k, errors in enumerate(found.errors()):
            of_cells = errors[:2].reshape(2, len(meshes), block.stop - block.start, -1).sum(axis=-1)
            result[:, k, :, block] = of_cells.swapaxes(0, 1)
    return result


class _Errors(NamedTuple):
    """The errors of an interpolant and of its gradient at the points of a rule, and the shares of the points."""

    shares: Array
    value: Array
    along_x: Array
    along_y: Array

    def squares(self) -> Array:
        """The integrals of the squares over each element, of the shape ``(2, elements)``."""
        slopes = self.along_x**2 + self.along_y**2
        return np.stack([(self.shares * self.value**2).sum(axis=0), (self.shares * slopes).sum(axis=0)])


@compiled
def add_squares(weights: Array, slopes: Array, u: Array, gradient: Pair, interpolants: Array, out: Array) -> None:
    """To ``out`` of every element the integrals of the squared error of an interpolant and of its gradient.

    ``slopes`` are the derivatives of x and of y by s and t, shape ``(2, 2, points, elements)``; ``interpolants`` the
    value and its derivatives by s and t, ``(3, points, elements)``. The last of three rows becomes the largest error.
    """
    squares, slope_squares, largest = out[0], out[1], out[2]
    for p in range(weights.size):
        weight, here, u_x, u_y = weights[p], u[p], gradient[0][p], gradient[1][p]
        x_s, x_t, y_s, y_t = slopes[0, 0, p], slopes[0, 1, p], slopes[1, 0, p], slopes[1, 1, p]
        value, v_s, v_t = interpolants[0, p], interpolants[1, p], interpolants[2, p]
        for k in range(squares.size):
            det = x_s[k] * y_t[k] - x_t[k] * y_s[k]
            error = value[k] - here[k]
            error_x = (v_s[k] * y_t[k] - v_t[k] * y_s[k]) / det - u_x[k]
            error_y = (v_t[k] * x_s[k] - v_s[k] * x_t[k]) / det - u_y[k]
            share = weight * det
            squares[k] += share * error * error
            slope_squares[k] += share * (error_x * error_x + error_y * error_y)
            largest[k] = max(largest[k], abs(error))


class _Sample(NamedTuple):
    """u with its gradient at the points of a rule in some elements, and u at the nodes of some bases.

    ``corners`` of shape ``(2, corners, elements)`` are x and y, ``slopes`` those of :func:`add_squares`. The corners
    are nodes of all bases: ``nodal`` has u there, and after that u at the other nodes of each.
    """

    element: Element
    bases: Sequence[Basis]
    corners: Array
    slopes: Array
    u: Array
    gradient: Pair
    nodal: Array

    @classmethod
    def of(cls, u: Field, element: Element, bases: Sequence[Basis], corners: Array) -> _Sample:
        """u at all points, and at all nodes."""
        count, shared = element.weights.size, corners.shape[1]
        x, y = np.matmul(element.shape, corners)
        values, u_x, u_y = u.evaluate(x, y, order=1)
        slopes = np.matmul(np.concatenate([element.along_s, element.along_t]), corners).reshape(2, 2, count, -1)
        places = np.concatenate([bases[0].places, *(one.places[shared:] for one in bases[1:])])
        (nodal,) = u.evaluate(*np.matmul(places, corners))
        return cls(element, bases, corners, slopes, values, (u_x, u_y), nodal)

    def errors(self) -> Iterator[Array]:
        """For each basis the integrals of both squared errors, and the largest error, shape ``(3, elements)``."""
        shared = first = self.corners.shape[1]
        u, u_x, u_y = (np.ascontiguousarray(part) for part in (self.u, *self.gradient))
        for one in self.bases:
            last = first + len(one.places) - shared
            nodal = np.concatenate([self.nodal[:shared], self.nodal[first:last]])
            first, functions = last, np.concatenate([one.value, one.along_s, one.along_t], axis=1)
            interpolants, out = (functions.T @ nodal).reshape(3, *u.shape), np.zeros((3, u.shape[1]))
            add_squares(self.element.weights, self.slopes, u, (u_x, u_y), interpolants, out)
            yield out


def _samples(
    meshes: Sequence[Cells],
    chosen: ChosenCells,
    u: Field,
    bases: Sequence[Basis],
    element: Element,
    kind: CellKind,
) -> Iterator[tuple[slice, _Sample]]:
    """u in the chosen cells of all meshes, block by block, those of the first mesh first."""
    of_all = [kind == "triangle" and chosen.numbers.size == cells.own.stop - cells.own.start for cells in meshes]
    all_cuts = [
        cells.cuts if are_all and isinstance(cells, MeshCells) else {}
        for cells, are_all in zip(meshes, of_all, strict=True)
    ]
    for start, end in pairwise(map(int, chosen.ends)):
        for first in range(start, end, BLOCK_CELLS):
            block = slice(first, min(first + BLOCK_CELLS, end))
            corners = []
            for cells, cuts in zip(meshes, all_cuts, strict=True):
                through = {cell - first: cut for cell, cut in cuts.items() if first <= cell < block.stop}
                corners.append(corners_of(cells, chosen.numbers[block], kind, through))
            yield block, _Sample.of(u, element, bases, corners[0] if len(corners) == 1 else np.concatenate(corners, -1))


def corners_of(
    cells: Cells, numbers: IntArray, kind: CellKind = "quad", through: Mapping[int, int] = ANYWHERE
) -> Array:
    """x and y of the corners of cells, or of the triangles into which they are cut, shape ``(2, corners, elements)``.

    The cells at the places in ``through`` have the cut given there.
    """
    corners = cells.corners(numbers).reshape(2, 4, -1)
    if kind == "quad":
        return corners
    cuts = CUTS[better_cuts(corners.transpose(2, 1, 0), through)].reshape(-1, 3)
    return np.asarray(corners[:, cuts.T, np.repeat(np.arange(numbers.size), 2)])


# The errors of the interpolant of one degree on a whole mesh, by two rules, and by parts of cells where these differ.

QUARTERS: Mapping[CellKind, Array] = {
    "quad": np.array(
        [
            [[4, 0, 0, 0], [2, 2, 0, 0], [1, 1, 1, 1], [2, 0, 0, 2]],
            [[2, 2, 0, 0], [0, 4, 0, 0], [0, 2, 2, 0], [1, 1, 1, 1]],
            [[1, 1, 1, 1], [0, 2, 2, 0], [0, 0, 4, 0], [0, 0, 2, 2]],
            [[2, 0, 0, 2], [1, 1, 1, 1], [0, 0, 2, 2], [0, 0, 0, 4]],
        ]
    )
    / 4.0,
    "triangle": np.array(
        [
            [[2, 0, 0], [1, 1, 0], [1, 0, 1]],
            [[1, 1, 0], [0, 2, 0], [0, 1, 1]],
            [[1, 0, 1], [0, 1, 1], [0, 0, 2]],
            [[0, 1, 1], [1, 0, 1], [1, 1, 0]],
        ]
    )
    / 2.0,
}
"""The corners of the four parts of an element, as means of its own corners."""


def degree_errors(
    cells: MeshCells, uniform: Cells | None, u: Field, degree: int, kind: CellKind = "quad"
) -> InterpolationErrors:
    """The errors of the interpolant of a ``degree`` on two meshes of one size; without ``uniform`` NaN on that.

    Of many cells they are those of a sample, as of degree 1. Raises :class:`~equimesh.errors.InputError` for meshes of
    blocks with other cells.
    """
    require_same_cells(cells, uniform)
    with np.errstate(all="ignore"):
        here = _norms(cells, u, degree, kind)
        there = UNKNOWN if uniform is None else _norms(uniform, u, degree, kind)
        return replace(compared(cells, here, there), degree=degree)


def squared_errors_of_cells(cells: MeshCells, u: Field, degree: int, kind: CellKind = "quad") -> Array:
    """The integral of the squared error of the interpolant of a ``degree`` over every own cell."""
    element = rule(kind, degree + 2)
    with np.errstate(all="ignore"):
        found = squared_errors((cells,), ChosenCells.of(cells.rows), u, [basis(kind, degree, element)], element, kind)
        return np.asarray(found[0, 0, 0])


def _norms(cells: Cells, u: Field, degree: int, kind: CellKind) -> Norms:
    if not cells.all_valid:
        return FOLDED
    chosen, per_cell = ChosenCells.of(cells.rows, sample(cells.rows)), 1 if kind == "quad" else 2
    element, count = rule(kind, degree + 2), chosen.numbers.size * per_cell
    one = basis(kind, degree, element)
    sums, corners, values = (
        np.empty((2, count)),
        np.empty((2, one.places.shape[1], count)),
        np.empty((len(one.places), count)),
    )
    peak, ends = NO_ERROR, (math.inf, -math.inf)
    for block, found in _samples((cells,), chosen, u, [one], element, kind):
        where = slice(per_cell * block.start, per_cell * block.stop)
        (errors,) = found.errors()
        sums[:, where], corners[:, :, where], values[:, where] = errors[:2], found.corners, found.nodal
        for part in (found.u, found.nodal):
            ends = min(ends[0], float(part.min())), max(ends[1], float(part.max()))
        worst = int(errors[2].argmax())
        if errors[2, worst] > peak.value:
            peak = LargestError(float(errors[2, worst]), *map(float, found.corners[:, :, worst].mean(axis=1)))
    extremes = Extremes.of(cells.rows, float(np.abs(values).max(initial=0.0)), ends, peak)
    allowed = noise(cells, extremes.size)
    squares = (allowed[0] * allowed[0], allowed[1] * allowed[1])
    whole = _Pieces(kind, degree, corners, values)
    resolved = resolved_integrals(whole.some, chosen.repeated(per_cell), sums, u, squares)
    l2, h1 = (math.sqrt(square * per_cell * cells.count / resolved.cells) for square in resolved.squares)
    return Norms(l2, h1, extremes.size, resolved.resolved, extremes.variation, extremes.peak)


@dataclass(frozen=True, eq=False)
class _Pieces:
    """Parts of elements, on which the error of the interpolant of the whole element is integrated.

    ``corners`` of shape ``(2, corners, n)`` are those of the whole element, ``values`` of shape ``(nodes, n)`` are u at
    its nodes, and ``part`` has the corners of the part in reference coordinates; ``None`` for the whole.
    """

    kind: CellKind
    degree: int
    corners: Array
    values: Array
    part: Array | None = None

    @property
    def count(self) -> int:
        """Number of parts."""
        return int(self.values.shape[1])

    def some(self, chosen: IntArray | BoolArray) -> _Pieces:
        """The chosen parts."""
        part = None if self.part is None else self.part[:, :, chosen]
        return replace(self, corners=self.corners[:, :, chosen], values=self.values[:, chosen], part=part)

    def quarters(self) -> _Pieces:
        """Four parts of every part; ``q`` of part ``k`` has the number ``q * count + k``."""
        part = self._parts()
        quarters = np.concatenate([np.einsum("ck,dkn->dcn", one, part) for one in QUARTERS[self.kind]], axis=2)
        return replace(self, corners=np.tile(self.corners, 4), values=np.tile(self.values, 4), part=quarters)

    def errors(self, u: Field) -> Array:
        """The integrals of both squared errors, and the gradient that the rule has missed, of shape ``(3, n)``.

        That is known as of :class:`~equimesh.quality.resolution.Pieces`: from the error on the rim of the part.
        """
        result = np.empty((3, self.count))
        for first in range(0, self.count, BLOCK_CELLS):
            block = slice(first, first + BLOCK_CELLS)
            errors = self._errors(u, block)
            result[:2, block] = errors.squares()
            apart = [
                (errors.shares * slope).sum(axis=0) - rim
                for slope, rim in zip((errors.along_x, errors.along_y), self._over_rim(u, block), strict=True)
            ]
            result[2, block] = (apart[0] ** 2 + apart[1] ** 2) / errors.shares.sum(axis=0)
        return result

    def _parts(self) -> Array:
        if self.part is not None:
            return self.part
        whole = CORNERS[self.kind]
        return np.broadcast_to(whole[:, :, None], (*whole.shape, self.count))

    def _parts_of(self, block: slice) -> Array:
        """The parts of a block, or one for all of them where they are whole cells."""
        return CORNERS[self.kind][:, :, None] if self.part is None else self.part[:, :, block]

    def _errors(self, u: Field, block: slice) -> _Errors:
        part, (x, y), values = self._parts_of(block), self.corners[:, :, block], self.values[:, block]
        element = finer_rule(self.kind, self.degree + 3)
        s, t = element.shape @ part[0], element.shape @ part[1]
        first, second = element.along_s @ part, element.along_t @ part
        inside = first[0] * second[1] - first[1] * second[0]
        shape, along_s, along_t = lagrange(self.kind, 1, s, t)
        at_x, at_y, x_s, y_s, x_t, y_t = (
            np.einsum("kqn,kn->qn", functions, q) for functions in (shape, along_s, along_t) for q in (x, y)
        )
        det = x_s * y_t - x_t * y_s
        there, u_x, u_y = u.evaluate(at_x, at_y, order=1)
        value, v_s, v_t = (np.einsum("jqn,jn->qn", one, values) for one in lagrange(self.kind, self.degree, s, t))
        along_x, along_y = (v_s * y_t - v_t * y_s) / det - u_x, (v_t * x_s - v_s * x_t) / det - u_y
        return _Errors(element.weights[:, None] * inside * det, value - there, along_x, along_y)

    def _over_rim(self, u: Field, block: slice) -> Pair:
        """The integrals of the error times the outer normal over the rim: those of its gradient over the part."""
        part, corners = self._parts_of(block), self.corners[:, :, block]
        nodes, weights = np.polynomial.legendre.leggauss(self.degree + 2)
        along = 0.5 + 0.5 * nodes[:, None, None]
        s, t = (1.0 - along) * part[:, None] + along * np.roll(part, -1, axis=1)[:, None]
        x, y = (np.einsum("kqsn,kn->qsn", shapes_at(self.kind, s, t), q) for q in corners)
        interpolant = np.einsum("jqsn,jn->qsn", lagrange(self.kind, self.degree, s, t)[0], self.values[:, block])
        error = np.einsum("q,qsn->sn", 0.5 * weights, interpolant - u.evaluate(x, y)[0])
        ends = [np.einsum("ksn,kn->sn", shapes_at(self.kind, *part), q) for q in corners]
        ahead = [np.roll(end, -1, axis=0) - end for end in ends]
        return (error * ahead[1]).sum(axis=0), -(error * ahead[0]).sum(axis=0)
