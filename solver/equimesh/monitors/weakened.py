"""A monitor that adapts less than another."""

from __future__ import annotations

from dataclasses import dataclass, replace

from equimesh.domains.domain import Domain
from equimesh.fields.field import Field
from equimesh.monitors.monitor import Monitor, map_of, require_strength
from equimesh.numerics.spd import power
from equimesh.numerics.types import Array


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
