"""The four sides of a sweep: closed one-dimensional problems, solved first."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from equimesh.equations.boundary import Boundary
from equimesh.equations.metric import ReferenceMetric, Tensor
from equimesh.meshes.parts import Parts
from equimesh.numerics.channel import gather
from equimesh.numerics.types import Array, Pair
from equimesh.sweeps.kernels import Lines, SidePair, closed_side_moves, side_moves

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


# The positions of the nodes along the four sides, in full, also where many processes hold the rows of a grid.


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
    def gathered(cls, x: Array, y: Array, parts: Parts) -> SideNodes:
        """The sides of a mesh, of which every process holds some rows; each of them sends its own to all."""
        first, last = parts.own.first - parts.begin, parts.own.last - parts.begin
        left = y[0] if parts.begin == 0 else np.empty(0)
        right = y[-1] if parts.end == parts.shape[0] else np.empty(0)
        bottom, top = x[first:last, 0], x[first:last, -1]
        pieces = zip(*gather(parts.channel, "sides", [left, right, bottom, top]), strict=True)
        left, right, bottom, top = (np.concatenate(piece) for piece in pieces)
        return cls(np.stack([left, right]), np.stack([bottom, top]))

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
        for t, (u, u_n), base in zip((t_eta, t_xi), (u_eta, u_xi), self._base or self._bases(t_eta, t_xi), strict=True):
            yield SidePair(t, u, np.zeros_like(u_n) if self.boundary is Boundary.EQUIDISTRIBUTED_1D else u_n, base)

    def _evaluated(self, t_eta: Array, t_xi: Array) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        """u and its normal derivative on the left and right sides, and on the bottom and top."""
        s = np.concatenate([self._ends_xi, t_xi.ravel()])
        t = np.concatenate([t_eta.ravel(), self._ends_eta])
        u, u_s, u_t = self.metric.u_with_gradient(s, t)
        cut = t_eta.size
        left_right = (u[:cut].reshape(t_eta.shape), u_s[:cut].reshape(t_eta.shape))
        return left_right, (u[cut:].reshape(t_xi.shape), u_t[cut:].reshape(t_xi.shape))

    def place(self, old: Pair, along: Pair, new: Pair, parts: Parts) -> tuple[float, float]:
        """Write the new positions of the nodes of the sides to ``new``, in the rows that are held.

        ``old`` are the nodes before the sweep, ``along`` the moves along the sides, in full. Returns the largest move
        and deviation of the own nodes that follow the interior, zero if there are none.
        """
        (x, y), (new_x, new_y), (along_eta, along_xi) = old, new, along
        change, lag = 0.0, 0.0
        for axis, (before, q, fixed, moved) in enumerate(
            ((y, new_y, new_x, along_eta), (x.T, new_x.T, new_y.T, along_xi[:, parts.held]))
        ):
            for side, (end, one, two) in enumerate(((0, 1, 2), (-1, -2, -3))):
                if axis == 0 and not (parts.begin == 0, parts.end == self.shape[0])[side]:
                    continue
                fixed[end], q[end] = (x, y.T)[axis][end], before[end] + moved[end]
                if self.boundary is not Boundary.ORTHOGONAL or not self.frame.physical[axis][side]:
                    continue
                inner = slice(1, -1) if axis == 0 else self._between_corners(parts)
                q[end, inner] = (4 * q[one, inner] - q[two, inner]) / 3
                change = max(change, float(np.abs(q[end] - before[end]).max()))
                wanted = (4 * before[one, inner] - before[two, inner]) / 3
                edges = self.shape[1 - axis] - 1
                lag = max(lag, float(np.abs(wanted - before[end, inner]).max()) * edges)
        return change, lag

    def _between_corners(self, parts: Parts) -> slice:
        """The own rows between the first and the last one of the grid, in the arrays of this process."""
        return slice(max(parts.own.first, 1) - parts.begin, min(parts.own.last, self.shape[0] - 1) - parts.begin)

    def _unit_base(self) -> tuple[Array, Array]:
        one = np.array([1.0, 0.0, 1.0])[:, None, None]
        return one * np.ones((2, self.shape[1] - 1)), one * np.ones((2, self.shape[0] - 1))

    def _bases(self, t_eta: Array, t_xi: Array) -> tuple[Array, Array]:
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
