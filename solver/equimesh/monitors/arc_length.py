"""The arc-length monitor of the paper."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from equimesh.domains.domain import Domain, closed_of, is_closed
from equimesh.errors import InputError
from equimesh.fields.expression import Field, require_fields
from equimesh.monitors.monitor import Probe, bound_copy, is_bound_to, require_orthogonality, require_strength
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array

# The smallest and the largest value of a function on a domain with closed lines.
#
# Values at the nodes of a grid depend on where its lines begin. Those of the extremes do not: they are sought around
# the best nodes, closer and closer.

CELLS = 90
"""Cells in a direction of the first search."""
CANDIDATES = 32
"""Nodes around which an extreme is sought."""
ZOOMS = 16
"""Closer searches around each of them."""
ZOOM_SHARE = 0.4
"""The width of a closer search, as a share of that of the search before."""
OFFSETS = np.linspace(-1.0, 1.0, 7)
"""The places of a closer search in a direction, in units of its width."""


def extremes(u: Field, domain: Domain) -> tuple[float, float]:
    """The smallest and the largest finite value of ``u``; ``(0, 0)`` where there is none."""
    line = np.linspace(0.0, 1.0, CELLS + 1)
    s, t = (axis.ravel() for axis in np.meshgrid(line, line, indexing="ij"))
    with np.errstate(all="ignore"):
        values = _values(u, domain, s, t)
        known = np.isfinite(values)
        if not known.any():
            return 0.0, 0.0
        s, t, values = s[known], t[known], values[known]
        return -_largest(u, domain, (s, t), -values, -1.0), _largest(u, domain, (s, t), values, 1.0)


def _largest(u: Field, domain: Domain, nodes: tuple[Array, Array], values: Array, sign: float) -> float:
    """The largest value of ``sign`` times u, from its values at nodes."""
    best = np.argsort(-values, kind="stable")[:CANDIDATES]
    s, t, found, width = nodes[0][best], nodes[1][best], values[best], 1.0 / CELLS
    closed = closed_of(domain)
    a, b = (offsets.ravel() for offsets in np.meshgrid(OFFSETS, OFFSETS, indexing="ij"))
    every = np.arange(best.size)
    for _ in range(ZOOMS):
        near_s, near_t = s[:, None] + width * a, t[:, None] + width * b
        near_s, near_t = (
            q % 1.0 if around else np.clip(q, 0.0, 1.0) for q, around in zip((near_s, near_t), closed, strict=True)
        )
        near = sign * _values(u, domain, near_s, near_t)
        near[~np.isfinite(near)] = -np.inf
        which = near.argmax(axis=1)
        s, t, found = near_s[every, which], near_t[every, which], np.maximum(found, near[every, which])
        width *= ZOOM_SHARE
    return float(found.max())


def _values(u: Field, domain: Domain, s: Array, t: Array) -> Array:
    return u.evaluate(*domain.map(s, t))[0]


RANGE_CELLS = 90
"""Cells in a direction, at whose nodes the range of u is measured."""
MAX_CONSTANT_SHARE = 4 * float(np.finfo(np.float64).eps)
"""u counts as constant when its range is at most this share of its size: that is rounding."""


@dataclass(frozen=True, kw_only=True)
class ArcLength:
    """The scaled arc-length metric ``M = k grad u grad u^T + I``, ``k = a^2 / (1 + b |grad u|^2)``.

    Haynes and Howse, equation (1) and the remark below equation (4). A :class:`Monitor`.

    ``a`` in [0, 1] is the strength of the adaptation: 0 gives the uniform mesh. ``b >= 0`` bounds the metric where
    u is steep (``k |grad u|^2 < a^2 / b``): raise it when cells get too thin or the solve fails.

    ``scaled`` makes the metric independent of the units of u and of the coordinates: ``grad u`` is then the gradient of
    u over its range (the largest value minus the smallest one on the domain), by lengths in units of the size of the
    domain (the root of its area). With False u and the lengths are taken as they are given, as in the paper. The two
    are equal for a u between 0 and 1 on the unit square.

    Raises :class:`~equimesh.errors.InputError` for values outside these ranges.
    """

    u: Field
    a: float = 0.7
    b: float = 0.05
    scaled: bool = True
    orthogonality: float | None = None
    """The largest angle of non-orthogonality of the mesh, in degrees; ``None`` for no bound."""
    factor: float | None = field(default=None, init=False, compare=False)
    """The factor of ``grad u``: 1, or the size of the domain over the range of u; known once the monitor is bound.

    0 where u is constant on the domain.
    """
    _domain: Domain | None = field(default=None, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        require_fields(self, "u")
        require_orthogonality(self.orthogonality)
        if not 0.0 <= self.a <= 1.0:
            raise InputError(f"a = {self.a}: the relaxation parameter a must lie in [0, 1]", field="a")
        if not (self.b >= 0.0 and math.isfinite(self.b)):
            raise InputError(f"b = {self.b}: the damping parameter b must be finite and not negative", field="b")
        if not isinstance(self.scaled, bool):
            raise InputError(f"scaled = {str(self.scaled)[:20]}: give True or False", field="scaled")
        if not self.scaled:
            object.__setattr__(self, "factor", 1.0)

    def strength(self, squared_gradient: Array) -> Array:
        """``k`` at points where ``|grad u|^2`` is ``squared_gradient``, both in the units of :attr:`factor`."""
        return self.a**2 / (1.0 + self.b * squared_gradient)

    def strength_slope(self, squared_gradient: Array) -> Array:
        """The derivative of :meth:`strength`."""
        return -self.b * self.a**2 / (1.0 + self.b * squared_gradient) ** 2

    def metric(self, x: Array, y: Array) -> tuple[Array, Array, Array]:
        """``(m11, m12, m22)`` at physical points, from the exact gradient of u.

        Raises :class:`~equimesh.errors.InputError` before a scaled monitor is bound to a domain.
        """
        return self.metric_of(*self.u.evaluate(x, y, order=1))

    @property
    def order(self) -> int:
        """The metric needs first derivatives; see :class:`~equimesh.monitors.monitor.OfDerivatives`."""
        return 1

    def metric_of(self, *derivatives: Array) -> tuple[Array, Array, Array]:
        """The metric where u and its first derivatives are these."""
        if self.factor is None:
            raise InputError("the scale of an arc length depends on the domain: call monitor.on(domain) first")
        _, u_x, u_y = (np.asarray(values, dtype=np.float64, order="C") for values in derivatives)
        out = np.empty((3, *u_x.shape))
        _metric(u_x.reshape(-1), u_y.reshape(-1), self.factor, self.a**2, self.b, out.reshape(3, -1))
        return out[0], out[1], out[2]

    def on(self, domain: Domain) -> ArcLength:
        """The monitor with the :attr:`factor` of ``domain``."""
        if is_bound_to(self._domain, domain):
            return self
        return bound_copy(self, domain, factor=self._scale(domain) if self.scaled else 1.0)

    def weakened(self, strength: float) -> ArcLength:
        """The monitor with ``strength * a`` for ``a``."""
        weaker = replace(self, a=require_strength(strength) * self.a)
        return weaker if self._domain is None else bound_copy(weaker, self._domain, factor=self.factor)

    def _scale(self, domain: Domain) -> float:
        """The size of the domain over the range of u, from the finite values of u; 0 where there is no range."""
        probe = Probe.of_closure(domain, RANGE_CELLS)
        with np.errstate(all="ignore"):
            (u,) = self.u.evaluate(probe.x, probe.y)
        known = u[np.isfinite(u)]
        if known.size == 0:
            return 1.0
        low, high = extremes(self.u, domain) if is_closed(domain) else (float(known.min()), float(known.max()))
        if not high - low > MAX_CONSTANT_SHARE * max(abs(low), abs(high)):
            return 0.0
        return math.sqrt(domain.area) / (high - low)


@compiled
def _metric(u_x: Array, u_y: Array, factor: float, a2: float, b: float, out: Array) -> None:
    """The metrics where the derivatives of u, times ``factor``, are these; ``out`` has the shape ``(3, n)``."""
    m11, m12, m22 = out[0], out[1], out[2]
    for i in range(u_x.size):
        x, y = factor * u_x[i], factor * u_y[i]
        k = a2 / (1.0 + b * (x * x + y * y))
        m11[i], m12[i], m22[i] = 1.0 + k * x * x, k * x * y, 1.0 + k * y * y
