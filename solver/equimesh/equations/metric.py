"""The discrete metric: the gradient of u by a stencil, and the squared metric length of a vector.

Every equation of the method consists of one quantity, half the squared metric length of a coordinate direction,

    f = (d . B d + k (g . d)^2) / 2,    k = a^2 / (1 + b g . B^-1 g),

on the reference square. ``d`` is the derivative of the position along xi or eta, ``B`` the pointwise part of the metric
there, and ``g`` the gradient of u by differences on the mesh (the paper's w). For the arc-length monitor ``B`` is the
metric of the map to the physical domain, the identity on the unit square; for all others it is the whole metric, and
``k = 0``. Moving stencil node c by ``dr`` changes ``g`` by the rank-one term ``G_c ((grad u(c) - g) . dr)``, where
``G_c`` is the gradient of the node's weight in the stencil.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeAlias

import numpy as np

from equimesh.domains.domain import Domain, Rectangle
from equimesh.monitors.metrics import ArcLength
from equimesh.monitors.monitor import Monitor
from equimesh.numerics.types import Array

Vector: TypeAlias = tuple[Array, Array]
Tensor: TypeAlias = tuple[Array, Array, Array]

# Half the step of difference quotients for derivatives of the pointwise part, in units of the square.
SLOPE_STEP = 1e-6
# Points a direction at which the size of u is measured.
SIZE_SAMPLES = 17


@dataclass(frozen=True)
class ReferenceMetric:
    """The metric of a monitor on a domain, pulled back to the reference square.

    With ``J`` the Jacobian matrix of the domain's map it is ``J^T M J``: lengths of reference vectors in it are those
    of their images in the monitor's metric M.
    """

    monitor: Monitor
    domain: Domain
    turned: bool = False
    """Whether the two reference coordinates, of points and of the pointwise part, are exchanged."""

    @cached_property
    def arc_length(self) -> ArcLength | None:
        """The monitor if its gradient of u is taken on the mesh; all others are functions of the point."""
        return self.monitor.on(self.domain) if isinstance(self.monitor, ArcLength) else None

    @cached_property
    def factor(self) -> float:
        """The factor of u of the arc length; see :attr:`equimesh.monitors.metrics.ArcLength.factor`."""
        factor = None if self.arc_length is None else self.arc_length.factor
        return 1.0 if factor is None else factor

    @cached_property
    def on_unit_square(self) -> bool:
        """Whether the map is the identity."""
        return isinstance(self.domain, Rectangle) and self.domain.is_unit_square

    @cached_property
    def cancellation(self) -> float:
        """The size of u over its variation, at least 1: differences of u lose accuracy by this factor."""
        at = np.linspace(0.0, 1.0, SIZE_SAMPLES)
        u = self.u(*(q.copy() for q in np.meshgrid(at, at, indexing="ij")))
        variation, size = float(np.ptp(u)), float(np.abs(u).max())
        return max(1.0, size / variation) if 0.0 < variation < math.inf else 1.0

    def u(self, s: Array, t: Array) -> Array:
        """u of the arc-length monitor in its units, at reference points; zero for other monitors."""
        if self.arc_length is None:
            return np.zeros(s.shape)
        (u,) = self.arc_length.u.evaluate(*self._physical(s, t))
        return u if self.factor == 1.0 else self.factor * u

    def u_with_gradient(self, s: Array, t: Array) -> Tensor:
        """u of the arc-length monitor in its units, and its derivatives by s and t; zeros for other monitors."""
        if self.arc_length is None:
            zero = np.zeros(s.shape)
            return zero, zero, zero
        u, u_x, u_y = self.arc_length.u.evaluate(*self._physical(s, t), order=1)
        if self.factor != 1.0:
            u, u_x, u_y = self.factor * u, self.factor * u_x, self.factor * u_y
        if self.on_unit_square:
            return u, u_x, u_y
        x_s, x_t, y_s, y_t = self.domain.jacobian(s, t)
        return u, u_x * x_s + u_y * y_s, u_x * x_t + u_y * y_t

    def base(self, s: Array, t: Array) -> Tensor:
        """The pointwise part ``(b11, b12, b22)`` at reference points."""
        if self.turned:
            b22, b12, b11 = replace(self, turned=False).base(t, s)
            return b11, b12, b22
        if self.arc_length is not None:
            if self.on_unit_square:
                one = np.ones(s.shape)
                return one, np.zeros(s.shape), one
            x_s, x_t, y_s, y_t = self.domain.jacobian(s, t)
            return x_s**2 + y_s**2, x_s * x_t + y_s * y_t, x_t**2 + y_t**2
        m11, m12, m22 = self.monitor.metric(*self._physical(s, t))
        if self.on_unit_square:
            return m11, m12, m22
        x_s, x_t, y_s, y_t = self.domain.jacobian(s, t)
        first = (m11 * x_s + m12 * y_s, m12 * x_s + m22 * y_s)
        return (
            first[0] * x_s + first[1] * y_s,
            first[0] * x_t + first[1] * y_t,
            m11 * x_t**2 + 2 * m12 * x_t * y_t + m22 * y_t**2,
        )

    def base_slopes(self, s: Array, t: Array) -> tuple[Tensor, Tensor] | None:
        """The derivatives of :meth:`base` by s and by t, by difference quotients; ``None`` where it is constant."""
        if self.arc_length is not None and isinstance(self.domain, Rectangle):
            return None
        return self._slope(s, t, 1.0, 0.0), self._slope(s, t, 0.0, 1.0)

    def strength(self, g: Vector, base: Tensor) -> tuple[Array, Array, Vector]:
        """``k``, its derivative by ``g . B^-1 g``, and ``B^-1 g``."""
        if self.arc_length is None:
            zero = np.zeros(g[0].shape)
            return zero, zero, (zero, zero)
        b11, b12, b22 = base
        determinant = b11 * b22 - b12**2
        raised = ((b22 * g[0] - b12 * g[1]) / determinant, (b11 * g[1] - b12 * g[0]) / determinant)
        square = g[0] * raised[0] + g[1] * raised[1]
        return self.arc_length.strength(square), self.arc_length.strength_slope(square), raised

    def _physical(self, s: Array, t: Array) -> Vector:
        return (s, t) if self.on_unit_square else self.domain.map(s, t)

    def _slope(self, s: Array, t: Array, along_s: float, along_t: float) -> Tensor:
        upper = self.base(s + SLOPE_STEP * along_s, t + SLOPE_STEP * along_t)
        lower = self.base(s - SLOPE_STEP * along_s, t - SLOPE_STEP * along_t)
        d11, d12, d22 = ((u - v) / (2 * SLOPE_STEP) for u, v in zip(upper, lower, strict=True))
        return d11, d12, d22


def quadratic(tensor: Tensor, d: Vector) -> Array:
    """``d . B d``."""
    return tensor[0] * d[0] ** 2 + 2 * tensor[1] * d[0] * d[1] + tensor[2] * d[1] ** 2
