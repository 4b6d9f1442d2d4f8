"""Corrections of all grid lines of a mesh as a whole, which pass information across all interfaces at once."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from equimesh.equations.newton_solve import smallest_move
from equimesh.equations.problem import Problem
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.rows import Rows
from equimesh.numerics.threads import run_on_threads
from equimesh.numerics.types import Array, IntArray
from equimesh.schwarz.decomposition import AXES, Decomposition, SubdomainWindow
from equimesh.sweeps import kernels
from equimesh.sweeps.line_sums import cell_metrics
from equimesh.sweeps.sweep import WHOLE, Correction, Frame, SideNodes, Sides, Sweep, memory_needed
from equimesh.sweeps.verdict import error_left

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


def interfaces(decomposition: Decomposition) -> tuple[set[int], set[int]]:
    """The grid lines on which subdomains end, across xi and across eta."""
    xi, eta = ({end for span in decomposition.spans[axis] for end in (span.first, span.last)} for axis in AXES)
    return xi, eta


class WholeLineSums:
    """The sums of a mesh of the whole grid, on both sides of the grid lines ``at``, across xi and across eta."""

    def __init__(self, problem: Problem, at: tuple[set[int], set[int]], threads: int = 1) -> None:
        self.points = shape = problem.grid.shape
        self._cuts = line_cuts(at, (0, 0), (shape[0] - 1, shape[1] - 1))
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
        return added(np.zeros(pieces.shape[1]), pieces[k:][::-1] if end else pieces[:k])

    def side_edges(self, window: SubdomainWindow, axis: int, end: int, along: int) -> Array:
        """The squared lengths of the two edges next to one interface, on a side."""
        span = window.part.spans[axis]
        point = span.last if end else span.first
        return self.edges[1 - axis][along, point - 1 : point + 1]


def line_cuts(
    at: tuple[set[int], set[int]], first: tuple[int, int], last: tuple[int, int]
) -> tuple[IntArray, IntArray]:
    """The grid lines between which edges are summed, from ``first`` to ``last``."""
    strips = set(range(0, last[0], MAX_ROWS))
    xi, eta = (
        np.array(sorted({low, *(point for point in points if low < point < high), high}))
        for points, low, high in zip((at[0] | strips, at[1]), first, last, strict=True)
    )
    return xi, eta


def added(start: Array, pieces: Array) -> Array:
    """The pieces added one after the other, in their order."""
    total = start.copy()
    for piece in pieces:
        total += piece
    return total


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

    def __init__(self, problem: Problem, threads: int, sweep: LineSweep | None = None) -> None:
        """On the whole grid, unless the ``sweep`` of another merged mesh is given."""
        shape = problem.grid.shape
        if sweep is None:
            rows, memory = Rows.whole(shape, threads), np.empty(memory_needed(shape))
            sweep = Sweep(problem.metric, problem.boundary, rows, memory)
        self._sweep = sweep
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
