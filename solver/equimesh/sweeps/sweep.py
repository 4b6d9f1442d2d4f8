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
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from equimesh.equations.metric import ReferenceMetric, Tensor
from equimesh.equations.problem import Boundary
from equimesh.meshes.mesh import smallest_here, smallest_of_rows
from equimesh.meshes.rows import Rows, Share, strips_of
from equimesh.numerics.types import Array, Pair, SingleArray
from equimesh.sweeps import closed_lines, kernels
from equimesh.sweeps.closed_lines import closed_side_moves, copy_ends
from equimesh.sweeps.kernels import Lines, Moved, Nodes, SidePair, Strip, side_moves
from equimesh.sweeps.line_sums import LineSums, cell_memory, cell_metrics

# The four sides of a sweep: closed one-dimensional problems, solved first.

# The kind of the four sides of a window of the grid, for the line corrections.


@dataclass(frozen=True, kw_only=True)
class Frame:
    """The kind of the four sides of a window, by direction (0 across xi, 1 across eta) and end.

    A side is ``physical``, or its outermost grid line is held in place. A held side *yields* if edges of the whole grid
    lie ``beyond`` it: the lines that cross it then end on the line before it, and these ends move, since the edges
    outside share the metric length of the line. A held side without edges beyond is fixed.

    Lines of a ``closed`` direction have no ends. The outermost grid lines are then copies of the nodes on the other
    side, moved by 1: the nodes in between are all nodes of the line, once each.
    """

    physical: tuple[tuple[bool, bool], tuple[bool, bool]] = ((True, True), (True, True))
    beyond: tuple[tuple[float, float], tuple[float, float]] = ((0.0, 0.0), (0.0, 0.0))
    closed: tuple[bool, bool] = (False, False)

    @classmethod
    def around(cls, closed: tuple[bool, bool]) -> Frame:
        """The whole grid with lines that are closed, and physical sides in the other directions."""
        return cls(physical=((not closed[0],) * 2, (not closed[1],) * 2), closed=closed)

    def span(self, axis: int, points: int) -> tuple[int, int]:
        """First and last node of the lines along a direction, in a window of ``points`` points."""
        if self.closed[axis]:
            return 1, points - 1
        lower, upper = self.beyond[axis]
        return int(lower > 0), points - 1 - int(upper > 0)


WHOLE = Frame()
"""The whole grid: four physical sides."""


# The positions of the nodes along the four sides, in full, also where only some rows of a grid are here.


class SideNodes(NamedTuple):
    """Positions along the sides: y on the left and right, ``(2, n_eta)``; x on the bottom and top, ``(2, n_xi)``."""

    along_eta: Array
    along_xi: Array

    @classmethod
    def of(cls, x: Array, y: Array) -> SideNodes:
        """The sides of a whole mesh."""
        n_xi, n_eta = x.shape
        return cls(y[:: n_xi - 1].copy(), x.T[:: n_eta - 1].copy())

    @classmethod
    def of_rows(cls, x: Array, y: Array, rows: Rows) -> SideNodes:
        """The sides of a whole mesh, of which ``x`` and ``y`` have the ``rows`` that are here."""
        if rows.are_all:
            return cls.of(x, y)
        own = rows.own_nodes
        on_sides = [own.start] * (rows.first == 0) + [own.stop - 1] * (rows.first < rows.last == rows.cells[0])
        along_xi = rows.joined(x[own][:, [0, -1]])
        return cls(rows.joined(y[on_sides]), np.ascontiguousarray(along_xi.T))

    def moved(self, along_eta: Array, along_xi: Array) -> SideNodes:
        """The positions after these moves."""
        return SideNodes(self.along_eta + along_eta, self.along_xi + along_xi)


def finite_or_infinite(number: float) -> float:
    """The number, or infinity where it is NaN or infinite."""
    return number if math.isfinite(number) else math.inf


