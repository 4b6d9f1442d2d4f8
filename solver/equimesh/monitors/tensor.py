"""Metrics given by the user: a weight, or a whole tensor."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from equimesh.domains.domain import Domain
from equimesh.errors import InputError
from equimesh.fields.expression import Field, require_fields
from equimesh.fields.nodal_field import HermiteField, NodalField
from equimesh.monitors.monitor import (
    Monitor,
    Probe,
    bound_copy,
    eigenvalues,
    intersection,
    is_bound_to,
    map_of,
    require_orthogonality,
    weaken,
)
from equimesh.numerics.types import Array

MAPS = ("lines", "gradient")
"""Ways to equal shares of a weight: equal lengths along mesh lines, or a map that is a gradient."""
MIN_EIGENVALUE_RATIO = 1e-10
"""The smaller eigenvalue of a tensor over the larger one must exceed this: less is rounding."""


@dataclass(frozen=True, kw_only=True)
class Weight:
    """The metric ``M = rho I``: cells are small where ``rho`` is large, and are not stretched on purpose.

    Metric lengths are lengths times ``sqrt(rho)``. ``rho`` must be positive on the domain; only its proportions
    matter. Values at the nodes of a mesh are interpolated without overshoots: a positive ``rho`` stays positive. ``u``,
    if given, is the function whose interpolation is measured.

    ``map`` says how cells get equal shares of ``rho``. ``"lines"`` makes the metric lengths along each mesh line equal,
    as for all monitors. ``"gradient"`` moves the nodes by a gradient, so that the areas of cells times ``rho`` are
    equal (:mod:`equimesh.gradient_map`): smoother meshes, in a few microseconds a point also where ``rho`` is
    steep. A gradient map has no subdomains.

    A :class:`~equimesh.monitors.monitor.Monitor`. Raises :class:`~equimesh.errors.InputError` when ``rho`` is no field
    or ``map`` is unknown, and in :meth:`on` where ``rho`` is not finite and positive.
    """

    rho: Field
    u: Field | None = None
    map: Literal["lines", "gradient"] = "lines"
    orthogonality: float | None = None
    """The largest angle of non-orthogonality of the mesh, in degrees; ``None`` for no bound."""
    _domain: Domain | None = field(default=None, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        require_fields(self, "rho", *(["u"] if self.u is not None else []))
        require_orthogonality(self)
        if isinstance(self.rho, NodalField):
            object.__setattr__(self, "rho", HermiteField(mesh=self.rho.mesh, values=self.rho.values))
        if self.map not in MAPS:
            raise InputError(f"map = {self.map!r}: choose 'lines' or 'gradient'", field="map")

    def metric(self, x: Array, y: Array) -> tuple[Array, Array, Array]:
        """``(rho, 0, rho)`` at physical points."""
        (rho,) = self.rho.evaluate(x, y)
        return rho, np.zeros_like(rho), rho

    def on(self, domain: Domain) -> Weight:
        """The monitor, checked on ``domain``.

        Raises :class:`~equimesh.errors.InputError` where ``rho`` is not finite and positive, naming the place.
        """
        if is_bound_to(self._domain, domain):
            return self
        probe = Probe.of_closure(domain)
        (rho,) = self.rho.evaluate(probe.x, probe.y)
        probe.require_finite([rho], "rho is", field="rho")
        worst = int(rho.argmin())
        if not rho[worst] > 0.0:
            raise InputError(
                f"rho = {rho[worst]:.6g} at {probe.place(worst)}: a weight must be positive on the whole domain; add a"
                " constant to it, or take its exponential",
                field="rho",
            )
        return bound_copy(self, domain)

    def weakened(self, strength: float) -> Monitor:
        """The metric to the matrix power ``strength``."""
        return weaken(self, strength)


@dataclass(frozen=True, kw_only=True)
class Tensor:
    """The metric with the entries ``m11``, ``m12`` and ``m22``: ``m11 dx^2 + 2 m12 dx dy + m22 dy^2``.

    It must be positive definite on the domain; only its proportions matter. ``u``, if given, is the function
    whose interpolation is measured. A :class:`~equimesh.monitors.monitor.Monitor`. Raises
    :class:`~equimesh.errors.InputError` when an entry is no field, and in :meth:`on` where the metric is not finite
    and positive definite.
    """

    m11: Field
    m12: Field
    m22: Field
    u: Field | None = None
    orthogonality: float | None = None
    """The largest angle of non-orthogonality of the mesh, in degrees; ``None`` for no bound."""
    _domain: Domain | None = field(default=None, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        require_fields(self, "m11", "m12", "m22", *(["u"] if self.u is not None else []))
        require_orthogonality(self)

    def metric(self, x: Array, y: Array) -> tuple[Array, Array, Array]:
        """``(m11, m12, m22)`` at physical points."""
        return self.m11.evaluate(x, y)[0], self.m12.evaluate(x, y)[0], self.m22.evaluate(x, y)[0]

    def on(self, domain: Domain) -> Tensor:
        """The monitor, checked on ``domain``.

        Raises :class:`~equimesh.errors.InputError` where the tensor is not finite and positive definite, naming the
        place and the smallest eigenvalue; ``field`` is the entry to blame.
        """
        if is_bound_to(self._domain, domain):
            return self
        probe = Probe.of_closure(domain)
        entries = self.metric(probe.x, probe.y)
        for name, entry in zip(("m11", "m12", "m22"), entries, strict=True):
            probe.require_finite([entry], f"{name} is", field=name)
        low, high = eigenvalues(entries)
        worst = int((low - MIN_EIGENVALUE_RATIO * high).argmin())
        if not low[worst] > MIN_EIGENVALUE_RATIO * abs(high[worst]):
            m11, m12, m22 = (float(entry[worst]) for entry in entries)
            raise InputError(
                f"the tensor [[{m11:.6g}, {m12:.6g}], [{m12:.6g}, {m22:.6g}]] at {probe.place(worst)} is not positive"
                f" definite: its smallest eigenvalue is {low[worst]:.6g}; m11 and m22 must be positive and"
                " m12^2 < m11 m22 on the whole domain",
                field="m11" if m11 <= 0.0 else "m22" if m22 <= 0.0 else "m12",
            )
        return bound_copy(self, domain)

    def weakened(self, strength: float) -> Monitor:
        """The metric to the matrix power ``strength``."""
        return weaken(self, strength)


# Several monitors at once.

MIN_MONITORS = 2
MAX_MONITORS = 8


@dataclass(frozen=True, kw_only=True)
class Intersection:
    """The metric in which no length is less than in any of ``monitors``: cells are as small as each of them requests.

    By simultaneous reduction of two metrics at a time, :func:`equimesh.monitors.monitor.intersection`, as in P. J. Frey
    and F. Alauzet, *Anisotropic mesh adaptation for CFD computations*, Comput. Methods Appl. Mech. Engrg. 194 (2005).
    For more than two metrics the result depends slightly on their order. The sizes of the metrics matter: a
    :class:`~equimesh.monitors.tensor.Weight` of 100 hides an arc length of u. :attr:`u` is that of the first monitor
    that has one.

    A :class:`~equimesh.monitors.monitor.Monitor`. Raises :class:`~equimesh.errors.InputError` for fewer than 2 or more
    than 8 monitors, and for one that asks for a gradient map.
    """

    monitors: tuple[Monitor, ...]
    orthogonality: float | None = None
    """The largest angle of non-orthogonality of the mesh, in degrees; ``None`` for no bound."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "monitors", tuple(self.monitors))
        require_orthogonality(self)
        if not MIN_MONITORS <= len(self.monitors) <= MAX_MONITORS:
            raise InputError(
                f"{len(self.monitors)} monitors: an intersection is of {MIN_MONITORS} to {MAX_MONITORS}",
                field="monitors",
            )
        for number, monitor in enumerate(self.monitors):
            if map_of(monitor) != "lines":
                raise InputError(
                    "an intersection is equidistributed along mesh lines: leave out map = 'gradient' of its members",
                    field=f"monitors.{number}.map",
                )

    @property
    def u(self) -> Field | None:
        """The u of the first monitor that has one."""
        return next((monitor.u for monitor in self.monitors if monitor.u is not None), None)

    def metric(self, x: Array, y: Array) -> tuple[Array, Array, Array]:
        """``(m11, m12, m22)`` at physical points."""
        metric = self.monitors[0].metric(x, y)
        for monitor in self.monitors[1:]:
            metric = intersection(metric, monitor.metric(x, y))
        return metric

    def on(self, domain: Domain) -> Intersection:
        """The intersection of the monitors bound to ``domain``.

        Raises the :class:`~equimesh.errors.InputError` of the first one that cannot be; ``field`` begins with
        ``monitors.<number>``.
        """
        bound = tuple(_bound(monitor, domain, number) for number, monitor in enumerate(self.monitors))
        if all(new is old for new, old in zip(bound, self.monitors, strict=True)):
            return self
        return replace(self, monitors=bound)

    def weakened(self, strength: float) -> Intersection:
        """The intersection of the weakened monitors."""
        return replace(self, monitors=tuple(monitor.weakened(strength) for monitor in self.monitors))


def _bound(monitor: Monitor, domain: Domain, number: int) -> Monitor:
    try:
        return monitor.on(domain)
    except InputError as error:
        raise InputError(error.message, field=f"monitors.{number}.{error.field}".rstrip(".")) from error
