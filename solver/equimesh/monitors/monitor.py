"""Monitor functions: the metric tensor that a mesh is to equidistribute."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

from equimesh.domains.domain import Domain
from equimesh.errors import InputError
from equimesh.fields.expression import Field
from equimesh.numerics.spd import power
from equimesh.numerics.types import Array

MAX_ORTHOGONALITY = 90.0
"""The largest bound of the angle of non-orthogonality, in degrees: it bounds nothing."""


class Monitor(Protocol):
    """A symmetric positive definite tensor M(x, y) of the physical plane; a mesh equidistributes lengths in M.

    Monitors can be pickled: a bound one gives the same metric in another process.
    :func:`equimesh.testing.check_monitor` checks what is promised here.
    """

    @property
    def u(self) -> Field | None:
        """The function whose interpolation is measured and which mesh files carry, if there is one."""
        ...

    def metric(self, x: Array, y: Array) -> tuple[Array, Array, Array]:
        """``(m11, m12, m22)`` at physical points of any shape; dimensionless, exact.

        The value at a point does not depend on the other points, and ``x`` and ``y`` are not written into. It is also
        evaluated slightly (1e-5 of its size) outside the domain. Values may be non-finite where the data are.
        """
        ...

    def on(self, domain: Domain) -> Monitor:
        """The monitor bound to ``domain``: checked there, with what depends on the whole domain computed.

        Binding a bound monitor again changes nothing. Raises :class:`~equimesh.errors.InputError` where it cannot be
        used on it.
        """
        ...

    def weakened(self, strength: float) -> Monitor:
        """A monitor that adapts less, for ``strength`` in [0, 1]: 0 adapts to nothing, 1 is the monitor itself.

        The metric for 0 is constant. It depends continuously on ``strength``. A bound monitor gives a bound one.
        """
        ...


@runtime_checkable
class OfDerivatives(Protocol):
    """A bound monitor whose metric at a point depends on u and its derivatives there, and on nothing else.

    Who needs both the metric and u evaluates u once, for both.
    """

    @property
    def order(self) -> int:
        """The order of the derivatives that the metric needs."""
        ...

    def metric_of(self, *derivatives: Array) -> tuple[Array, Array, Array]:
        """:meth:`Monitor.metric` at points where u and its derivatives up to :attr:`order` are these."""
        ...


def map_of(monitor: Monitor) -> str:
    """How cells get equal shares of the metric: ``"gradient"`` for a gradient map, otherwise ``"lines"``."""
    return str(getattr(monitor, "map", "lines"))


def orthogonality_of(monitor: Monitor) -> float | None:
    """The largest angle of non-orthogonality that a mesh may have, in degrees; ``None`` where there is no bound.

    Of a monitor that is made of others it is the smallest of all bounds.
    """
    inner = [monitor.monitor] if hasattr(monitor, "monitor") else getattr(monitor, "monitors", ())
    bounds = [getattr(monitor, "orthogonality", None), *(orthogonality_of(one) for one in inner)]
    return min((bound for bound in bounds if bound is not None), default=None)


def require_orthogonality(angle: object) -> None:
    """Raises :class:`~equimesh.errors.InputError` for a bound that is neither ``None`` nor an angle in (0, 90]."""
    if angle is None:
        return
    if not isinstance(angle, int | float) or isinstance(angle, bool) or not 0.0 < angle <= MAX_ORTHOGONALITY:
        raise InputError(
            f"orthogonality = {angle!r}: the largest angle of non-orthogonality is one in degrees, over 0 and at most"
            f" {MAX_ORTHOGONALITY:g}; 50 suits most finite-volume codes",
            field="orthogonality",
        )


def require_lines(monitor: Monitor) -> None:
    """Raises :class:`~equimesh.errors.InputError` for a gradient map where subdomains are requested."""
    if map_of(monitor) != "lines":
        raise InputError(
            "a gradient map is not made of subdomains: leave out schwarz, or take map = 'lines'", field="schwarz"
        )


def require_strength(strength: float) -> float:
    """``strength`` if it lies in [0, 1]; otherwise raises :class:`~equimesh.errors.InputError`."""
    if not 0.0 <= strength <= 1.0:
        raise InputError(f"strength = {strength}: the strength of a monitor lies in [0, 1]", field="strength")
    return float(strength)


# A monitor that adapts less than another.


@dataclass(frozen=True, kw_only=True)
class Weakened:
    """The metric of ``monitor`` to the matrix power ``strength`` in [0, 1]: 0 gives the identity.

    The directions stay, the ratio of the metric lengths of two vectors shrinks. A
    :class:`~equimesh.monitors.monitor.Monitor`.
    """

    monitor: Monitor
    strength: float

    def __post_init__(self) -> None:
        require_strength(self.strength)

    @property
    def u(self) -> Field | None:
        """The u of the monitor."""
        return self.monitor.u

    @property
    def map(self) -> str:
        """The map of the monitor."""
        return map_of(self.monitor)

    def metric(self, x: Array, y: Array) -> tuple[Array, Array, Array]:
        """``(m11, m12, m22)`` of ``M**strength`` at physical points."""
        return power(self.monitor.metric(x, y), self.strength)

    def on(self, domain: Domain) -> Weakened:
        """The monitor bound to ``domain``, as weak as this one."""
        bound = self.monitor.on(domain)
        return self if bound is self.monitor else replace(self, monitor=bound)

    def weakened(self, strength: float) -> Weakened:
        """Weaker again: the strengths multiply."""
        return replace(self, strength=self.strength * require_strength(strength))


def weaken(monitor: Monitor, strength: float) -> Monitor:
    """``monitor`` with its metric to the power ``strength``; itself for 1."""
    return monitor if require_strength(strength) == 1.0 else Weakened(monitor=monitor, strength=float(strength))
