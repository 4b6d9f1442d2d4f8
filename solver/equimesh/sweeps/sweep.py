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
from equimesh.meshes.folding import smallest_in_parts
from equimesh.meshes.parts import Parts
from equimesh.numerics.types import Array
from equimesh.sweeps import kernels
from equimesh.sweeps.frame import WHOLE, Frame
from equimesh.sweeps.kernels import Lines, Moved, Nodes
from equimesh.sweeps.part_sweep import LineSums, PartSweep
from equimesh.sweeps.sides import Sides, finite_or_infinite

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

    ``new_x`` and ``new_y`` hold the moved nodes after :meth:`correct`. The ``parts`` of the grid are corrected at the
    same time, each on its own thread; results do not depend on their number.
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
        self.parts = Parts.of(shape, threads)
        arrays = memory[: memory_needed(shape)].reshape(4, *shape)
        self.new_x, self.new_y, self._squares = arrays[0], arrays[1], arrays[2]
        self._along_p = arrays[3].reshape(-1).view(np.float32).reshape(2, *shape)  # single precision is enough
        summed = frame.span(0, shape[0])[1]
        self._sweeps = {part: PartSweep(metric, self.parts, part, summed) for part in self.parts.parts}
        self._sums = LineSums.of(self.parts, summed)
        none = [np.zeros((2, shape[1 - k])) for k in (0, 1)]
        self._lines = [Lines(*frame.span(k, shape[k]), none[k], frame.beyond[k], none[k]) for k in (0, 1)]
        self._sides = Sides(metric, boundary, shape, frame)

    def correct(
        self, x: Array, y: Array, rest: tuple[Array, Array] | None = None, push: tuple[Array, Array] | None = None
    ) -> Correction:
        """One full correction of the nodes ``x``, ``y``; the result is in ``new_x`` and ``new_y``.

        ``rest`` holds the sums of the squared metric lengths of the edges beyond the yielding sides, of shape
        ``(2, n_eta)`` at the two ends of the xi-lines and ``(2, n_xi)`` at those of the eta-lines. ``push``, of the
        same shapes, is what the ends of the lines outside a window add to ``-2 P`` and ``-2 Q``, because they move.
        """
        lines = self._lines
        if rest is not None:
            lines = [k._replace(rest=sums) for k, sums in zip(lines, rest, strict=True)]
        if push is not None:
            lines = [k._replace(push=moves) for k, moves in zip(lines, push, strict=True)]
        sweeps, sums = self._sweeps, self._sums
        with np.errstate(all="ignore"):
            nodal = self.metric.u_with_gradient(x, y) if x.size <= MAX_NODES_AT_ONCE else None
            sides, side_move, *along = self._sides.moves(x, y, nodal, rest)
            u, pair = None if nodal is None else nodal[0], (along[0], along[1])
            nodes, out = Nodes(x, y), Moved(self.new_x, self.new_y, self._along_p, self._squares)
            eta = self.parts.each(lambda part: sweeps[part].along_eta(nodes, u, pair, lines[1], out, sums))
            if push is not None:
                sums.pushes[:] += push[0]
            ends = kernels.line_sums(
                self._squares[0], sums.strips, sums.rows, sums.pushes, lines[0], sums.levels, sums.starts
            )
            xi = self.parts.each(lambda part: sweeps[part].along_xi(nodes, out, sums))
            along_sides, lag = self._sides.place(x, y, *pair, self.new_x, self.new_y)
        deviations, moves = zip(*xi, strict=True)
        return Correction(
            finite_or_infinite(max(sides, ends, *eta, *deviations, lag)),
            finite_or_infinite(max(side_move, *moves, along_sides)),
        )

    @property
    def smallest_jacobian(self) -> float:
        """The smallest corner Jacobian of the moved nodes, not scaled by the spacing; NaN where one is not finite."""
        return smallest_in_parts(self.new_x, self.new_y, self.parts)

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


def memory_needed(shape: tuple[int, int]) -> int:
    """The size of the working memory of a :class:`Sweep`, in numbers."""
    return 4 * shape[0] * shape[1]
