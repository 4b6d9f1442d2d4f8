"""Monitors: what a mesh is to equidistribute. Small dataclasses that the HTTP interface takes as JSON."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

from equimesh_client.errors import BadArgument

Json: TypeAlias = dict[str, Any]
Read: TypeAlias = Callable[[object], Json]
"""Makes the JSON of a function: an expression, arrays, a callable, a file or stored samples."""


@dataclass(frozen=True, kw_only=True)
class ArcLength:
    """Equal shares of the arc length of u: small cells where u is steep. The default, and the paper's.

    ``a`` in [0, 1] is the strength, ``b`` >= 0 the damping where u is steep. ``smoothing`` in [0, 0.25] is the radius
    over which the metric is averaged, in units of the domain's shorter extent. ``u`` in place of that of `generate`.
    """

    a: float = 0.7
    b: float = 0.05
    smoothing: float = 0.0
    u: object = None

    def json(self, read: Read, u: object) -> Json:
        """The monitor as the HTTP interface writes it; ``u`` is that of `generate`."""
        given = read(_needed("ArcLength", self.u, u))
        return _smoothed({"kind": "arc_length", "u": given, "a": self.a, "b": self.b}, self.smoothing)


@dataclass(frozen=True, kw_only=True)
class Curvature:
    """Small cells where u is curved: for the least interpolation error.

    ``norm`` ``"l2"`` is for the error of u, ``"h1"`` for that of its gradient. ``isotropic`` does not stretch cells.
    ``smoothing`` and ``u`` as in :class:`ArcLength`.
    """

    norm: Literal["l2", "h1"] = "l2"
    isotropic: bool = False
    smoothing: float = 0.0
    u: object = None

    def json(self, read: Read, u: object) -> Json:
        """The monitor as the HTTP interface writes it; ``u`` is that of `generate`."""
        given = read(_needed("Curvature", self.u, u))
        monitor = {"kind": "curvature", "u": given, "norm": self.norm, "isotropic": self.isotropic}
        return _smoothed(monitor, self.smoothing)


@dataclass(frozen=True)
class Weight:
    """Small cells where ``rho`` > 0 is large. ``u``, or that of `generate`, is what interpolation is measured with."""

    rho: object
    smoothing: float = 0.0
    u: object = None

    def json(self, read: Read, u: object) -> Json:
        """The monitor as the HTTP interface writes it; ``u`` is that of `generate`."""
        return _smoothed({"kind": "weight", "rho": read(self.rho), **_optional(read, self.u, u)}, self.smoothing)


@dataclass(frozen=True)
class Tensor:
    """The metric ``m11 dx^2 + 2 m12 dx dy + m22 dy^2``, positive definite. ``u`` as in :class:`Weight`."""

    m11: object
    m12: object
    m22: object
    smoothing: float = 0.0
    u: object = None

    def json(self, read: Read, u: object) -> Json:
        """The monitor as the HTTP interface writes it; ``u`` is that of `generate`."""
        entries = {name: read(getattr(self, name)) for name in ("m11", "m12", "m22")}
        return _smoothed({"kind": "tensor", **entries, **_optional(read, self.u, u)}, self.smoothing)


@dataclass(frozen=True)
class Intersection:
    """Cells as small as each of 2 to 8 ``monitors`` requires. Those that lack a u take that of `generate`."""

    monitors: Sequence[ArcLength | Curvature | Weight | Tensor | Mapping[str, Any]]
    smoothing: float = 0.0

    def json(self, read: Read, u: object) -> Json:
        """The monitor as the HTTP interface writes it; ``u`` is that of `generate`."""
        if not isinstance(self.monitors, Sequence):
            raise BadArgument("an Intersection is made of a list of monitors")
        members: list[Json] = []
        taken = False  # the first that has a u is what interpolation is measured with
        for member in self.monitors:
            wants = isinstance(member, ArcLength | Curvature) and member.u is None
            members.append(_json(member, read, u if wants else None))
            taken = taken or wants
        if u is not None and not taken:
            if not members or "u" in members[0]:
                raise BadArgument("u is not used: the first monitor of the intersection has its own u")
            members[0]["u"] = read(u)
        return _smoothed({"kind": "intersection", "monitors": members}, self.smoothing)


Monitor: TypeAlias = ArcLength | Curvature | Weight | Tensor | Intersection


def monitor_json(monitor: Monitor | Mapping[str, Any], read: Read, u: object) -> Json:
    """The monitor as the HTTP interface writes it. A mapping is taken to be that, but for a u that it lacks.

    Raises :class:`BadArgument` for what is no monitor, and for a u that is missing or given twice.
    """
    if isinstance(monitor, Intersection):
        return monitor.json(read, u)
    return _json(monitor, read, u)


def _json(monitor: object, read: Read, u: object) -> Json:
    if isinstance(monitor, Mapping):
        if u is not None and "u" in monitor:
            raise BadArgument("u is given twice: alone, and in the monitor")
        return {**monitor, **({} if u is None else {"u": read(u)})}
    if isinstance(monitor, ArcLength | Curvature | Weight | Tensor):
        return monitor.json(read, u)
    raise BadArgument(
        f"a monitor is an ArcLength, Curvature, Weight or Tensor, or at the top an Intersection; not {monitor!r:.80}"
    )


def _chosen(own: object, u: object) -> object:
    if own is not None and u is not None:
        raise BadArgument("u is given twice: alone, and in the monitor")
    return u if own is None else own


def _needed(name: str, own: object, u: object) -> object:
    chosen = _chosen(own, u)
    if chosen is None:
        raise BadArgument(f"the monitor {name} is made of a function u: give u")
    return chosen


def _optional(read: Read, own: object, u: object) -> Json:
    chosen = _chosen(own, u)
    return {} if chosen is None else {"u": read(chosen)}


def _smoothed(monitor: Json, smoothing: float) -> Json:
    return {**monitor, "smoothing": smoothing} if smoothing else monitor
