"""Monitors that are metrics of u: arc length and curvature."""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass, field, replace
from functools import cache
from typing import Literal

import numpy as np
import scipy

from equimesh.domains.domain import Domain, closed_of, is_closed
from equimesh.errors import InputError
from equimesh.fields.expression import Field, require_fields
from equimesh.inputs import keep_floats, require_flag
from equimesh.monitors.monitor import (
    AnyDomain,
    Monitor,
    Probe,
    bound_copy,
    is_bound_to,
    require_orthogonality,
    require_strength,
    weaken,
)
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array
from equimesh_schema.document import is_number

# The arc-length monitor of the paper.

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


@dataclass(frozen=True)
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
    _: KW_ONLY
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
        require_orthogonality(self)
        keep_floats(self, "a", "b")
        if not (is_number(self.a) and 0.0 <= self.a <= 1.0):
            raise InputError(f"a = {self.a!r:.40}: the relaxation parameter a must lie in [0, 1]", field="a")
        if not (is_number(self.b) and self.b >= 0.0 and math.isfinite(self.b)):
            raise InputError(f"b = {self.b!r:.40}: the damping parameter b must be finite and not negative", field="b")
        require_flag(self.scaled, "scaled")
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
        _arc_length_metric(u_x.reshape(-1), u_y.reshape(-1), self.factor, self.a**2, self.b, out.reshape(3, -1))
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
            (u,) = self.u.evaluate(probe.x.reshape(RANGE_CELLS + 1, -1), probe.y.reshape(RANGE_CELLS + 1, -1))
        known = u[np.isfinite(u)]
        if known.size == 0:
            return 1.0
        low, high = extremes(self.u, domain) if is_closed(domain) else (float(known.min()), float(known.max()))
        if not high - low > MAX_CONSTANT_SHARE * max(abs(low), abs(high)):
            return 0.0
        return math.sqrt(domain.area) / (high - low)


@compiled
def _arc_length_metric(u_x: Array, u_y: Array, factor: float, a2: float, b: float, out: Array) -> None:
    """The metrics where the derivatives of u, times ``factor``, are these; ``out`` has the shape ``(3, n)``."""
    m11, m12, m22 = out[0], out[1], out[2]
    for i in range(u_x.size):
        x, y = factor * u_x[i], factor * u_y[i]
        k = a2 / (1.0 + b * (x * x + y * y))
        m11[i], m12[i], m22[i] = 1.0 + k * x * x, k * x * y, 1.0 + k * y * y


# Curvature of u as the monitor: the metric tensors that minimise the error of linear interpolation.
#
# Huang, *Metric tensors for anisotropic mesh generation* (J. Comput. Phys. 204, 2005); Huang and Russell, *Adaptive
# Moving Mesh Methods* (Springer, 2011), chapter 5. With the Hessian H of u, its matrix absolute value and a number
# alpha,
#
# A = I + |H| / alpha, L2: M = det(A)^(-1/6) A, H1: M = (tr(A) / 2)^(1/2) det(A)^(-1/4) A,
#
# or, isotropic, with the Frobenius norm h of H: ``M = (1 + h / alpha)^(2/3) I`` and ``M = (1 + h / alpha) I``. alpha
# is such that the integral of ``sqrt(det M)`` over the domain is twice its area: half of the cells are then used
# where u is curved, and the metric does not depend on the size of u.

NORMS = ("l2", "h1")
MAX_LINEAR_SHARE = 1e-8
"""u counts as linear when H times the domain's size squared is below this share of u: that is rounding."""
_H1, _ISOTROPIC = 1, 2  # bits of the kernels' ``kind``