class Sides:
    """The moves of the nodes on the physical sides, along them."""

    def __init__(
        self, metric: ReferenceMetric, boundary: Boundary, shape: tuple[int, int], frame: Frame = WHOLE
    ) -> None:
        self.metric, self.boundary, self.shape, self.frame = metric, boundary, shape, frame
        arc_length = metric.arc_length
        self._strength = (arc_length.a**2, arc_length.b) if arc_length is not None else (0.0, 0.0)
        self._lines = [
            Lines(*frame.span(k, shape[k]), np.zeros((2, 2)), frame.beyond[k], np.zeros((2, 2))) for k in (1, 0)
        ]
        n_xi, n_eta = shape
        self._ends_xi, self._ends_eta = np.repeat([0.0, 1.0], n_eta), np.repeat([0.0, 1.0], n_xi)
        self._base = self._unit_base() if metric.on_unit_square and arc_length is not None else None
        self.fluxes = np.zeros((2, n_eta - 1)), np.zeros((2, n_xi - 1))

    def moves(
        self, at: SideNodes, nodal: Tensor | None = None, rest: Pair | None = None
    ) -> tuple[float, float, Array, Array]:
        """The largest deviation and move, then the moves along eta (left, right) and along xi (bottom, top).

        ``at`` are the positions along the sides. The moves have the shapes ``(2, n_eta)`` and ``(2, n_xi)`` and are
        zero on sides that are not physical. ``nodal`` is u with its gradient at all nodes, where it is known; ``rest``
        as in :meth:`Sweep.correct`. :attr:`fluxes` then holds the squared metric lengths of the edges, of shape
        ``(2, n_eta - 1)`` on the left and right side and ``(2, n_xi - 1)`` on the others.
        """
        n_xi, n_eta = self.shape
        moves = np.zeros((2, n_eta)), np.zeros((2, n_xi))
        if self.boundary is Boundary.ORTHOGONAL or not any(map(any, self.frame.physical)):
            return 0.0, 0.0, *moves
        deviation = largest = 0.0
        for axis, pair in enumerate(self._pairs(at, nodal)):
            if self.frame.closed[1 - axis]:
                if any(self.frame.physical[axis]):
                    found, move = closed_side_moves(pair, self._strength, self.fluxes[axis], moves[axis])
                    deviation, largest = max(deviation, finite_or_infinite(found)), max(largest, move)
                continue
            lines = self._lines[axis]
            if rest is not None:
                lines = lines._replace(rest=rest[1 - axis][:, [0, -1]].copy())
            found, move = side_moves(
                pair,
                self._strength,
                self.frame.physical[axis],
                lines,
                self.fluxes[axis],
                moves[axis],
            )
            deviation, largest = max(deviation, finite_or_infinite(found)), max(largest, move)
        return deviation, largest, *moves

    def _pairs(self, at: SideNodes, nodal: Tensor | None) -> Iterator[SidePair]:
        """The left and right side, then the bottom and top one; ``u_n`` is zero where the condition ignores it."""
        n_xi, n_eta = self.shape
        t_eta, t_xi = at
        if nodal is None:
            u_eta, u_xi = self._evaluated(t_eta, t_xi)
        else:
            u_eta = nodal[0][:: n_xi - 1].copy(), nodal[1][:: n_xi - 1].copy()
            u_xi = nodal[0].T[:: n_eta - 1].copy(), nodal[2].T[:: n_eta - 1].copy()
        for t, (u, u_n), base in zip((t_eta, t_xi), (u_eta, u_xi), self._base or self.bases(t_eta, t_xi), strict=True):
            yield SidePair(t, u, np.zeros_like(u_n) if self.boundary is Boundary.EQUIDISTRIBUTED_1D else u_n, base)

    def _evaluated(self, t_eta: Array, t_xi: Array) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        """u and its normal derivative on the left and right sides, and on the bottom and top."""
        s = np.concatenate([self._ends_xi, t_xi.ravel()])
        t = np.concatenate([t_eta.ravel(), self._ends_eta])
        u, u_s, u_t = self.metric.u_with_gradient(s, t)
        cut = t_eta.size
        left_right = (u[:cut].reshape(t_eta.shape), u_s[:cut].reshape(t_eta.shape))
        return left_right, (u[cut:].reshape(t_xi.shape), u_t[cut:].reshape(t_xi.shape))

    def place(self, old: Pair, along: Pair, new: Pair, rows: Rows) -> tuple[float, float]:
        """Write the new positions of the nodes of the sides to ``new``, in the ``rows`` that are here.

        ``old`` are the nodes before the sweep, ``along`` the moves along the sides, in full. Returns the largest move
        and deviation of the own nodes that follow the interior, zero if there are none.
        """
        (x, y), (new_x, new_y), (along_eta, along_xi) = old, new, along
        change, lag = 0.0, 0.0
        for axis, (before, q, fixed, moved) in enumerate(
            ((y, new_y, new_x, along_eta), (x.T, new_x.T, new_y.T, along_xi[:, rows.here]))
        ):
            for side, (end, one, two) in enumerate(((0, 1, 2), (-1, -2, -3))):
                if axis == 0 and not (rows.begin == 0, rows.end == self.shape[0])[side]:
                    continue
                fixed[end], q[end] = (x, y.T)[axis][end], before[end] + moved[end]
                if self.boundary is not Boundary.ORTHOGONAL or not self.frame.physical[axis][side]:
                    continue
                inner = slice(1, -1) if axis == 0 else _between_corners(rows)
                q[end, inner] = (4 * q[one, inner] - q[two, inner]) / 3
                change = max(change, float(np.abs(q[end] - before[end]).max()))
                wanted = (4 * before[one, inner] - before[two, inner]) / 3
                edges = self.shape[1 - axis] - 1
                lag = max(lag, float(np.abs(wanted - before[end, inner]).max()) * edges)
        return change, lag

    def _unit_base(self) -> tuple[Array, Array]:
        one = np.array([1.0, 0.0, 1.0])[:, None, None]
        return one * np.ones((2, self.shape[1] - 1)), one * np.ones((2, self.shape[0] - 1))

    def bases(self, t_eta: Array, t_xi: Array) -> tuple[Array, Array]:
        """The pointwise part of the metric at the middles of the edges, its tangential entry first."""
        found = []
        for nodes, axis in ((t_eta, 0), (t_xi, 1)):
            middles = 0.5 * (nodes[:, 1:] + nodes[:, :-1])
            fixed = np.repeat([[0.0], [1.0]], middles.shape[1], axis=1)
            b11, b12, b22 = self.metric.base(*((fixed, middles) if axis == 0 else (middles, fixed)))
            tensor = np.stack([b22, b12, b11] if axis == 0 else [b11, b12, b22])
            if self.boundary is Boundary.EQUIDISTRIBUTED_1D:  # only the metric along the side counts
                tensor[1], tensor[2] = 0.0, 1.0
            found.append(tensor)
        return found[0], found[1]


