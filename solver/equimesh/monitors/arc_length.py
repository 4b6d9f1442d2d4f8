"""The arc-length monitor of the paper."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from equimesh.domains.domain import Domain
from equimesh.errors import InputError
from equimesh.fields.field import Field, require_field
from equimesh.monitors.monitor import require_strength
from equimesh.numerics.types import Array


@dataclass(frozen=True, kw_only=True)
class ArcLength:
    """The scaled arc-length metric ``M = k grad u grad u^T + I``, ``k = a^2 / (1 + b |grad u|^2)``.

    Haynes and Howse, equation (1) and the remark below equation (4). A :class:`Monitor`.

    ``a`` in [0, 1] is the strength of the adaptation: 0 gives the uniform mesh. ``b >= 0`` bounds the metric where
    u is steep (``k |grad u|^2 < a^2 / b``): raise it when cells get too thin or the solve fails.
    Raises :class:`~equimesh.errors.InputError` for values outside these ranges.
    """

    u: Field
    a: float = 0.7
    b: float = 0.05

    def __post_init__(self) -> None:
        require_field(self.u, "u")
        if not 0.0 <= self.a <= 1.0:
            raise InputError(f"a = {self.a}: the relaxation parameter a must lie in [0, 1]", field="a")
        if not (self.b >= 0.0 and math.isfinite(self.b)):
            raise InputError(f"b = {self.b}: the damping parameter b must be finite and not negative", field="b")

    def strength(self, squared_gradient: Array) -> Array:
        """``k`` at points where ``|grad u|^2`` is ``squared_gradient``."""
        return self.a**2 / (1.0 + self.b * squared_gradient)

    def strength_slope(self, squared_gradient: Array) -> Array:
        """The derivative of :meth:`strength`."""
        return -self.b * self.a**2 / (1.0 + self.b * squared_gradient) ** 2

    def metric(self, x: Array, y: Array) -> tuple[Array, Array, Array]:
        """``(m11, m12, m22)`` at physical points, from the exact gradient of u."""
        _, u_x, u_y = self.u.evaluate(x, y, order=1)
        xx, yy = u_x * u_x, u_y * u_y
        k = self.strength(xx + yy)
        return 1.0 + k * xx, k * u_x * u_y, 1.0 + k * yy

    def on(self, domain: Domain) -> ArcLength:  # noqa: ARG002 - every monitor can be bound
        """The monitor itself: nothing in it depends on the domain."""
        return self

    def weakened(self, strength: float) -> ArcLength:
        """The monitor with ``strength * a`` for ``a``."""
        return replace(self, a=require_strength(strength) * self.a)
