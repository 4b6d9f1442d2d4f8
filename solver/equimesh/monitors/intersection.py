"""Several monitors at once."""

from __future__ import annotations

from dataclasses import dataclass, replace

from equimesh.domains.domain import Domain
from equimesh.errors import InputError
from equimesh.fields.field import Field
from equimesh.monitors.monitor import Monitor, map_of, require_orthogonality
from equimesh.numerics.spd import intersection
from equimesh.numerics.types import Array

MIN_MONITORS = 2
MAX_MONITORS = 8


@dataclass(frozen=True, kw_only=True)
class Intersection:
    """The metric in which no length is less than in any of ``monitors``: cells are as small as each of them requests.

    By simultaneous reduction of two metrics at a time (:func:`equimesh.numerics.spd.intersection`), as in P. J. Frey
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
        require_orthogonality(self.orthogonality)
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
