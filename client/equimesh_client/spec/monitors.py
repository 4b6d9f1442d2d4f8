"""Monitors: the error that a mesh minimises or the metric that it equidistributes; dataclasses, and their JSON."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any, Literal, TypeAlias

from equimesh_client.errors import BadArgument

Json: TypeAlias = dict[str, Any]
Read: TypeAlias = Callable[[object], Json]
"""Returns the JSON of a function: an expression, arrays, a callable, a file or stored samples."""


FUNCTIONS = ("u", "rho", "m11", "m12", "m22")


class Later(Enum):
    """Stands for a u that a step of a sequence gives, or that of the step before: monitors without one leave it out."""

    U = "u"


Norm: TypeAlias = Literal["l2", "h1"]


@dataclass(frozen=True, kw_only=True)
class Auto:
    """The monitor with the smallest interpolation error of u among candidates, compared on a coarse grid. The default.

    ``norm`` is ``"l2"`` for the error of u, ``"h1"`` for that of its gradient. ``u`` replaces that of `generate`. The
    certificate lists the candidates in ``comparison``. ``purpose`` is ``"finite_volume"`` for a mesh with a small error
    of a code with cell-centred unknowns. ``orthogonality`` bounds the angle in degrees between the normal of a face and
    the line of its two cell centres; None for no bound.
    """

    norm: Norm = "l2"
    u: object = None
    purpose: Literal["finite_volume"] | None = None
    orthogonality: float | None = None

    def json(self, read: Read, u: object) -> Json:
        """The JSON of the monitor; ``u`` is that of `generate`."""
        monitor = {"kind": "auto", **_u_json(read, self.u, u, required_by="Auto"), "norm": self.norm}
        if self.purpose is not None:
            monitor["for"] = self.purpose
        return _with_bound(monitor, self.orthogonality)


@dataclass(frozen=True, kw_only=True)
class LeastError:
    """The nodes where the measured error of interpolating u is least.

    ``norm`` and ``u`` as in :class:`Auto`. ``distortion`` and ``smoothness`` are positive weights of how far cells are
    deformed, and how unevenly neighbours: lower them for a smaller error, raise them for cells nearer to squares. The
    error is that on the ``cells`` of the file. ``rectilinear`` keeps lines straight: x depends on xi alone, y on eta
    alone. ``orthogonality`` as in :class:`Auto`.
    """

    norm: Norm = "l2"
    distortion: float = 0.5
    smoothness: float = 1.0
    u: object = None
    rectilinear: bool = False
    orthogonality: float | None = None

    def json(self, read: Read, u: object) -> Json:
        """The JSON of the monitor; ``u`` is that of `generate`."""
        u_json = _u_json(read, self.u, u, required_by="LeastError")
        weights = {"distortion": self.distortion, "smoothness": self.smoothness}
        monitor = {"kind": "least_error", **u_json, "norm": self.norm, **weights}
        if self.rectilinear:
            monitor["rectilinear"] = True
        return _with_bound(monitor, self.orthogonality)


@dataclass(frozen=True, kw_only=True)
class NodalSolution:
    """The next mesh of a solver: one round of :meth:`Client.adapt`, which calls it for you.

    ``u`` are the values at the nodes of the mesh before, as ``(x, y, values)`` of one shape ``(n_xi, n_eta)``; it
    replaces that of `generate`. ``norm`` and ``orthogonality`` as in :class:`Auto`. The certificate has the
    estimated error of the values.
    """

    norm: Norm = "l2"
    u: object = None
    orthogonality: float | None = None

    def json(self, read: Read, u: object) -> Json:
        """The JSON of the monitor; ``u`` is that of `generate`."""
        u_json = _u_json(read, self.u, u, required_by="NodalSolution")
        return _with_bound({"kind": "nodal_solution", **u_json, "norm": self.norm}, self.orthogonality)


@dataclass(frozen=True, kw_only=True)
class ArcLength:
    """Equal shares of the arc length of u: small cells where u is steep. The paper's.

    ``a`` in [0, 1] is the strength, ``b`` >= 0 the damping where u is steep. ``smoothing`` in [0, 0.25] is the radius
    over which the metric is averaged, in units of the domain's shorter extent. ``u`` replaces that of `generate`.
    ``scaled`` takes u in units of its range and lengths in units of the domain's size, so that the mesh does not depend
    on units. With False they are taken as they are given, as in the paper. ``orthogonality`` as in :class:`Auto`.
    """

    a: float = 0.7
    b: float = 0.05
    scaled: bool = True
    smoothing: float = 0.0
    u: object = None
    orthogonality: float | None = None

    def json(self, read: Read, u: object) -> Json:
        """The JSON of the monitor; ``u`` is that of `generate`."""
        u_json = _u_json(read, self.u, u, required_by="ArcLength")
        monitor = {"kind": "arc_length", **u_json, "a": self.a, "b": self.b}
        if not self.scaled:
            monitor["scaled"] = False
        return _with_smoothing(monitor, self.smoothing, self.orthogonality)


@dataclass(frozen=True, kw_only=True)
class Curvature:
    """Small cells where u is curved, for a small interpolation error.

    ``norm`` is ``"l2"`` for the error of u, ``"h1"`` for that of its gradient. ``isotropic`` does not stretch cells.
    ``smoothing``, ``orthogonality`` and ``u`` as in :class:`ArcLength`.
    """

    norm: Norm = "l2"
    isotropic: bool = False
    smoothing: float = 0.0
    u: object = None
    orthogonality: float | None = None

    def json(self, read: Read, u: object) -> Json:
        """The JSON of the monitor; ``u`` is that of `generate`."""
        u_json = _u_json(read, self.u, u, required_by="Curvature")
        monitor = {"kind": "curvature", **u_json, "norm": self.norm, "isotropic": self.isotropic}
        return _with_smoothing(monitor, self.smoothing, self.orthogonality)


@dataclass(frozen=True)
class Weight:
    """Small cells where ``rho`` > 0 is large. The interpolation error is that of ``u``, or of u of `generate`.

    ``map`` is ``"lines"`` for equal metric lengths along each mesh line, ``"gradient"`` for equal rho times area of the
    cells by a map that is a gradient: smoother meshes, also where rho is steep, and no subdomains.
    """

    rho: object
    smoothing: float = 0.0
    u: object = None
    map: Literal["lines", "gradient"] = "lines"
    orthogonality: float | None = None

    def json(self, read: Read, u: object) -> Json:
        """The JSON of the monitor; ``u`` is that of `generate`."""
        monitor = {"kind": "weight", "rho": read(self.rho), **_u_json(read, self.u, u), "map": self.map}
        return _with_smoothing(monitor, self.smoothing, self.orthogonality)


@dataclass(frozen=True)
class Tensor:
    """The metric ``m11 dx^2 + 2 m12 dx dy + m22 dy^2``, positive definite. ``u`` as in :class:`Weight`."""

    m11: object
    m12: object
    m22: object
    smoothing: float = 0.0
    u: object = None
    orthogonality: float | None = None

    def json(self, read: Read, u: object) -> Json:
        """The JSON of the monitor; ``u`` is that of `generate`."""
        entries = {name: read(getattr(self, name)) for name in ("m11", "m12", "m22")}
        monitor = {"kind": "tensor", **entries, **_u_json(read, self.u, u)}
        return _with_smoothing(monitor, self.smoothing, self.orthogonality)


PlainMonitor: TypeAlias = ArcLength | Curvature | Weight | Tensor


@dataclass(frozen=True)
class Intersection:
    """Cells as small as each of 2 to 8 ``monitors`` requires. Those that lack a u take that of `generate`."""

    monitors: Sequence[PlainMonitor | Mapping[str, Any]]
    smoothing: float = 0.0
    orthogonality: float | None = None

    def json(self, read: Read, u: object) -> Json:
        """The JSON of the monitor; ``u`` is that of `generate`."""
        if not isinstance(self.monitors, Sequence):
            raise BadArgument("an Intersection takes a list of monitors")
        members: list[Json] = []
        is_used = False  # the first u is the function for the interpolation error
        for member in self.monitors:
            needs_u = isinstance(member, ArcLength | Curvature) and member.u is None
            members.append(_json(member, read, u if needs_u else None))
            is_used = is_used or needs_u
        if u is not None and u is not Later.U and not is_used:
            if not members or "u" in members[0]:
                raise BadArgument("u is not used: the first monitor of the intersection has its own u")
            members[0]["u"] = read(u)
        return _with_smoothing({"kind": "intersection", "monitors": members}, self.smoothing, self.orthogonality)


Monitor: TypeAlias = Auto | LeastError | NodalSolution | PlainMonitor | Intersection


def monitor_json(monitor: Monitor | Mapping[str, Any], read: Read, u: object) -> Json:
    """The JSON of a monitor. A mapping is such JSON already; ``u`` is added where it has none, unless it comes later.

    Raises :class:`BadArgument` for another object, and for a u that is missing or given twice.
    """
    if isinstance(monitor, Auto | LeastError | NodalSolution | Intersection):
        return monitor.json(read, u)
    return _json(monitor, read, u)


def _json(monitor: object, read: Read, u: object) -> Json:
    if isinstance(monitor, Mapping):
        if u is Later.U:
            return _read_arrays(monitor, read)
        if u is not None and "u" in monitor:
            raise BadArgument("u is given twice: alone, and in the monitor")
        return {**monitor, **({} if u is None else {"u": read(u)})}
    if isinstance(monitor, PlainMonitor):
        return monitor.json(read, u)
    raise BadArgument(
        "a monitor is an ArcLength, Curvature, Weight or Tensor, or at the top an Auto, a LeastError, an"
        f" NodalSolution or an Intersection; not {monitor!r:.80}"
    )


def _u_json(read: Read, own: object, u: object, *, required_by: str = "") -> Json:
    """The ``u`` of a monitor, its ``own`` or that of `generate`; empty where neither is given and none is needed."""
    if u is Later.U:
        return {} if own is None else {"u": read(own)}
    if own is not None and u is not None:
        raise BadArgument("u is given twice: alone, and in the monitor")
    function = u if own is None else own
    if function is None and required_by:
        raise BadArgument(f"the monitor {required_by} needs a function u: give u")
    return {} if function is None else {"u": read(function)}


def _read_arrays(monitor: Mapping[str, Any], read: Read) -> Json:
    """The JSON of a monitor that is JSON but for its functions, which may be arrays and callables."""
    made = dict(monitor)
    for name in FUNCTIONS:
        if name in made and not isinstance(made[name], Mapping | str | None):
            made[name] = read(made[name])
    if isinstance(made.get("monitors"), Sequence):
        made["monitors"] = [_json(member, read, Later.U) for member in made["monitors"]]
    return made


def _with_smoothing(monitor: Json, smoothing: float, orthogonality: float | None) -> Json:
    return _with_bound({**monitor, "smoothing": smoothing} if smoothing else monitor, orthogonality)


def _with_bound(monitor: Json, orthogonality: float | None) -> Json:
    """The monitor with its bound; the key is left out where there is none, for services that do not know it."""
    return monitor if orthogonality is None else {**monitor, "orthogonality": orthogonality}
