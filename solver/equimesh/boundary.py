"""The physical boundary of the unit square: where its nodes lie, and what places them along each side."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import TypeAlias, TypeVar

import numpy as np
import numpy.typing as npt

from equimesh.equations import Rows, Window
from equimesh.metric import STEP, ReferenceMetric, Tensor, Vector, quadratic

Array: TypeAlias = npt.NDArray[np.float64]
IntArray: TypeAlias = npt.NDArray[np.int64]
Triplets: TypeAlias = list[tuple[IntArray, IntArray, Array]]
S = TypeVar("S", bound=np.generic)


class Boundary(StrEnum):
    """What places the nodes along the four sides.

    ``TRACE``: equal metric length with the full gradient of u, the trace of the interior equations (the default).
    ``EQUIDISTRIBUTED_1D``: equal metric length of u along the side alone, the paper's choice, equation (7); folds
    steep monitors on fine meshes. ``ORTHOGONAL``: coordinate lines meet the sides at right angles, equation (6);
    on a domain, those of the reference square.
    """

    TRACE = "trace"
    EQUIDISTRIBUTED_1D = "equidistributed_1d"
    ORTHOGONAL = "orthogonal"


@dataclass(frozen=True, kw_only=True)
class Side:
    """A side of the unit square as the condition that closes a window there.

    ``axis`` is the coordinate that is fixed on the side (0: left and right, 1: bottom and top), ``end`` its fixed
    value, 0 or 1. The tangential equations stand at the nodes between the window's corners.
    """

    axis: int
    end: int
    kind: Boundary

    def rows(self, window: Window) -> Rows:
        """The fixed coordinate on all nodes of the side, and the tangential equations (paper, (5) to (7))."""
        fixed, tangential = (self.line(window.numbers[axis]) for axis in (self.axis, 1 - self.axis))
        values, triplets = self._tangential(window, tangential)
        position = self.line((window.x, window.y)[self.axis])
        return Rows(
            np.concatenate([fixed, tangential[1:-1]]),
            np.concatenate([position - self.end, values]),
            ((fixed, fixed, np.ones(fixed.size)), *triplets),
        )

    def points(self, t: Array) -> Vector:
        """The reference points at positions ``t`` along the side."""
        fixed = np.full(t.shape, float(self.end))
        return (fixed, t) if self.axis == 0 else (t, fixed)

    def line(self, values: npt.NDArray[S], depth: int = 0) -> npt.NDArray[S]:
        """Nodal values on the side's own line, or ``depth`` lines into the domain."""
        index = -1 - depth if self.end else depth
        return values[index] if self.axis == 0 else values[:, index]

    def _tangential(self, window: Window, unknown: IntArray) -> tuple[Array, Triplets]:
        if self.kind is Boundary.ORTHOGONAL:
            return self._orthogonal(window)
        return self._equidistributed(window, unknown)

    def _orthogonal(self, window: Window) -> tuple[Array, Triplets]:
        """Zero normal derivative of the tangential coordinate, one-sided and of second order."""
        spacing = (window.d_xi, window.d_eta)[self.axis]
        position, numbers = (window.x, window.y)[1 - self.axis], window.numbers[1 - self.axis]
        rows = self.line(numbers)[1:-1]
        values, triplets = np.zeros(rows.size), []
        for depth, weight in enumerate((-1.5, 2.0, -0.5)):
            values += weight / spacing * self.line(position, depth)[1:-1]
            columns = self.line(numbers, depth)[1:-1]
            triplets.append((rows, columns, np.full(rows.size, weight / spacing)))
        return values, triplets

    def _equidistributed(self, window: Window, unknown: IntArray) -> tuple[Array, Triplets]:
        spacing = (window.d_xi, window.d_eta)[1 - self.axis]
        line = SideLine.of(self, window.metric, self.line((window.x, window.y)[1 - self.axis]))
        flux, by_first, by_second = line.fluxes()
        rows, scale = unknown[1:-1], 1.0 / spacing**2
        triplets = [
            (rows, unknown[:-2], -scale * by_first[:-1]),
            (rows, unknown[1:-1], scale * (by_first[1:] - by_second[:-1])),
            (rows, unknown[2:], scale * by_second[1:]),
        ]
        return scale * np.diff(flux), triplets


