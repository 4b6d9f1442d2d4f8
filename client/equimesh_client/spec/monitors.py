"""Monitors as JSON: their functions are read, and the u of a request gets its place."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from enum import Enum
from typing import Any, TypeAlias

from equimesh_client.errors import BadArgument
from equimesh_schema.document import without_usual
from equimesh_schema.monitors import FUNCTIONS, ArcLength, Curvature, Intersection, MonitorDocument, PlainMonitor
from equimesh_schema.monitors import AnyMonitor as Monitor
from equimesh_schema.sources import functions_of

Json: TypeAlias = dict[str, Any]
Read: TypeAlias = Callable[[object], Json]
"""Returns the JSON of a function: an expression, arrays, a callable, a file or stored samples."""


class Later(Enum):
    """Stands for a u that a step of a sequence gives, or that of the step before: monitors without one leave it out."""

    U = "u"


def monitor_json(monitor: Monitor | Mapping[str, Any], read: Read, u: object) -> Json:
    """The JSON of a monitor. A mapping is such JSON already; ``u`` is added where it has none, unless it comes later.

    Raises :class:`BadArgument` for another object, and for a u that is missing or given twice.
    """
    if isinstance(monitor, Intersection):
        return _settings(monitor, {"monitors": _members(monitor, read, u)})
    if isinstance(monitor, MonitorDocument):
        return _of_fields(monitor, read, u)
    return _member(monitor, read, u)


def _member(monitor: object, read: Read, u: object) -> Json:
    if isinstance(monitor, Mapping):
        if u is Later.U:
            return _read_arrays(monitor, read)
        if u is not None and "u" in monitor:
            raise BadArgument("u is given twice: alone, and in the monitor")
        return {**monitor, **({} if u is None else {"u": read(u)})}
    if isinstance(monitor, PlainMonitor):
        return _of_fields(monitor, read, u)
    raise BadArgument(
        "a monitor is an ArcLength, Curvature, Weight or Tensor, or at the top an Auto, a LeastError, an"
        f" NodalSolution or an Intersection; not {monitor!r:.80}"
    )


def _members(monitor: Intersection, read: Read, u: object) -> list[Json]:
    """The JSON of the members of an intersection; those that lack a u take that of the request."""
    if not isinstance(monitor.monitors, Sequence):
        raise BadArgument("an Intersection takes a list of monitors")
    members: list[Json] = []
    is_used = False  # the first u is the function for the interpolation error
    for member in monitor.monitors:
        needs_u = isinstance(member, ArcLength | Curvature) and member.u is None
        members.append(_member(member, read, u if needs_u else None))
        is_used = is_used or needs_u
    if u is not None and u is not Later.U and not is_used:
        if not members or "u" in members[0]:
            raise BadArgument("u is not used: the first monitor of the intersection has its own u")
        members[0]["u"] = read(u)
    return members


def _of_fields(monitor: MonitorDocument, read: Read, u: object) -> Json:
    """The JSON of a monitor by its fields."""
    found: Json = {}
    for name in functions_of(type(monitor)):
        if name == "u":
            found |= _u_json(read, monitor, u)
        else:
            found[name] = read(getattr(monitor, name))
    return _settings(monitor, found)


def _settings(monitor: MonitorDocument, found: Json) -> Json:
    """The JSON of a monitor from what is ``found``; some keys are left out, for services that do not know them."""
    functions = functions_of(type(monitor))
    values: dict[str, Any] = {name: found.get(name) for name in (*functions, *found)}
    plain = without_usual(replace(monitor, **values))
    return {key: value for key, value in plain.items() if key in found or key not in functions}


def _u_json(read: Read, monitor: MonitorDocument, u: object) -> Json:
    """The ``u`` of a monitor, its own or that of `generate`; empty where neither is given and none is needed."""
    own = getattr(monitor, "u", None)
    if u is Later.U:
        return {} if own is None else {"u": read(own)}
    if own is not None and u is not None:
        raise BadArgument("u is given twice: alone, and in the monitor")
    function = u if own is None else own
    if function is None and "u" in monitor.NEEDED:
        raise BadArgument(f"the monitor {type(monitor).__name__} needs a function u: give u")
    return {} if function is None else {"u": read(function)}


def _read_arrays(monitor: Mapping[str, Any], read: Read) -> Json:
    """The JSON of a monitor that is JSON but for its functions, which may be arrays and callables."""
    made = dict(monitor)
    for name in FUNCTIONS:
        if name in made and not isinstance(made[name], Mapping | str | None):
            made[name] = read(made[name])
    if isinstance(made.get("monitors"), Sequence):
        made["monitors"] = [_member(member, read, Later.U) for member in made["monitors"]]
    return made
