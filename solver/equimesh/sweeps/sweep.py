"""The chord iteration: line corrections in place of Newton's sparse factorisation.

The equations are two families of one-dimensional problems, coupled through the metric. To leading order the squared
metric length of a xi-edge depends on the nodes through ``P = A dx + B dy`` alone, ``(A, B) = M r_xi``, and that of an
eta-edge through ``Q = C dx + D dy``, ``(C, D) = M r_eta``: lengths along a xi-line become equal if P is the running sum
of the line's defects; the same holds for Q along an eta-line. The move of each node then follows from a 2 x 2 system,
whose determinant ``det(M) J`` is positive on a valid mesh. The error falls by a factor that does not depend on the
number of points.

The nodes on the sides move by the same rule, at the same time. The iteration is local: it needs a start near the
solution, for instance from a coarser grid, or damping.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from equimesh.equations.boundary import Boundary
from equimesh.equations.metric import ReferenceMetric
from equimesh.meshes.folding import smallest_in_parts
from equimesh.meshes.parts import Part, Parts, strips_of
from equimesh.numerics.types import Array, Pair, SingleArray
from equimesh.sweeps import kernels
from equimesh.sweeps.kernels import Lines, Moved, Nodes, Strip, copy_ends
from equimesh.sweeps.line_sums import LineSums, cell_memory, cell_metrics
from equimesh.sweeps.sides import WHOLE, Frame, SideNodes, Sides, finite_or_infinite

# One part of a sweep: the strips of rows that one thread corrects, in two phases.
#
# Between the phases stand the sums along the xi-lines, to which all parts contribute. A part reads the rows next to
# its own, and writes its own only. The whole grid is the case of one part.


class PartSweep:
    """The corrections of one part, with the memory for the metric of its cells."""

    def __init__(
        self,
        metric: ReferenceMetric,
        parts: Parts,
        part: Part,
        summed: int,
        along_q: SingleArray | None = None,
    ) -> None:
        """The xi-edges from rows of the grid below ``summed`` belong to the xi-lines.

        ``along_q`` of shape ``(2, n_xi, n_eta)`` is working memory where the eta-lines are closed.
        """
        self._along_q = along_q
        self._metric, self._last = metric, parts.shape[0] - 1 - parts.begin
        self._first = 1 - parts.begin
        self._strips = [(k, Strip(*parts.strips[k], summed - parts.begin)) for k in part.strips]
        # As many rows for every part: the machine code of a kernel, and so its rounding, depends on the layout.
        rows = max((last - first for first, last in strips_of(parts.shape)), default=0)
        self._cells = cell_memory(rows + 1, parts.shape[1])

    def along_eta(
        self, nodes: Nodes, u: Array | None, along: tuple[Array, Array], lines: Lines, out: Moved, sums: LineSums
    ) -> float:
        """The first phase: correct the eta-lines, and sum the xi-edges of every strip.

        ``along`` holds the moves of the nodes on the sides: along eta (left, right), and along xi (bottom, top) in the
        rows that are held. ``u`` is given at all nodes where it is known. Returns the largest relative deviation along
        the lines.
        """
        (x, y), (along_eta, along_xi), largest = nodes, along, 0.0
        for k, strip in self._strips:
            cells, rows = self._cells[:, : strip.last - strip.first + 1], slice(strip.first - 1, strip.last + 1)
            cell_metrics(self._metric, x[rows], y[rows], cells, None if u is None else u[rows])
            if strip.first == self._first:
                kernels.end_edges(x, y, cells, 0, along_eta[0], sums.pushes[0], sums.first)
            if strip.last == self._last:
                kernels.end_edges(x, y, cells, -1, along_eta[1], sums.pushes[1], sums.first)
            if self._along_q is not None:
                found = kernels.closed_eta_corrections(nodes, cells, strip, out, self._along_q, sums.strips[k])
            else:
                found = kernels.eta_corrections(nodes, cells, strip, along_xi, lines, out, sums.strips[k])
            if sums.closings is not None:
                kernels.closing_sums(strip, sums.edges, out, sums.closings[k])
            largest = max(largest, finite_or_infinite(found))
        return largest

    def along_xi(self, nodes: Nodes, out: Moved, sums: LineSums) -> tuple[float, float]:
        """The second phase: add the corrections of the xi-lines, from the starts of the strips.

        Returns the largest relative deviation along the lines, and the largest move of a coordinate.
        """
        found = np.zeros((len(self._strips), 2))
        for (k, strip), largest in zip(self._strips, found, strict=True):
            data = nodes, strip, sums.levels, sums.starts[k], out
            if self._along_q is None:
                kernels.xi_corrections(*data, largest)
            else:
                kernels.closed_xi_corrections(*data, self._along_q, largest)
        deviation, move = (max(map(finite_or_infinite, column), default=0.0) for column in found.T.tolist())
        return deviation, move


# On at most this many nodes u and its gradient are evaluated at all nodes at once, not separately on the sides.
MAX_NODES_AT_ONCE = 1_024
# The moves of a sweep that would fold the mesh are halved, but not below this share.
MIN_MOVE_SHARE = 1 / 64


def halve_moves(moved: Array, old: Array) -> None:
    """Halve the moves from ``old`` to ``moved``, in place."""
    moved -= old
    moved *= 0.5
    moved += old


def take_midpoints(moved: Array, old: Array) -> None:
    """The same as :func:`halve_moves` but for rounding, which the meshes of subdomains show in their last bit."""
    moved += old
    moved *= 0.5


@dataclass(frozen=True)
class Correction:
    """The numbers of one sweep in the rows that the process holds, infinite where something is not a number.

    ``deviation`` is the largest relative deviation of a squared metric length from the mean of its line before the
    sweep, ``move`` the largest move of a coordinate.
    """

    deviation: float
    move: float


@dataclass(frozen=True)
class Taken:
    """The numbers of one sweep that has been guarded, over all rows of the grid.

    ``share`` of the moves remains, and ``smallest`` is the smallest Jacobian then, 0 if halving did not help.
    ``deviation`` and ``move`` are those of the :class:`Correction`. ``gap`` is what :meth:`Sweep.guard` was told to
    measure, NaN if nothing.
    """

    share: float
    smallest: float
    deviation: float
    move: float
    gap: float


class Sweep:
    """Sweeps of line corrections on the whole grid or a window of it, with their working memory.

    ``new_x`` and ``new_y`` hold the moved nodes after :meth:`correct`. All arrays have the rows that the process holds.
    The ``parts`` of these rows are corrected at the same time, each on its own thread. Where other processes hold other
    rows, each of them sweeps its own ones at the same time. Results do not depend on the numbers of both.
    """

    def __init__(
        self, metric: ReferenceMetric, boundary: Boundary, parts: Parts, memory: Array, frame: Frame = WHOLE
    ) -> None:
        """``memory`` is a flat array of at least ``memory_needed(parts.held_shape)`` numbers.

        A window with a ``frame`` of its own is a whole grid for :attr:`parts`.
        """
        shape, held = parts.shape, parts.held_shape
        self.metric, self.boundary, self.frame, self.parts = metric, boundary, frame, parts
        arrays = memory[: memory_needed(held)].reshape(4, *held)
        self.new_x, self.new_y, self._squares = arrays[0], arrays[1], arrays[2]
        self._along_p = arrays[3].reshape(-1).view(np.float32).reshape(2, *held)  # single precision is enough
        summed = frame.span(0, shape[0])[1]
        along_q = np.empty((2, *held), dtype=np.float32) if frame.closed[1] else None
        self._sweeps = {part: PartSweep(metric, parts, part, summed, along_q) for part in parts.parts}
        self._sums = LineSums(parts, summed, closed=frame.closed[0])
        none = np.zeros((2, shape[1])), np.zeros((2, held[0]))
        self._lines = [Lines(*frame.span(k, shape[k]), none[k], frame.beyond[k], none[k]) for k in (0, 1)]
        self._sides = Sides(metric, boundary, shape, frame)
        # The nodes of the sides before and after a sweep. They are kept where a process does not hold all of them.
        self._side_nodes: SideNodes | None = None
        self._moved_side_nodes: SideNodes | None = None

    def correct(self, x: Array, y: Array, rest: Pair | None = None, push: Pair | None = None) -> Correction:
        """One full correction of the nodes ``x``, ``y``; the result is in ``new_x`` and ``new_y``.

        ``rest`` holds the sums of the squared metric lengths of the edges beyond the yielding sides, of shape
        ``(2, n_eta)`` at the two ends of the xi-lines and ``(2, n_xi)`` at those of the eta-lines. ``push``, of the
        same shapes, is what the ends of the lines outside a window add to ``-2 P`` and ``-2 Q``, because they move.

        Where other processes hold other rows, ``x`` and ``y`` have the rows next to the own ones, and so have the moved
        nodes afterwards; then each sweep begins where :meth:`swap` has left the one before it.
        """
        lines = self._lines
        if rest is not None:
            lines = [k._replace(rest=sums) for k, sums in zip(lines, rest, strict=True)]
        if push is not None:
            lines = [k._replace(push=moves) for k, moves in zip(lines, push, strict=True)]
        sweeps, sums, parts = self._sweeps, self._sums, self.parts
        with np.errstate(all="ignore"):
            at_once = parts.is_whole and x.size <= MAX_NODES_AT_ONCE
            nodal = self.metric.u_with_gradient(x, y) if at_once else None
            at = self._sides_before(x, y)
            sides, side_move, *along = self._sides.moves(at, nodal, rest)
            u, pair = None if nodal is None else nodal[0], (along[0], np.ascontiguousarray(along[1][:, parts.held]))
            nodes, out = Nodes(x, y), Moved(self.new_x, self.new_y, self._along_p, self._squares)
            eta = parts.each(lambda part: sweeps[part].along_eta(nodes, u, pair, lines[1], out, sums))
            if push is not None:
                sums.pushes[:] += push[0]
            ends = sums.solve(lines[0])
            xi = parts.each(lambda part: sweeps[part].along_xi(nodes, out, sums))
            along_sides, lag = self._sides.place((x, y), (along[0], along[1]), (self.new_x, self.new_y), parts)
            self._copy_ends()
        if not parts.is_whole:
            self._moved_side_nodes = at.moved(*along)
            parts.fill_halos(self.new_x, self.new_y)
        deviations, moves = zip(*xi, strict=True)
        return Correction(
            finite_or_infinite(max(sides, ends, *eta, *deviations, lag)),
            finite_or_infinite(max(side_move, *moves, along_sides)),
        )

    def _copy_ends(self) -> None:
        """Let the outermost grid lines of closed directions follow the moved nodes."""
        for axis in (1, 0):
            if self.frame.closed[axis]:
                copy_ends(self.new_x, axis, float(axis == 0))
                copy_ends(self.new_y, axis, float(axis == 1))

    def _sides_before(self, x: Array, y: Array) -> SideNodes:
        """The nodes of the sides before a sweep."""
        if self.parts.is_whole:
            return SideNodes.of(x, y)
        if self._side_nodes is None:
            self._side_nodes = SideNodes.gathered(x, y, self.parts)
        return self._side_nodes

    @property
    def smallest_jacobian(self) -> float:
        """The smallest corner Jacobian of the moved nodes, not scaled by the spacing; NaN where one is not finite."""
        return smallest_in_parts(self.new_x, self.new_y, self.parts)

    def guard(
        self,
        x: Array,
        y: Array,
        found: Correction,
        *,
        halve: bool = False,
        floor: float = 0.0,
        min_share: float = MIN_MOVE_SHARE,
        shorten: Callable[[Array, Array], None] = halve_moves,
        measure: Callable[[Array, Array], float] | None = None,
    ) -> Taken:
        """Halve the moves of the last :meth:`correct` until the smallest Jacobian is above ``floor``.

        ``x`` and ``y`` are the nodes before the sweep, ``found`` its numbers. ``halve`` halves at least once. Moves are
        not reduced below ``min_share``. ``shorten`` halves the moves of one coordinate. ``measure`` gives another
        number of the moved nodes, of which the largest counts. All processes agree on the result.
        """
        share, needed, here = 1.0, halve, self.parts.here
        while True:
            if needed:
                self._shorten(x, y, shorten)
                share *= 0.5
            gap = math.nan if measure is None else measure(self.new_x, self.new_y)
            smallest = smallest_in_parts(self.new_x, self.new_y, here)
            deviation, move, negative, gap = self.parts.agree(found.deviation, found.move, -smallest, gap)
            if -negative > floor:
                return Taken(share, -negative, deviation, move, gap)
            if 0.5 * share < min_share:
                return Taken(share, 0.0, deviation, move, gap)
            needed = True

    def _shorten(self, x: Array, y: Array, shorten: Callable[[Array, Array], None]) -> None:
        shorten(self.new_x, x)
        shorten(self.new_y, y)
        if self._side_nodes is not None and self._moved_side_nodes is not None:
            for moved, old in zip(self._moved_side_nodes, self._side_nodes, strict=True):
                shorten(moved, old)

    def swap(self, x: Array, y: Array) -> tuple[Array, Array]:
        """The moved nodes; ``x`` and ``y`` are the memory for the next ones."""
        moved = self.new_x, self.new_y
        self.new_x, self.new_y = x, y
        self._side_nodes = self._moved_side_nodes
        return moved


def memory_needed(shape: tuple[int, int]) -> int:
    """The size of the working memory of a :class:`Sweep`, in numbers."""
    return 4 * shape[0] * shape[1]


# The error that remains when every move is smaller than the one before it by a fixed factor.


def error_left(move: float, contraction: float) -> float:
    """The remaining distance after a ``move``, if each later move is smaller by the factor ``contraction``.

    The sum of a geometric series, in the unit of ``move``; infinite where the moves do not get smaller.
    """
    if contraction < 1.0:
        return move * contraction / (1.0 - contraction)
    return math.inf if move > 0.0 else 0.0
