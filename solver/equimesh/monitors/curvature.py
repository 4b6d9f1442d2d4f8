"""Curvature of u as the monitor: the metric tensors that minimise the error of linear interpolation.

Huang, *Metric tensors for anisotropic mesh generation* (J. Comput. Phys. 204, 2005); Huang and Russell, *Adaptive
Moving Mesh Methods* (Springer, 2011), chapter 5. With the Hessian H of u, its matrix absolute value and a number alpha,

    A = I + |H| / alpha,    L2: M = det(A)^(-1/6) A,    H1: M = (tr(A) / 2)^(1/2) det(A)^(-1/4) A,

or, isotropic, with the Frobenius norm h of H: ``M = (1 + h / alpha)^(2/3) I`` and ``M = (1 + h / alpha) I``. alpha is
such that the integral of ``sqrt(det M)`` over the domain is twice its area: half of the cells are then used where
u is curved, and the metric does not depend on the size of u.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cache
from typing import Literal

import numpy as np
import scipy

from equimesh.errors import InputError
from equimesh.fields.expression import Field, require_fields
from equimesh.monitors.monitor import AnyDomain, Monitor, Probe, bound_copy, is_bound_to, require_orthogonality, weaken
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array

NORMS = ("l2", "h1")
MAX_LINEAR_SHARE = 1e-8
"""u counts as linear when H times the domain's size squared is below this share of u: that is rounding."""
_H1, _ISOTROPIC = 1, 2  # bits of the kernels' ``kind``


@dataclass(frozen=True, kw_only=True)
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
    norm: Literal["l2", "h1"] = "l2"
    isotropic: bool = False
    floor: float = 0.01
    orthogonality: float | None = None
    """The largest angle of non-orthogonality of the mesh, in degrees; ``None`` for no bound."""
    alpha: float | None = field(default=None, init=False)
    _domain: AnyDomain | None = field(default=None, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        require_fields(self, "u")
        require_orthogonality(self.orthogonality)
        if self.norm not in NORMS:
            raise InputError(f"norm = {self.norm!r}: choose 'l2' or 'h1'", field="norm")
        if not 0.0 < self.floor <= 1.0:
            raise InputError(f"floor = {self.floor}: the floor must be positive and at most 1", field="floor")

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
        _metric(h11.ravel(), h12.ravel(), h22.ravel(), 1.0 / self.alpha, self.floor, self._kind, out)
        return out[0].reshape(shape), out[1].reshape(shape), out[2].reshape(shape)

    def on(self, domain: AnyDomain) -> Curvature:
        """The monitor with the ``alpha`` of ``domain``.

        Raises :class:`~equimesh.errors.InputError` at a point of the domain where u or its second derivatives are
        not finite.
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
def _metric(h11: Array, h12: Array, h22: Array, inverse_alpha: float, floor: float, kind: int, out: Array) -> None:
    """The tensors from the Hessian's entries. |B| is the root of ``S = B^2 + floor^2 I``, ``B = H / alpha``:
    ``|B| = (S + sqrt(det S) I) / t`` with its trace ``t = sqrt(tr S + 2 sqrt(det S))``, as in
    :mod:`equimesh.numerics.spd`.
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
