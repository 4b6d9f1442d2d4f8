"""The objective of a mesh of the unit square as one compiled call, where u is a formula or a spline."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np

from equimesh.fields.source import Source, fill
from equimesh.least_error.kernels import (
    SUMS,
    NodalValues,
    Nodes,
    Smoothness,
    Values,
    distortions,
    finish,
    oblique_corners,
    place_points,
    quad_value_errors,
    slope_errors,
    smallest_share,
)
from equimesh.least_error.projection import Places, are_finite, projected_errors
from equimesh.numerics.calls import address_of, called_at
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array, IntArray
from equimesh.quality.elements import Element, quadrilateral

OF_VALUES, OF_SLOPES, OF_PROJECTION = range(3)
"""The error: of the bilinear interpolant, of its gradient, or of the Ritz projection."""
REFUSED, KNOWN, OPEN = range(3)
"""What is known of a mesh: it is refused, its objective is known, or only careful code can tell."""
VALUE, ERROR, DISTORTION = range(3)
"""Places of the numbers of a :class:`Result`."""


class Result(NamedTuple):
    """The objective at one mesh."""

    value: float
    """The objective."""
    error: float
    """The norm of the interpolation error, in the units of u, or of its gradient times a length."""
    distortion: float
    """The mean of ``(r^2 - 1) / 2``, 0 for the start."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Evaluation:
    """The objective at one mesh as a :class:`Result` has it, with its derivatives."""

    value: float
    error: float
    distortion: float
    gradient: Array
    """The derivatives by the unknowns, shape ``(2, nodes)``; 0 where these are fixed, and for tied copies of nodes."""
    blocks: Array
    """A positive definite approximation of the second derivatives of each node, ``(ss, st, tt)``, ``(3, nodes)``."""

    @property
    def result(self) -> Result:
        """The objective without its derivatives."""
        return Result(self.value, self.error, self.distortion)


class Code(NamedTuple):
    """Where the machine code of the kernels is whose sums may be reordered."""

    share: int
    place: int
    values: int
    slopes: int
    projection: int
    distortions: int
    oblique: int
    finish: int


class Scales(NamedTuple):
    """The weights of an objective, its limit of cotangents, and the error that rounding alone can make."""

    distortion: float
    smoothness: float
    obliqueness: float
    largest_cotangent: float
    rounding: float


class Memory(NamedTuple):
    """Memory of one thread: the sums of the nodes, u at the nodes, and the points of elements with u there."""

    sums: Array
    nodal: Array
    x: Array
    y: Array
    at: Array


class Parts(NamedTuple):
    """What the objective of a mesh of the unit square is made of, whose nodes are the unknowns, and none are tied."""

    code: Code
    error: int
    """:data:`OF_VALUES`, :data:`OF_SLOPES` or :data:`OF_PROJECTION`."""
    u: Source
    """u with its derivatives as far as the points need them."""
    first: Nodes
    """The nodes of the start."""
    start: Array
    """The same as an array of shape ``(2, nodes)``."""
    elements: IntArray
    element: Element
    spans: IntArray
    """Ranges of cells, of shape ``(spans, 2)``, one after the other."""
    smooth: Smoothness
    scales: Scales
    number: IntArray
    """The unknown of a solver at each node, see :class:`~equimesh.least_error.projection.Unknowns`."""
    matrix: Array
    """Memory for the matrix of a solver."""
    memory: Memory


NO_NUMBER, NO_MATRIX = np.zeros(0, dtype=np.int64), np.zeros((0, 0))
"""For an objective without a solver."""


def memory_for(nodes: int, points: int, sums: Array) -> Memory:
    """Memory for so many nodes, and so many points at once."""
    return Memory(sums, np.empty((6, nodes)), np.empty(points), np.empty(points), np.empty((6, points)))


@cache
def machine_code() -> Code:
    """The addresses of the kernels in this process, for the types of arrays that all objectives have."""
    line, table, numbers = np.zeros(4), np.zeros((2, 4)), np.zeros((1, 4), dtype=np.int64)
    nodes, element, sums = Nodes(line, line, numbers[0]), quadrilateral(2), np.zeros((4, SUMS))
    smooth, span = Smoothness(numbers, 0.0, line, table), (0, 1)
    nodal, values = NodalValues(line, line, line), NodalValues(table, table, table)
    every = Values(table, table, table, table, table, table)
    places = Places(nodes, numbers, nodal, every)
    return Code(
        share=address_of(smallest_share, nodes, nodes),
        place=address_of(place_points, nodes, numbers, table, 0, line, line),
        values=address_of(quad_value_errors, nodes, span, element, nodal, values, sums),
        slopes=address_of(slope_errors, nodes, numbers, element, nodal, every, sums),
        projection=address_of(projected_errors, places, element, numbers[0], table, sums),
        distortions=address_of(distortions, nodes, nodes, span, 0.0, sums),
        oblique=address_of(oblique_corners, nodes, span, 0.0, 0.0, sums),
        finish=address_of(finish, table, table, sums, 0.0, smooth, table, table),
    )


