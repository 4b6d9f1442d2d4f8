"""The physical boundary of the unit square: where its nodes lie, and what places them along each side."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Any, TypeAlias, TypeVar

import numpy as np
import numpy.typing as npt
from scipy.sparse import csc_array, diags_array

from equimesh import newton
from equimesh.equations import Rows, Window
from equimesh.monitor import ArcLength

Array: TypeAlias = npt.NDArray[np.float64]
IntArray: TypeAlias = npt.NDArray[np.int64]
Triplets: TypeAlias = list[tuple[IntArray, IntArray, Array]]
S = TypeVar("S", bound=np.generic)

# Newton steps that placing the nodes of one side may take, and the rounding error of its residual, per point.
MOST_STEPS = 30
ROUNDING = 64 * np.finfo(np.float64).eps


class Boundary(StrEnum):
    """What places the nodes along the four sides.

    ``TRACE``: equal metric length with the full gradient of u, the trace of the interior equations (the default).
    ``EQUIDISTRIBUTED_1D``: equal metric length of u along the side alone, the paper's choice, equation (7); folds
    steep monitors on fine meshes. ``ORTHOGONAL``: coordinate lines meet the sides at right angles, equation (6).
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

    def place(self, monitor: ArcLength, t: Array) -> Array | None:
        """The nodes of the whole side, from positions ``t`` along it, shape ``(k,)``, by guarded Newton.

        Only for conditions that see nothing but the side itself, that is, not for ``ORTHOGONAL``. ``None`` where
        Newton's method fails.
        """

        def full(inner: Array) -> Array:
            return np.concatenate([t[:1], inner, t[-1:]])

        def residual(inner: Array) -> Array:
            flux, _, _ = _SideLine.of(self, monitor, full(inner)).fluxes(monitor)
            return np.diff(flux)

        def jacobian(inner: Array) -> csc_array:
            _, by_first, by_second = _SideLine.of(self, monitor, full(inner)).fluxes(monitor)
            bands: Any = [-by_first[1:-1], by_first[1:] - by_second[:-1], by_second[1:-1]]
            return csc_array(diags_array(bands, offsets=[-1, 0, 1]))

        flux, _, _ = _SideLine.of(self, monitor, t).fluxes(monitor)
        tolerance = ROUNDING * t.size * float(flux.mean())
        for step in newton.iterate(
            residual, jacobian, t[1:-1], admissible=lambda z: bool((np.diff(full(z)) > 0).all()), tolerance=tolerance
        ):
            if step.residual <= tolerance:
                return full(step.z)
            if step.stalled or step.step >= MOST_STEPS:
                break
        return None

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
        line = _SideLine.of(self, window.monitor, self.line((window.x, window.y)[1 - self.axis]))
        flux, by_first, by_second = line.fluxes(window.monitor)
        rows, scale = unknown[1:-1], 1.0 / spacing**2
        triplets = [
            (rows, unknown[:-2], -scale * by_first[:-1]),
            (rows, unknown[1:-1], scale * (by_first[1:] - by_second[:-1])),
            (rows, unknown[2:], scale * by_second[1:]),
        ]
        return scale * np.diff(flux), triplets


@dataclass(frozen=True)
class _SideLine:
    """u along one side, at its nodes: position ``t``, value, tangential derivative.

    ``u_n`` and ``u_tn`` are zero where the boundary condition does not see the normal derivative.
    """

    t: Array
    u: Array
    u_t: Array
    u_n: Array
    u_tn: Array

    @classmethod
    def of(cls, side: Side, monitor: ArcLength, t: Array) -> _SideLine:
        fixed = np.full(t.size, float(side.end))
        x, y = (fixed, t) if side.axis == 0 else (t, fixed)
        if side.kind is Boundary.EQUIDISTRIBUTED_1D:
            u, *gradient = monitor.u.evaluate(x, y, order=1)
            return cls(t, u, gradient[1 - side.axis], np.zeros(t.size), np.zeros(t.size))
        u, u_x, u_y, _, u_xy, _ = monitor.u.evaluate(x, y, order=2)
        u_t, u_n = (u_y, u_x) if side.axis == 0 else (u_x, u_y)
        return cls(t, u, u_t, u_n, u_xy)

    def fluxes(self, monitor: ArcLength) -> tuple[Array, Array, Array]:
        """``(1 + k g^2) d^2`` on every edge of the side, and its derivatives by the edge's two nodes."""
        d, du, u_n = np.diff(self.t), np.diff(self.u), (self.u_n[1:] + self.u_n[:-1]) / 2
        g = du / d
        square = g**2 + u_n**2
        k, slope = monitor.strength(square), monitor.strength_slope(square)
        derivatives = []
        for sign, node in ((-1.0, slice(0, -1)), (1.0, slice(1, None))):
            by_du = sign * self.u_t[node]
            by_square = 2 * g * (by_du - sign * g) / d + u_n * self.u_tn[node]
            derivatives.append(2 * sign * d + slope * by_square * du**2 + 2 * k * du * by_du)
        return d**2 + k * du**2, derivatives[0], derivatives[1]


def sides(kind: Boundary) -> dict[tuple[int, int], Side]:
    """The four sides of the unit square by (axis, end)."""
    return {(axis, end): Side(axis=axis, end=end, kind=kind) for axis in (0, 1) for end in (0, 1)}
