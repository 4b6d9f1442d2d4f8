"""Predicted rates of the Schwarz iteration, from the leading part of the equations.

The leading part of the mesh equations is a family of independent one-dimensional problems ``P_xixi = 0`` along the grid
lines. ``P = M r_xi . dr`` is the move of a node in the metric, for any spacing. The error of one subdomain on a line is
therefore a straight line: two numbers. An iteration on N subdomains is a matrix of 2N columns, whose spectral radius is
the rate. The two numbers here are the extrapolated values at both ends of the whole grid line: a Robin condition with
the automatic p passes on one of them unchanged.

The coupling of the two families of grid lines is left out. It determines the rate where the leading part has no error.
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
from equimesh.schwarz.decomposition import Decomposition, Ordering, turns
from equimesh.schwarz.settings import Acceleration, Schwarz


def predicted_rate(decomposition: Decomposition, settings: Schwarz) -> float | None:
    """Factor by which the error of the leading part falls in one iteration, for large iteration numbers.

    For classical Schwarz with two subdomains this is ``alpha (1 - beta) / (beta (1 - alpha))`` for one alternating, or
    two parallel, iterations, for any metric. For Robin conditions with a number for ``p`` it is exact where the metric
    does not vary across the interfaces; for the nonlinear one that metric must also be 1, since ``p`` is compared with
    a metric length. The rate is 0 where the leading part is exact after some iterations (:func:`steps_to_exact`): with
    the automatic ``p``, the optimized condition, or line corrections. The observed rate is then due to the coupling of
    the two families of grid lines. It is more than 1 where the iteration diverges. Anderson's acceleration is not taken
    into account. ``None`` for one subdomain.
    """
    matrices = _matrices(decomposition, settings)
    if matrices is None:
        return None
    return max(
        (float(np.abs(np.linalg.eigvals(m)).max()) for m in matrices if _index_of_nilpotency(m) is None), default=0.0
    )


def steps_to_exact(decomposition: Decomposition, settings: Schwarz) -> int | None:
    """The number of iterations after which the leading part is exact, from any start; ``None`` if it never is.

    1 with line corrections, with line sums and for one subdomain. With the automatic ``p`` or local data it is the
    number of iterations in which data crosses the whole grid: the number of strips for parallel iterations.
    """
    found = [_index_of_nilpotency(m) for m in _matrices(decomposition, settings) or []]
    known = [steps for steps in found if steps is not None]
    return max(known, default=1) if len(known) == len(found) else None


def _matrices(decomposition: Decomposition, settings: Schwarz) -> list[Array] | None:
    """One iteration on a xi-line, and on an eta-line, where these are cut; ``None`` for one subdomain.

    On blocks a line belongs to one row of blocks, whose subdomains take turns as strips do. (This does not hold where
    two rows overlap, if blocks take turns and read local data: they read there what both have written, and can stall.)
    """
    columns, rows = decomposition.subdomains
    (at_xi, at_eta), strips = decomposition.cuts, []
    if columns > 1:
        strips.append((0, replace(decomposition, subdomains=(columns, 1), cuts=(at_xi, None))))
    if rows > 1:
        strips.append((1, replace(decomposition, subdomains=(1, rows), cuts=(None, at_eta))))
    if not strips:
        return None
    if settings.line_corrections or settings.accelerated_by is Acceleration.NEWTON:
        return [np.zeros((2, 2))]
    return [_Line(cut, axis, settings).iteration() for axis, cut in strips]


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
    """A grid line across strips, and the errors of the subdomains on it, of shape ``(strips, 2, any)``.

    An error is a straight line, given by its values at the first and last node of the grid line.
    """

    def __init__(self, strips: Decomposition, axis: int, settings: Schwarz) -> None:
        self._spans = strips.spans[axis]
        self._edges = strips.grid.shape[axis] - 1
        self._turns = turns(strips, settings.ordering)
        self._condition: TransmissionCondition = settings.transmission
        # As in the iteration: subdomains that take turns write all of their points into the merged mesh.
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
        """Note the subdomains that wrote the nodes of the merged mesh."""
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
        """The condition at one end of a subdomain: its row for the ends of a straight line, and its right side.

        In units of one edge, times the number of edges, so that integers stay integers.
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