@compiled
def evaluate(parts: Parts, beyond: float, mesh: Array, floor: float, gradient: Array, blocks: Array, out: Array) -> int:
    """The objective at a ``mesh`` with its derivatives, and what is known of it: :data:`REFUSED` and the others.

    ``beyond`` is the squared error of further cells that do not change. The mesh is refused unless its smallest share
    of a Jacobian is above the ``floor``. See :class:`~equimesh.least_error.objective.Objective`.
    """
    code, scales, sums, spans = parts.code, parts.scales, parts.memory.sums, parts.spans
    nodes = Nodes(mesh[0], mesh[1], parts.first.corners)
    if not called_at(code.share, smallest_share, (nodes, parts.first)) > floor:
        return REFUSED
    square = projected(parts, nodes) if parts.error == OF_PROJECTION else interpolated(parts, nodes)
    if not np.isfinite(square):
        return OPEN
    square += beyond
    if square < 0.0 or not scales.rounding < np.sqrt(square):  # folded cells count negative
        return REFUSED
    corners, distortion, oblique = 4 * parts.elements.shape[0], 0.0, 0.0
    # All sums are scaled by twice the squared error here, and divided by it once they are complete.
    scale = 2.0 * square * scales.distortion / corners
    for k in range(spans.shape[0]):
        span = spans[k, 0], spans[k, 1]
        distortion += called_at(code.distortions, distortions, (nodes, parts.first, span, scale, sums))
    distortion /= corners
    if not np.isfinite(distortion):
        return REFUSED
    if scales.obliqueness > 0.0:
        scale = scales.obliqueness * (2.0 * square / corners)
        for k in range(spans.shape[0]):
            span = spans[k, 0], spans[k, 1]
            oblique += called_at(code.oblique, oblique_corners, (nodes, span, scales.largest_cotangent, scale, sums))
    bends = called_at(code.finish, finish, (mesh, parts.start, sums, 0.5 / square, parts.smooth, gradient, blocks))
    value = 0.5 * np.log(square) + scales.distortion * distortion + scales.obliqueness * oblique / corners
    out[VALUE] = value + scales.smoothness * bends
    out[ERROR], out[DISTORTION] = np.sqrt(square), distortion
    return KNOWN


@compiled
def interpolated(parts: Parts, nodes: Nodes) -> float:
    """The squared error of the interpolant, with its sums of the nodes in place of all others; else not finite."""
    element, (sums, nodal, x, y, at), code = parts.element, parts.memory, parts.code
    fill(parts.u, nodes.x, nodes.y, nodal)
    known, points, total = NodalValues(nodal[0], nodal[1], nodal[2]), element.weights.size, 0.0
    if not are_finite_at_nodes(known):
        return np.inf
    clear(sums)
    for k in range(parts.spans.shape[0]):
        first, last = parts.spans[k, 0], parts.spans[k, 1]
        elements, count = parts.elements[first:last], last - first
        size = count * points
        called_at(code.place, place_points, (nodes, elements, element.shape, 0, x, y))
        fill(parts.u, x[:size], y[:size], at)
        every = values_in(at, points, count)
        if parts.error == OF_VALUES:
            values = NodalValues(every.u, every.u_x, every.u_y)
            square, check = called_at(
                code.values, quad_value_errors, (nodes, (first, last), element, known, values, sums)
            )
        else:
            square, check = called_at(code.slopes, slope_errors, (nodes, elements, element, known, every, sums))
        if not np.isfinite(check):
            return np.inf
        total += square
    return total


@compiled
def projected(parts: Parts, nodes: Nodes) -> float:
    """The squared error of the Ritz projection, as :func:`interpolated`; negative without a projection."""
    element, (sums, nodal, x, y, at), matrix = parts.element, parts.memory, parts.matrix
    fill(parts.u, nodes.x, nodes.y, nodal)
    known, count, points = NodalValues(nodal[0], nodal[1], nodal[2]), parts.elements.shape[0], element.weights.size
    if not are_finite_at_nodes(known):
        return np.inf
    called_at(parts.code.place, place_points, (nodes, parts.elements, element.shape, 0, x, y))
    fill(parts.u, x, y, at)
    every = values_in(at, points, count)
    if not are_finite(every):
        return np.inf
    clear(sums)
    clear(matrix)
    places = Places(nodes, parts.elements, known, every)
    return called_at(parts.code.projection, projected_errors, (places, element, parts.number, matrix, sums))


@compiled
def values_in(at: Array, points: int, count: int) -> Values:
    """The rows of values at ``points`` of ``count`` elements, as tables of shape ``(points, count)``."""
    shape, size = (points, count), points * count
    return Values(
        at[0, :size].reshape(shape),
        at[1, :size].reshape(shape),
        at[2, :size].reshape(shape),
        at[3, :size].reshape(shape),
        at[4, :size].reshape(shape),
        at[5, :size].reshape(shape),
    )


@compiled
def are_finite_at_nodes(known: NodalValues) -> bool:
    """Whether u and its gradient are finite at all nodes."""
    total = 0.0
    for k in range(known.u.size):
        total += 0.0 * known.u[k] + 0.0 * known.u_x[k] + 0.0 * known.u_y[k]
    return total == 0.0


@compiled
def clear(rows: Array) -> None:
    """Set all numbers to 0."""
    for k in range(rows.shape[0]):
        for j in range(rows.shape[1]):
            rows[k, j] = 0.0
