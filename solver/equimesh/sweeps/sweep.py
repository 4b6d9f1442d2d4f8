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

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from equimesh.equations.boundary import Boundary
from equimesh.equations.metric import ReferenceMetric
from equimesh.meshes.folding import smallest_jacobian
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.threads import run_on_threads
from equimesh.numerics.types import Array
from equimesh.sweeps import kernels
from equimesh.sweeps.frame import WHOLE, Frame
from equimesh.sweeps.kernels import Levels, Lines, Moved, Nodes, Strip
from equimesh.sweeps.sides import Sides, finite_or_infinite

# Nodes of a strip of rows: its intermediate arrays stay in the cache.
STRIP_NODES = 32_768
# Rows of a strip, at least: each strip also reads one row beyond either end.
MIN_STRIP_ROWS = 16
# Fewer nodes are not worth a second thread.
MIN_THREADED_NODES = 16_384
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
    """The numbers of one sweep, infinite where something is not a number.

    ``deviation`` is the largest relative deviation of a squared metric length from the mean of its line before the
    sweep, ``move`` the largest move of a coordinate.
    """

    deviation: float
    move: float


class Sweep:
    """Sweeps of line corrections on the whole grid or a window of it, with their working memory.

    ``new_x`` and ``new_y`` hold the moved nodes after :meth:`correct`. The ``threads`` share the rows; results do not
    depend on their number.
    """

    def __init__(
        self,
        metric: ReferenceMetric,
        boundary: Boundary,
        shape: tuple[int, int],
        memory: Array,
        threads: int = 1,
        frame: Frame = WHOLE,
    ) -> None:
        """``memory`` is a flat array of at least ``memory_needed(shape)`` numbers."""
        self.metric, self.boundary, self.shape, self.frame = metric, boundary, shape, frame
        arrays = memory[: memory_needed(shape)].reshape(4, *shape)
        self.new_x, self.new_y, self._squares = arrays[0], arrays[1], arrays[2]
        self._along_p = arrays[3].reshape(-1).view(np.float32).reshape(2, *shape)  # single precision is enough
        n_xi, n_eta = shape
        rows = max(MIN_STRIP_ROWS, -(-STRIP_NODES // n_eta))
        summed = frame.span(0, n_xi)[1]
        self._strips = [Strip(first, min(first + rows, n_xi - 1), summed) for first in range(1, n_xi - 1, rows)]
        self._rows = np.array([min(strip.last, summed) - strip.first for strip in self._strips])
        self._threads = min(threads, len(self._strips)) if n_xi * n_eta >= MIN_THREADED_NODES else 1
        self._cells = np.empty((self._threads, 3, min(rows, n_xi - 2) + 1, n_eta - 1))
        self._lines = [Lines(*frame.span(k, shape[k]), np.zeros((2, shape[1 - k])), frame.beyond[k]) for k in (0, 1)]
        self._sums, self._starts = np.empty((len(self._strips), n_eta)), np.empty((len(self._strips), n_eta))
        self._pushes, self._levels = np.zeros((2, n_eta)), Levels(np.ones(n_eta), np.zeros(n_eta))
        self._found = np.zeros((len(self._strips), 3))
        self._sides = Sides(metric, boundary, shape, frame)

    def correct(self, x: Array, y: Array, rest: tuple[Array, Array] | None = None) -> Correction:
        """One full correction of the nodes ``x``, ``y``; the result is in ``new_x`` and ``new_y``.

        ``rest`` holds the sums of the squared metric lengths of the edges beyond the yielding sides, of shape
        ``(2, n_eta)`` at the two ends of the xi-lines and ``(2, n_xi)`` at those of the eta-lines.
        """
        lines = (
            self._lines if rest is None else [k._replace(rest=sums) for k, sums in zip(self._lines, rest, strict=True)]
        )
        with np.errstate(all="ignore"):
            nodal = self.metric.u_with_gradient(x, y) if x.size <= MAX_NODES_AT_ONCE else None
            sides, side_move, along_eta, along_xi = self._sides.moves(x, y, nodal, rest)
            u, along = None if nodal is None else nodal[0], (along_eta, along_xi)
            nodes, out = Nodes(x, y), Moved(self.new_x, self.new_y, self._along_p, self._squares)
            run_on_threads(self._threads, lambda k: self._correct_along_eta(k, nodes, u, along, lines[1], out))
            ends = kernels.line_sums(
                self._squares[0],
                self._sums,
                self._rows,
                self._pushes,
                lines[0],
                self._levels,
                self._starts,
            )
            run_on_threads(self._threads, lambda k: self._correct_along_xi(k, nodes, out))
            along_sides, lag = self._sides.place(x, y, along_eta, along_xi, self.new_x, self.new_y)
        eta, xi, move = self._found.max(axis=0).tolist()
        return Correction(
            finite_or_infinite(max(sides, ends, eta, xi, lag)), finite_or_infinite(max(side_move, move, along_sides))
        )

    @property
    def smallest_jacobian(self) -> float:
        """The smallest corner Jacobian of the moved nodes, not scaled by the spacing; NaN where one is not finite."""
        return smallest_jacobian(self.new_x, self.new_y)

    def guard(
        self,
        x: Array,
        y: Array,
        *,
        halve: bool = False,
        floor: float = 0.0,
        min_share: float = MIN_MOVE_SHARE,
        shorten: Callable[[Array, Array], None] = halve_moves,
    ) -> tuple[float, float]:
        """Halve the moves of the last :meth:`correct` until the smallest Jacobian is above ``floor``.

        ``x`` and ``y`` are the nodes before the sweep. ``halve`` halves at least once. Moves are not
        reduced below ``min_share``. ``shorten`` halves the moves of one coordinate. Returns the remaining share and the
        smallest Jacobian, 0 if halving did not help.
        """
        share, needed = 1.0, halve
        while True:
            if needed:
                shorten(self.new_x, x)
                shorten(self.new_y, y)
                share *= 0.5
            smallest = self.smallest_jacobian
            if smallest > floor:
                return share, smallest
            if 0.5 * share < min_share:
                return share, 0.0
            needed = True

    def swap(self, x: Array, y: Array) -> tuple[Array, Array]:
        """The moved nodes; ``x`` and ``y`` are the memory for the next ones."""
        moved = self.new_x, self.new_y
        self.new_x, self.new_y = x, y
        return moved

    def _correct_along_eta(
        self, worker: int, nodes: Nodes, u: Array | None, along: tuple[Array, Array], lines: Lines, out: Moved
    ) -> None:
        (x, y), (along_eta, along_xi) = nodes, along
        for k in range(worker, len(self._strips), self._threads):
            strip = self._strips[k]
            cells = self._cells[worker, :, : strip.last - strip.first + 1]
            rows = slice(strip.first - 1, strip.last + 1)
            cell_metrics(self.metric, x[rows], y[rows], cells, None if u is None else u[rows])
            if strip.first == 1:
                kernels.end_edges(x, y, cells, 0, along_eta[0], self._pushes[0], self._squares[0])
            if strip.last == self.shape[0] - 1:
                kernels.end_edges(x, y, cells, -1, along_eta[1], self._pushes[1], self._squares[0])
            self._found[k, 0] = finite_or_infinite(
                kernels.eta_corrections(nodes, cells, strip, along_xi, lines, out, self._sums[k])
            )

    def _correct_along_xi(self, worker: int, nodes: Nodes, out: Moved) -> None:
        for k in range(worker, len(self._strips), self._threads):
            kernels.xi_corrections(nodes, self._strips[k], self._levels, self._starts[k], out, self._found[k, 1:])


def deviation(metric: ReferenceMetric, boundary: Boundary, mesh: Mesh) -> float:
    """The largest relative difference of a squared metric length of a mesh from the mean of its grid line."""
    sweep = Sweep(metric, boundary, mesh.grid.shape, np.empty(memory_needed(mesh.grid.shape)))
    return sweep.correct(mesh.x, mesh.y).deviation


def memory_needed(shape: tuple[int, int]) -> int:
    """The size of the working memory of a :class:`Sweep`, in numbers."""
    return 4 * shape[0] * shape[1]


def cell_metrics(metric: ReferenceMetric, s: Array, t: Array, cells: Array, u: Array | None = None) -> None:
    """The metric of the cells between rows of nodes, in ``cells`` of shape ``(3, rows - 1, n_eta - 1)``.

    ``u`` is given at the nodes where it is known.
    """
    arc_length = metric.arc_length
    if arc_length is not None and metric.on_unit_square:
        u = metric.u(s, t) if u is None else u
        kernels.arc_length_cells(s, t, u, arc_length.a**2, arc_length.b, cells)
        return
    cells[0], cells[1], cells[2] = metric.base(_centres(s), _centres(t))
    if arc_length is not None:
        u = metric.u(s, t) if u is None else u
        kernels.arc_length_cells_on(s, t, u, arc_length.a**2, arc_length.b, cells)


def _centres(q: Array) -> Array:
    return np.asarray(0.25 * (q[1:, 1:] + q[1:, :-1] + q[:-1, 1:] + q[:-1, :-1]))