@dataclass(frozen=True)
class SideLine:
    """u along one side of the reference square, at its nodes: position ``t``, value, tangential derivative.

    ``u_n`` and its tangential derivative ``u_tn`` are zero where the boundary condition does not see them.
    """

    side: Side
    metric: ReferenceMetric
    t: Array
    u: Array
    u_t: Array
    u_n: Array
    u_tn: Array

    @classmethod
    def of(cls, side: Side, metric: ReferenceMetric, t: Array) -> SideLine:
        """The side with nodes at ``t``."""
        u, *gradient = metric.u_with_gradient(*side.points(t))
        u_t, u_n = gradient[1 - side.axis], gradient[side.axis]
        if side.kind is Boundary.EQUIDISTRIBUTED_1D or metric.arc_length is None:
            zero = np.zeros(t.size)
            return cls(side, metric, t, u, u_t, zero, zero)
        ahead, behind = np.minimum(t + STEP, 1.0), np.maximum(t - STEP, 0.0)
        normal = [metric.u_with_gradient(*side.points(at))[1 + side.axis] for at in (ahead, behind)]
        return cls(side, metric, t, u, u_t, u_n, (normal[0] - normal[1]) / (ahead - behind))

    def fluxes(self) -> tuple[Array, Array, Array]:
        """The squared metric length of every edge of the side, and its derivatives by the edge's two nodes."""
        d, du, u_n = np.diff(self.t), np.diff(self.u), (self.u_n[1:] + self.u_n[:-1]) / 2
        g = du / d
        length, k, slope, raised, by_middle = self._at_middles((g, u_n))
        derivatives = []
        for sign, node in ((-1.0, slice(0, -1)), (1.0, slice(1, None))):
            by_du = sign * self.u_t[node]
            by_square = 2 * raised[0] * (by_du - sign * g) / d + raised[1] * self.u_tn[node]
            by_node = 2 * sign * d * length + slope * by_square * du**2 + 2 * k * du * by_du
            derivatives.append(by_node + 0.5 * by_middle(d, du))
        return length * d**2 + k * du**2, derivatives[0], derivatives[1]

    def _at_middles(self, g: Vector) -> tuple[Array, Array, Array, Vector, Callable[[Array, Array], Array]]:
        """The tangential entry of B at the middles of the edges, ``k`` there with its slope and ``B^-1 g``.

        Tangential components first. The last result maps ``d`` and ``du`` to the flux's derivative by the middle.
        """
        middle = self.side.points((self.t[1:] + self.t[:-1]) / 2)
        base = self._turned(self.metric.base(*middle))
        if self.side.kind is Boundary.EQUIDISTRIBUTED_1D:  # sees the side alone: no metric but along it
            base = (base[0], np.zeros(g[0].shape), np.ones(g[0].shape))
        k, slope, raised = self.metric.strength(g, base)
        changes = self.metric.base_slopes(*middle)
        if changes is None:
            return base[0], k, slope, raised, lambda d, _: np.zeros(d.size)
        change = self._turned(changes[1 - self.side.axis])
        if self.side.kind is Boundary.EQUIDISTRIBUTED_1D:
            change = (change[0], np.zeros(g[0].shape), np.zeros(g[0].shape))
        by_square = quadratic(change, raised)
        return base[0], k, slope, raised, lambda d, du: change[0] * d**2 - slope * by_square * du**2

    def _turned(self, tensor: Tensor) -> Tensor:
        """The tensor with its tangential entry first."""
        return tensor[::-1] if self.side.axis == 0 else tensor


def sides(kind: Boundary) -> dict[tuple[int, int], Side]:
    """The four sides of the unit square by (axis, end)."""
    return {(axis, end): Side(axis=axis, end=end, kind=kind) for axis in (0, 1) for end in (0, 1)}
