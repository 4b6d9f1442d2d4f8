"""Predicted rates of the Schwarz iteration, from the leading part of the equations.

The leading part of the mesh equations is a family of independent one-dimensional problems ``P_xixi = 0`` along the grid
lines, ``P = M r_xi . dr`` the move of a node in the metric, whatever the spacing. The error of one subdomain on a line
therefore is a straight line, two numbers, and an iteration on N subdomains a matrix of 2N columns, whose spectral
radius is the rate. Of a straight line we keep what it extrapolates to at the two ends of the whole grid line: in these
numbers a Robin condition with the automatic p hands over one of them as it is.

What is left out is how the two families of grid lines are coupled; it decides where the leading part has no error left.
"""

from dataclasses import replace

import numpy as np

from equimesh.numerics.types import Array, IntArray
from equimesh.schwarz.conditions import (
    Classical,
    LinearRobin,
    LineData,
    NonlinearRobin,
    Optimized,
    TransmissionCondition,
)
from equimesh.schwarz.decomposition import Decomposition
from equimesh.schwarz.ordering import Ordering, turns
from equimesh.schwarz.settings import Acceleration, Schwarz


def predicted_rate(decomposition: Decomposition, settings: Schwarz) -> float | None:
    """Factor by which the error of the leading part falls in one iteration, for large iteration numbers.

    For classical Schwarz with two subdomains this is ``alpha (1 - beta) / (beta (1 - alpha))`` for one alternating, or
    two parallel, iterations, for any metric. Of the Robin conditions with a number for ``p`` it is exact where the
    metric does not vary across the interfaces, and for the nonlinear one is 1 there, since ``p`` is then compared with
    a metric length. 0 where the leading part is exact after some iterations (:func:`steps_to_exact`): with the
    automatic ``p``, the optimized condition, or line corrections; what is observed then is the coupling of the two
    families of grid lines. More than 1 where the iteration diverges. Anderson's acceleration is not taken into account.
    ``None`` for one subdomain.
    """
    matrices = _matrices(decomposition, settings)
    if matrices is None:
        return None
    return max(
        (float(np.abs(np.linalg.eigvals(m)).max()) for m in matrices if _index_of_nilpotency(m) is None), default=0.0
    )


def steps_to_exact(decomposition: Decomposition, settings: Schwarz) -> int | None:
    """After how many iterations the leading part has no error left, from any start; ``None`` where there always is one.

    1 with line corrections, with line sums and for one subdomain. With the automatic ``p`` or local data it is how long
    data takes from one end of the grid lines to the other: the number of strips for parallel iterations.
    """
    found = [_index_of_nilpotency(m) for m in _matrices(decomposition, settings) or []]
    known = [steps for steps in found if steps is not None]
    return max(known, default=1) if len(known) == len(found) else None


def _matrices(decomposition: Decomposition, settings: Schwarz) -> list[Array] | None:
    """One iteration on a xi-line, and on an eta-line, as far as they are cut; ``None`` for one subdomain.

    On blocks a line belongs to one row of them alone, whose subdomains take their turns as strips would. (Not so where
    two rows overlap, if blocks take turns and read local data: they find there what both have written, and can stall.)
    """
    columns, rows = decomposition.subdomains
    cut = [(axis, strips) for axis, strips in enumerate(((columns, 1), (1, rows))) if strips != (1, 1)]
    if not cut:
        return None
    if settings.line_corrections or settings.accelerated_by is Acceleration.NEWTON:
        return [np.zeros((2, 2))]
    return [_Line(replace(decomposition, subdomains=strips), axis, settings).iteration() for axis, strips in cut]


def _index_of_nilpotency(matrix: Array) -> int | None:
    """The lowest power of a matrix that is zero, if there is one."""
    squared = matrix
    for _ in range(len(matrix).bit_length()):
        largest = np.abs(squared).max()
        squared = (squared / largest) @ (squared / largest) if largest > 0.0 else squared
    if squared.any():
        return None
    power = np.eye(len(matrix))
    for exponent in range(1, len(matrix) + 1):
        power = matrix @ power
        if not power.any():
            return exponent
        power /= np.abs(power).max()
    return None


class _Line:
    """A grid line across strips, and the errors of the subdomains on it: arrays of the ends of straight lines, at the
    first and at the last node of the grid line, shape ``(strips, 2, any)``."""

    def __init__(self, strips: Decomposition, axis: int, settings: Schwarz) -> None:
        self._spans = strips.spans[axis]
        self._edges = strips.grid.shape[axis] - 1
        self._turns = turns(strips, settings.ordering)
        self._condition: TransmissionCondition = settings.transmission
        # As the iteration does: subdomains that take turns write all of their points into the merged mesh.
        self._whole = settings.ordering is not Ordering.PARALLEL

    def iteration(self) -> Array:
        """The matrix of one iteration."""
        count = len(self._spans)
        errors, owners = np.eye(2 * count).reshape(count, 2, 2 * count), np.zeros(self._edges + 1, dtype=np.int64)
        for turn in self._turns:
            self._write(turn, owners)
        for turn in self._turns:
            new = {k: self._solved(k, errors, owners) for k in turn}
            errors = errors.copy()
            for k, solved in new.items():
                errors[k] = solved
            self._write(turn, owners)
        return np.asarray(errors.reshape(2 * count, 2 * count))

    def _write(self, turn: list[int], owners: IntArray) -> None:
        """Note who wrote the nodes of the merged mesh."""
        for k in turn:
            span = self._spans[k]
            first, last = (span.first, span.last) if self._whole else (span.owned_first, span.owned_last)
            owners[first : last + 1] = k

    def _solved(self, k: int, errors: Array, owners: IntArray) -> Array:
        """The error of a subdomain with the data of its neighbours."""
        rows, given = np.eye(2), np.zeros((2, errors.shape[2]))
        for end in (0, 1):
            if 0 <= k + (2 * end - 1) < len(self._spans):
                rows[end], given[end] = self._interface(k, end, errors, owners)
        return np.asarray(np.linalg.solve(rows, given), dtype=np.float64)

    def _interface(self, k: int, end: int, errors: Array, owners: IntArray) -> tuple[Array, Array]:
        """The condition at one end of a subdomain: what it asks of the ends of a straight line, and what is given.

        In units of one edge, and times the number of edges, so that integers stay integers.
        """
        span, side = self._spans[k], 2 * end - 1
        node = span.last if end else span.first
        condition = self._condition
        if isinstance(condition, Optimized):
            if condition.data is LineData.LINE_SUMS:
                return np.eye(2)[end], np.zeros(errors.shape[2])
            beyond = self._edges - node if end else node
            at, next_to = (self._at(i) @ errors[owners[i]] for i in (node, node + side))
            return self._edges * np.eye(2)[end], at + beyond * (next_to - at)
        row = self._functional(condition, node, end)
        return row, row @ errors[k + side]

    def _functional(self, condition: Classical | LinearRobin | NonlinearRobin, node: int, end: int) -> Array:
        """The functional of a condition of the paper on a straight line."""
        if isinstance(condition, Classical):
            return self._at(node)
        if condition.p == "auto":
            return np.asarray(np.eye(2)[end])
        slope = np.array([-1.0, 1.0]) * self._edges
        return np.asarray(slope + (condition.p if end else -condition.p) * self._at(node))

    def _at(self, node: int) -> Array:
        """The value at a node, by the values at the ends, times the number of edges."""
        return np.array([self._edges - node, node], dtype=float)
