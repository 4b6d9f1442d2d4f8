"""Corrections of all grid lines of a mesh as a whole, which pass information across all interfaces at once."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from equimesh.equations.newton_solve import smallest_move
from equimesh.equations.problem import Problem
from equimesh.meshes.folding import smallest_jacobian
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.parts import Parts
from equimesh.numerics.threads import run_on_threads
from equimesh.numerics.types import Array, IntArray, Pair
from equimesh.schwarz.decomposition import AXES, ENDS, Decomposition, SubdomainWindow
from equimesh.schwarz.holding.on_channel import OnChannel
from equimesh.schwarz.holding.port import Holding
from equimesh.sweeps import kernels
from equimesh.sweeps.line_sums import cell_metrics
from equimesh.sweeps.sides import WHOLE, Frame, SideNodes, Sides
from equimesh.sweeps.sweep import Correction, Sweep, error_left, memory_needed

# Sums of squared metric lengths along the pieces of the lines of a mesh, between some of its cross lines.

# Rows that are summed at a time.
MAX_ROWS = 64


class Segments:
    """Sums of the squared metric lengths of edges for every line of a mesh, between neighbouring ``cuts``.

    ``cuts`` are nodes of the mesh along xi and along eta, in ascending order, at most ``MAX_ROWS`` rows apart along xi.
    ``along`` are the sums, of shape ``(pieces, n_eta)`` along xi and ``(pieces, n_xi)`` along eta. ``edges`` are the
    squared metric lengths of the edges of the four sides, of shape ``(2, n_eta - 1)`` left and right and
    ``(2, n_xi - 1)`` bottom and top; zero on sides that are not physical in ``frame``. The first and the last line of a
    direction have sums where they are physical sides.
    """

    def __init__(
        self,
        problem: Problem,
        shape: tuple[int, int],
        cuts: tuple[IntArray, IntArray],
        threads: int = 1,
        frame: Frame = WHOLE,
    ) -> None:
        self._problem, self._threads, self._cuts = problem, threads, cuts
        self.along = tuple(np.zeros((len(points) - 1, n)) for points, n in zip(cuts, shape[::-1], strict=True))
        self._cells = np.empty((threads, 3, MAX_ROWS + 1, shape[1] - 1))
        self._sides = Sides(problem.metric, problem.boundary, shape, frame)
        self.edges = self._sides.fluxes

    def read(self, mesh: Mesh) -> None:
        """Compute the sums of a mesh."""
        run_on_threads(self._threads, lambda worker: self._interior(worker, mesh))
        self._sides.moves(SideNodes.of(mesh.x, mesh.y))
        along_xi, along_eta = self.along
        for side in (0, -1):
            along_xi[:, side] = _pieces(self.edges[1][side], self._cuts[0])
            along_eta[:, side] = _pieces(self.edges[0][side], self._cuts[1])

    def _interior(self, worker: int, mesh: Mesh) -> None:
        cuts, (along_xi, along_eta) = self._cuts[0], self.along
        x, y = mesh.x, mesh.y
        for k in range(worker, len(cuts) - 1, self._threads):
            begin, last = int(cuts[k]), int(cuts[k + 1])
            first = max(begin, 1)
            cells = self._cells[worker, :, : last - first + 1]
            rows = slice(first - 1, last + 1)
            cell_metrics(self._problem.metric, x[rows], y[rows], cells)
            kernels.segment_sums(kernels.Nodes(x, y), cells, (begin, last), self._cuts[1], along_xi[k], along_eta)


def _pieces(lengths: Array, cuts: IntArray) -> Array:
    return np.asarray(np.add.reduceat(lengths[: cuts[-1]], cuts[:-1]))


# The sums of squared metric lengths along grid lines that subdomains read: of the edges beyond their interfaces.


class LineSums(Protocol):
    """The sums of a merged mesh. Along a line the edges are added in the order of their distance, the farthest first.

    So the sum beyond an interface can be passed on to the next subdomain, which adds its own edges.
    """

    points: tuple[int, int]
    """The shape of the grid."""

    def read(self, mesh: Mesh) -> None:
        """Compute the sums of a merged mesh."""
        ...

    def beyond(self, window: SubdomainWindow, axis: int, end: int) -> Array:
        """The sums beyond one interface of a subdomain, for every line of its window along ``axis``."""
        ...

    def side_edges(self, window: SubdomainWindow, axis: int, end: int, along: int) -> Array:
        """The squared lengths of the two edges next to one interface, on the side at the end ``along`` of its line."""
        ...


def line_sums(
    problem: Problem, holding: Holding, windows: Sequence[SubdomainWindow], threads: int, *, local: bool = False
) -> LineSums:
    """The sums for subdomains of these windows; with ``local`` those of the sides only, where they are held apart."""
    if holding.is_whole:
        return WholeLineSums(problem, interfaces(holding.decomposition), threads)
    return HeldLineSums(problem, holding, windows, local=local)


def interfaces(decomposition: Decomposition) -> tuple[set[int], set[int]]:
    """The grid lines on which subdomains end, across xi and across eta."""
    xi, eta = ({end for span in decomposition.spans[axis] for end in (span.first, span.last)} for axis in AXES)
    return xi, eta


class WholeLineSums:
    """The sums of a mesh of the whole grid, on both sides of the grid lines ``at``, across xi and across eta."""

    def __init__(self, problem: Problem, at: tuple[set[int], set[int]], threads: int = 1) -> None:
        self.points = shape = problem.grid.shape
        self._cuts = _cuts(at, (0, 0), (shape[0] - 1, shape[1] - 1))
        self._segments = Segments(problem, shape, self._cuts, threads)
        self.edges = self._segments.edges

    def read(self, mesh: Mesh) -> None:
        """Compute the sums of a mesh."""
        self._segments.read(mesh)

    def beyond(self, window: SubdomainWindow, axis: int, end: int) -> Array:
        """The sums beyond one interface of a window."""
        span = window.part.spans[axis]
        return self.beyond_point(axis, end, span.last if end else span.first)[window.slices[1 - axis]]

    def beyond_point(self, axis: int, end: int, point: int) -> Array:
        """The sums on one side of a grid line, for every line along ``axis``."""
        k = int(np.searchsorted(self._cuts[axis], point))
        pieces = self._segments.along[axis]
        return _added(np.zeros(pieces.shape[1]), pieces[k:][::-1] if end else pieces[:k])

    def side_edges(self, window: SubdomainWindow, axis: int, end: int, along: int) -> Array:
        """The squared lengths of the two edges next to one interface, on a side."""
        span = window.part.spans[axis]
        point = span.last if end else span.first
        return self.edges[1 - axis][along, point - 1 : point + 1]


class HeldLineSums:
    """The sums of a merged mesh in the windows that are held here; neighbours pass on the sums beyond them.

    ``windows`` reach one grid line beyond every interface.
    """

    def __init__(
        self, problem: Problem, holding: Holding, windows: Sequence[SubdomainWindow], *, local: bool = False
    ) -> None:
        self.points, self._holding, self._local = problem.grid.shape, holding, local
        self._windows, at = windows, interfaces(holding.decomposition)
        self._cuts, self._segments = dict[int, tuple[IntArray, IntArray]](), dict[int, Segments]()
        for k in holding.numbers:
            window, (xi, eta) = windows[k], windows[k].part.spans
            self._cuts[k] = cuts = _cuts(at, (xi.first, eta.first), (xi.last, eta.last))
            # One row more, so that the last row of the subdomain is among those of the eta-lines.
            rows = np.append(cuts[0], xi.last + 1) if window.open[0, 1] else cuts[0]
            places = rows - window.first[0], cuts[1] - window.first[1]
            self._segments[k] = Segments(problem, window.shape, places, frame=Frame(physical=window.physical))
        self._beyond: dict[tuple[int, int], dict[int, Array]] = {}

    def read(self, mesh: Mesh) -> None:
        """Compute the sums of a merged mesh."""
        for k, here in self._segments.items():
            here.read(self._holding.restrict(self._windows[k], mesh))
        for axis in AXES:
            for end in ENDS:
                self._beyond[axis, end] = self._sums(axis, end)

    def beyond(self, window: SubdomainWindow, axis: int, end: int) -> Array:
        """The sums beyond one interface of a window."""
        return self._beyond[axis, end][window.part.number]

    def side_edges(self, window: SubdomainWindow, axis: int, end: int, along: int) -> Array:
        """The squared lengths of the two edges next to one interface, on a side."""
        span = window.part.spans[axis]
        local = (span.last if end else span.first) - window.first[axis]
        return self._segments[window.part.number].edges[1 - axis][along, local - 1 : local + 1]

    def _sums(self, axis: int, end: int) -> dict[int, Array]:
        def nothing(k: int) -> Array:
            return np.zeros(self._windows[k].shape[1 - axis])

        def passed(k: int, received: Array) -> Array:
            """With the edges up to the interface of the next subdomain."""
            cuts, pieces = self._cuts[k][axis], self._segments[k].along[axis]
            column, row = self._windows[k].part.place
            step = -1 if end else 1
            after = self._holding.decomposition.at(column + step * (axis == 0), row + step * (axis == 1)).spans[axis]
            edge = int(np.searchsorted(cuts, after.last if end else after.first))
            return _added(received, pieces[edge : len(cuts) - 1][::-1] if end else pieces[:edge])

        if self._local:
            return {k: nothing(k) for k in self._holding.numbers}
        return self._holding.along_lines(axis, end, nothing, passed, "sums")


def _cuts(at: tuple[set[int], set[int]], first: tuple[int, int], last: tuple[int, int]) -> tuple[IntArray, IntArray]:
    """The grid lines between which edges are summed, from ``first`` to ``last``."""
    strips = set(range(0, last[0], MAX_ROWS))
    xi, eta = (
        np.array(sorted({low, *(point for point in points if low < point < high), high}))
        for points, low, high in zip((at[0] | strips, at[1]), first, last, strict=True)
    )
    return xi, eta


def _added(start: Array, pieces: Array) -> Array:
    """The pieces added one after the other, in their order."""
    total = start.copy()
    for piece in pieces:
        total += piece
    return total


# Line corrections of a merged mesh whose windows several processes hold.
#
# Every subdomain corrects its part of all grid lines. From its neighbours it gets the sums of the metric lengths
# beyond, how far the moving sides of the grid push the ends of each line, and afterwards the nodes beyond its
# interfaces.


class HeldSweep:
    """Corrections of all grid lines, as :class:`~equimesh.sweeps.sweep.Sweep`, in the windows that are held here."""

    def __init__(self, problem: Problem, holding: OnChannel) -> None:
        self._problem, self._holding = problem, holding
        self._sums = HeldLineSums(problem, holding, holding.patches)
        windows = {k: holding.patches[k] for k in holding.numbers}
        # The windows are corrected one after the other, in the same memory.
        memory = np.empty(max(memory_needed(window.shape) for window in windows.values()))
        points = problem.grid.shape
        self._sweeps, self._sides = dict[int, Sweep](), dict[int, Sides]()
        for k, window in windows.items():
            frame = window.frame(points)
            self._sweeps[k] = Sweep(problem.metric, problem.boundary, Parts.of(window.shape), memory, frame)
            self._sides[k] = Sides(problem.metric, problem.boundary, window.shape, frame)
        self._moved = Mesh(np.empty((1, holding.size)), np.empty((1, holding.size)))
        self.smallest_jacobian = np.nan
        """The smallest corner Jacobian of the moved nodes, not scaled by the spacing; NaN where one is not finite."""

    def correct(self, x: Array, y: Array) -> Correction:
        """One correction of a merged mesh."""
        mesh, holding = Mesh(x, y), self._holding
        self._sums.read(mesh)
        rests = {k: self._rest(k) for k in holding.numbers}
        pushes = self._pushes(mesh, rests)
        found = {}
        for k, sweep in self._sweeps.items():
            view, moved = holding.view(mesh, k), holding.view(self._moved, k)
            correction = sweep.correct(view.x, view.y, rests[k], pushes[k])
            moved.x[:], moved.y[:] = sweep.new_x, sweep.new_y
            window = holding.patches[k]
            here = window.local(window.covered)
            smallest = smallest_jacobian(moved.x[here].copy(), moved.y[here].copy())
            found[k] = [correction.deviation, correction.move, -float(smallest)]
        holding.fill_ghosts(self._moved, "corrections")
        deviation, move, smallest = np.max(holding.every(found), axis=0).tolist()
        self.smallest_jacobian = -smallest
        return Correction(deviation, move)

    def swap(self, x: Array, y: Array) -> Pair:
        """The moved nodes; ``x`` and ``y`` are the memory for the next ones."""
        moved, self._moved = self._moved, Mesh(x, y)
        return moved.x, moved.y

    def _rest(self, k: int) -> Pair:
        """The sums beyond a window at both ends of its xi-lines and of its eta-lines."""
        window = self._holding.patches[k]
        found = np.zeros((2, window.shape[1])), np.zeros((2, window.shape[0]))
        for (axis, end), is_open in window.open.items():
            if is_open:
                found[axis][end] = self._sums.beyond(window, axis, end)
        return found

    def _pushes(self, mesh: Mesh, rests: dict[int, Pair]) -> dict[int, Pair]:
        """What the sides of the grid add to both ends of the lines of every window that ends at an interface."""
        holding = self._holding
        found, moves = dict[int, Pair](), dict[int, Pair]()
        for k in holding.numbers:
            view, shape = holding.view(mesh, k), holding.patches[k].shape
            *_, along_eta, along_xi = self._sides[k].moves(SideNodes.of(view.x, view.y), rest=rests[k])
            moves[k] = along_eta.copy(), along_xi.copy()
            found[k] = np.zeros((2, shape[1])), np.zeros((2, shape[0]))
        for axis in AXES:
            for end in ENDS:

                def first(k: int, axis: int = axis, end: int = end) -> Array:
                    return self._push(holding.view(mesh, k), moves[k][axis][end], axis, end)

                passed = holding.along_lines(axis, end, first, lambda _, received: received, "pushes")
                for k, push in passed.items():
                    if holding.patches[k].open[axis, end]:
                        found[k][axis][end] = push
        return found

    def _push(self, mesh: Mesh, moves: Array, axis: int, end: int) -> Array:
        """``-2 P`` at a side of the grid, or ``-2 Q``, for the lines that end there; its nodes move by ``moves``."""
        place = slice(-2, None) if end else slice(0, 2)
        x, y = (np.ascontiguousarray(q[place] if axis == 0 else q[:, place]) for q in (mesh.x, mesh.y))
        cells = np.empty((3, x.shape[0] - 1, x.shape[1] - 1))
        cell_metrics(self._problem.metric, x, y, cells)
        cells = cells.reshape(3, -1)
        m11, m12, m22 = 0.5 * (cells[:, 1:] + cells[:, :-1])
        gx, gy = (np.diff(q, axis=axis).ravel()[1:-1] for q in (x, y))
        along = m12 * gx + m22 * gy if axis == 0 else m11 * gx + m12 * gy
        push = np.zeros(moves.size)
        push[1:-1] = -2.0 * along * moves[1:-1]
        return push


# Later corrections are not assumed to reduce the moves by a smaller factor: slow errors show late.
MIN_CONTRACTION = 0.5


@dataclass(frozen=True)
class CorrectionResult:
    """A mesh after ``count`` line corrections; ``tried`` also counts one that was not taken.

    ``deviation`` is that before the last correction, ``estimate`` the remaining error by the contraction of the moves.
    Both are NaN where not known.
    """

    mesh: Mesh
    deviation: float = math.nan
    estimate: float = math.nan
    count: int = 0
    tried: int = 0


class LineSweep(Protocol):
    """Corrections of all lines of a mesh, as :class:`~equimesh.sweeps.sweep.Sweep` has them."""

    def correct(self, x: Array, y: Array) -> Correction:
        """One correction of the nodes ``x``, ``y``."""
        ...

    @property
    def smallest_jacobian(self) -> float:
        """The smallest corner Jacobian of the moved nodes."""
        ...

    def swap(self, x: Array, y: Array) -> tuple[Array, Array]:
        """The moved nodes; ``x`` and ``y`` are the memory for the next ones."""
        ...


class LineCorrections:
    """De Boor's correction of all lines of both families at once: full sweeps on the whole grid."""

    def __init__(self, problem: Problem, threads: int, holding: Holding | OnChannel | None = None) -> None:
        """On the whole grid, or where ``holding`` has the subdomains held by several processes in their windows."""
        shape = problem.grid.shape
        self._sweep: LineSweep
        if isinstance(holding, OnChannel):
            self._sweep = HeldSweep(problem, holding)
        else:
            parts, memory = Parts.of(shape, threads), np.empty(memory_needed(shape))
            self._sweep = Sweep(problem.metric, problem.boundary, parts, memory)
        self._floor = smallest_move(shape)

    def apply(self, mesh: Mesh, count: int, enough: float = 0.0) -> CorrectionResult:
        """``count`` corrections of a valid mesh; fewer where one would fold it, or the error is at most ``enough``.

        ``mesh`` is overwritten.
        """
        x, y, done, tried, moves = mesh.x, mesh.y, 0, 0, []
        deviation = math.nan
        for _ in range(count):
            tried += 1
            found = self._sweep.correct(x, y)
            if not (math.isfinite(found.move) and self._sweep.smallest_jacobian > 0.0):
                break
            x, y = self._sweep.swap(x, y)
            done, deviation = done + 1, found.deviation
            moves.append(found.move)
            if self._left(moves) <= enough:
                break
        return CorrectionResult(Mesh(x, y), deviation, self._left(moves), done, tried)

    def _left(self, moves: list[float]) -> float:
        if moves and moves[-1] <= self._floor:
            return moves[-1]
        if not moves:
            return math.nan
        contraction = max([MIN_CONTRACTION, *(after / before for before, after in itertools.pairwise(moves))])
        return error_left(moves[-1], contraction)