def _between_corners(rows: Rows) -> slice:
    """The own rows of nodes between the first and the last one of the grid, counted from the first that is here."""
    return slice(max(rows.first, 1) - rows.begin, rows.last - rows.begin)


# The share of a sweep: the strips of rows that one thread corrects, in two phases.
#
# Between the phases stand the sums along the xi-lines, to which all threads contribute. A thread reads the rows next to
# its own, and writes its own only.


class ShareSweep:
    """The corrections of one thread, with the memory for the metric of its cells."""

    def __init__(
        self,
        metric: ReferenceMetric,
        rows: Rows,
        share: Share,
        summed: int,
        along_q: SingleArray | None = None,
    ) -> None:
        """The xi-edges from rows of the grid below ``summed`` belong to the xi-lines.

        ``along_q`` of shape ``(2, n_xi, n_eta)`` is working memory where the eta-lines are closed.
        """
        self._along_q = along_q
        self._metric, self._last = metric, rows.shape[0] - 1 - rows.begin
        self._first = 1 - rows.begin
        self._strips = [(k, Strip(*rows.node_strips[k], summed - rows.begin)) for k in share.strips]
        # As many rows for every thread: the machine code of a kernel, and so its rounding, depends on the layout.
        most = max((last - first for first, last in strips_of(rows.shape)), default=0)
        self._cells = cell_memory(most + 1, rows.shape[1])

    def along_eta(
        self, nodes: Nodes, u: Array | None, along: tuple[Array, Array], lines: Lines, out: Moved, sums: LineSums
    ) -> float:
        """The first phase: correct the eta-lines, and sum the xi-edges of every strip.

        ``along`` holds the moves of the nodes on the sides: along eta (left, right), and along xi (bottom, top) in the
        rows that are here. ``u`` is given at all nodes where it is known. Returns the largest relative deviation along
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
                found = closed_lines.closed_eta_corrections(nodes, cells, strip, out, self._along_q, sums.strips[k])
            else:
                found = kernels.eta_corrections(nodes, cells, strip, along_xi, lines, out, sums.strips[k])
            if sums.closings is not None:
                closed_lines.closing_sums(strip, sums.edges, out, sums.closings[k])
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
                closed_lines.closed_xi_corrections(*data, self._along_q, largest)
        deviation, move = (max(map(finite_or_infinite, column), default=0.0) for column in found.T.tolist())
        return deviation, move


# On at most this many nodes u and its gradient are evaluated at all nodes at once, not separately on the sides.
MAX_NODES_AT_ONCE = 1_024
# The moves of a sweep that would fold the mesh are halved, but not below this share.
USUAL_MOVE_SHARE = 1 / 64


def halve_moves(moved: Array, old: Array) -> None:
    """Halve the moves from ``old`` to ``moved``, in place."""
    moved -= old
    moved *= 0.5
    moved += old


def take_midpoints(moved: Array, old: Array) -> None:
    """Halve the moves as :func:`halve_moves`, with other rounding: meshes of subdomains depend on the last bit."""
    moved += old
    moved *= 0.5


@dataclass(frozen=True)
class Correction:
    """The numbers of one sweep in the own rows, infinite where something is not a number.

    ``deviation`` is the largest relative deviation of a squared metric length from the mean of its line before the
    sweep, ``move`` the largest move of a coordinate.
    """

    deviation: float
    move: float


@dataclass(frozen=True)
class GuardedCorrection:
    """The numbers of one correction after its moves were shortened to avoid folds, over all rows of the grid.

    ``share`` of the moves remains. ``smallest`` is the smallest Jacobian afterwards, 0 if halving did not help.
    ``deviation`` and ``move`` are those of the :class:`Correction`. ``gap`` is the distance that :meth:`Sweep.guard`
    was asked to measure, NaN if none.
    """

    share: float
    smallest: float
    deviation: float
    move: float
    gap: float


class Sweep:
    """Sweeps of line corrections on the whole grid or a window of it, with their working memory.

    ``new_x`` and ``new_y`` are the moved nodes after :meth:`correct`. All arrays have the ``rows`` that are here; their
    shares are corrected at the same time, each on its own thread. Results do not depend on the number of shares.
    """

    def __init__(
        self, metric: ReferenceMetric, boundary: Boundary, rows: Rows, memory: Array, frame: Frame = WHOLE
    ) -> None:
        """``memory`` is a flat array of at least ``memory_needed(rows.here_shape)`` numbers.

        A window with a ``frame`` of its own is a whole grid for :attr:`rows`.
        """
        shape, here = rows.shape, rows.here_shape
        self.metric, self.boundary, self.frame, self.rows = metric, boundary, frame, rows
        arrays = memory[: memory_needed(here)].reshape(4, *here)
        self.new_x, self.new_y, self._squares = arrays[0], arrays[1], arrays[2]
        self._along_p = arrays[3].reshape(-1).view(np.float32).reshape(2, *here)  # single precision is enough
        summed = frame.span(0, shape[0])[1]
        along_q = np.empty((2, *here), dtype=np.float32) if frame.closed[1] else None
        self._sweeps = {share: ShareSweep(metric, rows, share, summed, along_q) for share in rows.shares}
        self._sums = self._line_sums(summed)
        none = np.zeros((2, shape[1])), np.zeros((2, here[0]))
        self._lines = [Lines(*frame.span(k, shape[k]), none[k], frame.beyond[k], none[k]) for k in (0, 1)]
        self._sides = Sides(metric, boundary, shape, frame)

    def _line_sums(self, summed: int) -> LineSums:
        """The sums along the xi-lines."""
        return LineSums(self.rows, summed, closed=self.frame.closed[0])

    def correct(self, x: Array, y: Array, rest: Pair | None = None, push: Pair | None = None) -> Correction:
        """Compute a full correction of the nodes ``x``, ``y``; the result is in ``new_x`` and ``new_y``.

        ``rest`` holds the sums of the squared metric lengths of the edges beyond the yielding sides, of shape
        ``(2, n_eta)`` at the two ends of the xi-lines and ``(2, n_xi)`` at those of the eta-lines. ``push``, of the
        same shapes, is what the ends of the lines outside a window add to ``-2 P`` and ``-2 Q``, because they move.
        """
        lines = self._lines
        if rest is not None:
            lines = [k._replace(rest=sums) for k, sums in zip(lines, rest, strict=True)]
        if push is not None:
            lines = [k._replace(push=moves) for k, moves in zip(lines, push, strict=True)]
        sweeps, sums, rows = self._sweeps, self._sums, self.rows
        with np.errstate(all="ignore"):
            at_once = rows.are_all and x.size <= MAX_NODES_AT_ONCE
            nodal = self.metric.u_with_gradient(x, y) if at_once else None
            sides, side_move, *along = self._sides.moves(self._sides_before(x, y), nodal, rest)
            u, pair = None if nodal is None else nodal[0], (along[0], np.ascontiguousarray(along[1][:, rows.here]))
            nodes, out = Nodes(x, y), Moved(self.new_x, self.new_y, self._along_p, self._squares)
            eta = rows.each(lambda share: sweeps[share].along_eta(nodes, u, pair, lines[1], out, sums))
            if push is not None:
                sums.pushes[:] += push[0]
            ends = sums.solve(lines[0])
            xi = rows.each(lambda share: sweeps[share].along_xi(nodes, out, sums))
            along_sides, lag = self._sides.place((x, y), (along[0], along[1]), (self.new_x, self.new_y), rows)
            self._copy_ends()
            self._follow(along[0], along[1])
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
        return SideNodes.of(x, y)

    def _follow(self, along_eta: Array, along_xi: Array) -> None:
        """Let what is known of other rows follow the moved nodes, and the sides these moves: nothing of all rows."""

    @property
    def smallest_jacobian(self) -> float:
        """The smallest corner Jacobian of the moved nodes, not scaled by the spacing; NaN where one is not finite."""
        return smallest_of_rows(self.new_x, self.new_y, self.rows)

    def guard(
        self,
        x: Array,
        y: Array,
        found: Correction,
        *,
        halve: bool = False,
        floor: float = 0.0,
        min_share: float = USUAL_MOVE_SHARE,
        shorten: Callable[[Array, Array], None] = halve_moves,
        measure: Callable[[Array, Array], float] | None = None,
    ) -> GuardedCorrection:
        """Halve the moves of the last :meth:`correct` until the smallest Jacobian is above ``floor``.

        ``x`` and ``y`` are the nodes before the sweep, ``found`` its numbers. ``halve`` halves at least once. Moves are
        not reduced below ``min_share``. ``shorten`` halves the moves of one coordinate. ``measure`` gives another
        number of the moved nodes, of which the largest counts.
        """
        share, needed = 1.0, halve
        while True:
            if needed:
                self._shorten(x, y, shorten)
                share *= 0.5
            gap = math.nan if measure is None else measure(self.new_x, self.new_y)
            smallest = smallest_here(self.new_x, self.new_y, self.rows)
            deviation, move, negative, gap = self.rows.agreed(found.deviation, found.move, -smallest, gap)
            if -negative > floor:
                return GuardedCorrection(share, -negative, deviation, move, gap)
            if 0.5 * share < min_share:
                return GuardedCorrection(share, 0.0, deviation, move, gap)
            needed = True

    def _shorten(self, x: Array, y: Array, shorten: Callable[[Array, Array], None]) -> None:
        shorten(self.new_x, x)
        shorten(self.new_y, y)

    def swap(self, x: Array, y: Array) -> tuple[Array, Array]:
        """The moved nodes; ``x`` and ``y`` are the memory for the next ones."""
        moved = self.new_x, self.new_y
        self.new_x, self.new_y = x, y
        return moved


def memory_needed(shape: tuple[int, int]) -> int:
    """The size of the working memory of a :class:`Sweep`, in numbers."""
    return 4 * shape[0] * shape[1]