@dataclass(frozen=True)
class Curvature:
    """The metric of the curvature of u: small cells, thin ones along fronts, where u is far from linear.

    ``norm`` is that of the interpolation error to be made small: ``"l2"`` of u itself, ``"h1"`` of its gradient, which
    concentrates the nodes more. ``isotropic`` ignores the shape of the cells. ``floor`` rounds off the absolute value
    where an eigenvalue of H changes sign, ``sqrt(lambda^2 + (floor alpha)^2)``: the metric is a
    smooth function of H; raise it towards 0.1 if a solve has trouble there.

    A :class:`~equimesh.monitors.monitor.Monitor`; ``alpha`` is known once it is bound to a domain by :meth:`on`, which
    :class:`~equimesh.equations.problem.Problem` does, and is infinite for a linear u. Where u is steep over less than a
    hundredth of the domain, a coarse grid cannot resolve its curvature: see
    :class:`~equimesh.monitors.smoothed.Smoothed`. Raises :class:`~equimesh.errors.InputError` for values outside these
    ranges.
    """

    u: Field
    _: KW_ONLY
    norm: Literal["l2", "h1"] = "l2"
    isotropic: bool = False
    floor: float = 0.01
    orthogonality: float | None = None
    """The largest angle of non-orthogonality of the mesh, in degrees; ``None`` for no bound."""
    alpha: float | None = field(default=None, init=False)
    _domain: AnyDomain | None = field(default=None, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        require_fields(self, "u")
        require_orthogonality(self)
        if self.norm not in NORMS:
            raise InputError(f"norm = {self.norm!r}: choose 'l2' or 'h1'", field="norm")
        require_flag(self.isotropic, "isotropic")
        keep_floats(self, "floor")
        if not (is_number(self.floor) and 0.0 < self.floor <= 1.0):
            raise InputError(f"floor = {self.floor!r:.40}: the floor must be positive and at most 1", field="floor")

    def metric(self, x: Array, y: Array) -> tuple[Array, Array, Array]:
        """``(m11, m12, m22)`` at physical points, from the exact Hessian of u.

        Raises :class:`~equimesh.errors.InputError` before the monitor is bound to a domain.
        """
        return self.metric_of(*self.u.evaluate(x, y, order=2))

    @property
    def order(self) -> int:
        """The metric needs second derivatives; see :class:`~equimesh.monitors.monitor.OfDerivatives`."""
        return 2

    def metric_of(self, *derivatives: Array) -> tuple[Array, Array, Array]:
        """The metric where u and its derivatives up to the second ones are these."""
        if self.alpha is None:
            raise InputError(
                "the scale alpha of a curvature monitor depends on the domain: call monitor.on(domain) first"
            )
        h11, h12, h22 = derivatives[3:]
        shape, out = h11.shape, np.empty((3, h11.size))
        _curvature_metric(h11.ravel(), h12.ravel(), h22.ravel(), 1.0 / self.alpha, self.floor, self._kind, out)
        return out[0].reshape(shape), out[1].reshape(shape), out[2].reshape(shape)

    def on(self, domain: AnyDomain) -> Curvature:
        """The monitor with the ``alpha`` of ``domain``.

        Raises :class:`~equimesh.errors.InputError` at a point of the domain where u or its second derivatives are
        not finite, and where u is so large or small that its squares are no numbers.
        """
        if is_bound_to(self._domain, domain):
            return self
        return bound_copy(self, domain, alpha=self._scale(Probe.of(domain)))

    def weakened(self, strength: float) -> Monitor:
        """The metric to the matrix power ``strength``."""
        return weaken(self, strength)

    @property
    def _kind(self) -> int:
        return _H1 * (self.norm == "h1") + _ISOTROPIC * self.isotropic

    def _scale(self, probe: Probe) -> float:
        """alpha, between brackets of its logarithm: the integral falls from infinity to less than twice the area."""
        u, _, _, h11, h12, h22 = self.u.evaluate(probe.x, probe.y, order=2)
        probe.require_finite([u, h11, h12, h22], "u or its second derivatives are", field="u")
        probe.require_size(u)
        size = np.sqrt(h11**2 + 2 * h12**2 + h22**2)
        typical, weights = float(probe.shares @ size), probe.shares
        if float(size.max()) * probe.diameter**2 <= MAX_LINEAR_SHARE * float(np.abs(u).max()):
            return math.inf

        @cache  # the search asks for the ends of its bracket again
        def excess(logarithm: float) -> float:
            scale = math.exp(-logarithm) / typical
            return _mean_density(h11, h12, h22, weights, scale, self.floor, self._kind) - 2.0

        low, high = -1.0, 1.0
        while excess(low) <= 0.0:
            low -= 2.0
        while excess(high) >= 0.0:
            high += 2.0
        return typical * math.exp(float(scipy.optimize.brentq(excess, low, high, xtol=1e-10)))


@compiled
def _curvature_metric(
    h11: Array, h12: Array, h22: Array, inverse_alpha: float, floor: float, kind: int, out: Array
) -> None:
    """The tensors from the Hessian's entries. |B| is the root of ``S = B^2 + floor^2 I``, ``B = H / alpha``:
    ``|B| = (S + sqrt(det S) I) / t`` with its trace ``t = sqrt(tr S + 2 sqrt(det S))``, as in
    :mod:`equimesh.monitors.monitor`.
    """
    square = floor * floor
    for i in range(h11.size):
        a, b, c = h11[i] * inverse_alpha, h12[i] * inverse_alpha, h22[i] * inverse_alpha
        total = a * a + 2.0 * b * b + c * c + 2.0 * square
        if kind >= 2:
            m = 1.0 + np.sqrt(total)
            if kind == 2:
                m = np.cbrt(m * m)
            out[0, i], out[1, i], out[2, i] = m, 0.0, m
            continue
        det = a * c - b * b
        root = np.sqrt(det * det + square * (total - square))
        trace = np.sqrt(total + 2.0 * root)
        volume = 1.0 + trace + root  # det(I + |B|)
        scale = np.sqrt((1.0 + 0.5 * trace) / np.sqrt(volume)) if kind == 1 else 1.0 / np.sqrt(np.cbrt(volume))
        part = scale / trace
        out[0, i] = scale + part * (a * a + b * b + square + root)
        out[1, i] = part * b * (a + c)
        out[2, i] = scale + part * (b * b + c * c + square + root)


@compiled
def _mean_density(
    h11: Array, h12: Array, h22: Array, weights: Array, inverse_alpha: float, floor: float, kind: int
) -> float:
    """The weighted sum of ``sqrt(det M)``."""
    square, result = floor * floor, 0.0
    for i in range(h11.size):
        a, b, c = h11[i] * inverse_alpha, h12[i] * inverse_alpha, h22[i] * inverse_alpha
        total = a * a + 2.0 * b * b + c * c + 2.0 * square
        if kind >= 2:
            m = 1.0 + np.sqrt(total)
            result += weights[i] * (np.cbrt(m * m) if kind == 2 else m)
            continue
        det = a * c - b * b
        root = np.sqrt(det * det + square * (total - square))
        trace = np.sqrt(total + 2.0 * root)
        volume = 1.0 + trace + root
        density = np.sqrt((1.0 + 0.5 * trace) * np.sqrt(volume)) if kind == 1 else np.cbrt(volume)
        result += weights[i] * density
    return result
