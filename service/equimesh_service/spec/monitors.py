"""Monitors of a spec and of a step: where their functions are, and the monitor of a step from that before."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, TypeAlias

from equimesh_schema.monitors import FUNCTIONS, REQUIRED_FUNCTIONS, Intersection
from equimesh_schema.sources import AnySource
from equimesh_service.problems.problem import problem_at


def sources_of(monitor: object, pointer: str = "/monitor") -> Iterator[tuple[str, AnySource]]:
    """Every function of a monitor, with its JSON pointer."""
    if isinstance(monitor, Intersection):
        for number, member in enumerate(monitor.monitors):
            yield from sources_of(member, f"{pointer}/monitors/{number}")
        return
    for name in FUNCTIONS:
        source = getattr(monitor, name, None)
        if source is not None:
            yield f"{pointer}/{name}", source


def with_samples(monitor: Mapping[str, Any], old: str, new: str) -> dict[str, Any]:
    """The JSON of a monitor that names the samples ``new`` wherever ``monitor`` names ``old``."""
    changed: dict[str, Any] = {name: {"samples": new} for name in FUNCTIONS if monitor.get(name) == {"samples": old}}
    if "monitors" in monitor:
        changed["monitors"] = [with_samples(member, old, new) for member in monitor["monitors"]]
    return {**monitor, **changed}


# The monitor of a step: that of the step before with other functions, or a new one.

Monitor: TypeAlias = Mapping[str, Any]
"""The JSON of a monitor."""

# The kinds that cannot do without u.
NEEDS_U = tuple(kind for kind, names in REQUIRED_FUNCTIONS.items() if "u" in names)
# The functions that other kinds cannot do without.
NEEDED = {kind: names for kind, names in REQUIRED_FUNCTIONS.items() if names and kind not in NEEDS_U}
_TOP = "/monitor"
_UNUSED = "u is not used: every monitor has a u of its own"
_MANY = (
    "the monitor of this sequence has several functions: send a monitor that says where each of them goes, such as"
    ' {"kind": "intersection", "monitors": [{"kind": "curvature", "u": {"field": "a"}}, …]}'
)
_NOT_U = (
    "the cells of a {kind} monitor follow {names}, not u: send a monitor with {them}, such as"
    ' {{"kind": "{kind}", "{first}": {{"field": "a"}}}}'
)


def members_of(monitor: Monitor) -> Iterator[tuple[str, Monitor]]:
    """The monitors of an intersection, or the monitor itself, with their JSON pointers."""
    members = monitor.get("monitors")
    if not isinstance(members, list):
        yield _TOP, monitor
        return
    for number, member in enumerate(members):
        if isinstance(member, Mapping):
            yield f"{_TOP}/monitors/{number}", member


def functions_of(monitor: Monitor) -> Iterator[tuple[str, Any]]:
    """Every function of a monitor that is given, with its JSON pointer."""
    for pointer, member in members_of(monitor):
        for name in FUNCTIONS:
            if member.get(name) is not None:
                yield f"{pointer}/{name}", member[name]


def with_functions(monitor: Monitor, found: Callable[[str, Any], Any]) -> dict[str, Any]:
    """The monitor with ``found(pointer, function)`` in place of every function."""

    def changed(member: Monitor, pointer: str) -> dict[str, Any]:
        given = {name: member[name] for name in FUNCTIONS if member.get(name) is not None}
        return {**member, **{name: found(f"{pointer}/{name}", source) for name, source in given.items()}}

    if not isinstance(monitor.get("monitors"), list):
        return changed(monitor, _TOP)
    members = [
        changed(member, f"{_TOP}/monitors/{number}") if isinstance(member, Mapping) else member
        for number, member in enumerate(monitor["monitors"])
    ]
    return {**monitor, "monitors": members}


def with_u(monitor: Monitor, u: Any) -> dict[str, Any]:
    """The monitor of the step before with another u; raises a 422 problem where it does not follow a single u."""
    kind = monitor["kind"]
    if kind in NEEDED:
        names = NEEDED[kind]
        them = "it" if len(names) == 1 else "them"
        raise problem_at("/u", _NOT_U.format(kind=kind, names=", ".join(names), them=them, first=names[0]))
    sources = [source for pointer, source in functions_of(monitor) if pointer.endswith("/u")]
    if not sources or any(source != sources[0] for source in sources):
        raise problem_at("/u", _MANY)
    return with_functions(monitor, lambda pointer, source: u if pointer.endswith("/u") else source)


def completed(monitor: Monitor, u: Any, before: Monitor) -> tuple[dict[str, Any], tuple[str, ...]]:
    """A new monitor with the functions that it lacks, and the JSON pointers of those that are ``u``.

    They are ``u`` where it is given, else those of the monitor ``before`` if it is of the same kind. Raises a 422
    problem for a u that has no place.
    """
    kind = str(monitor.get("kind", "auto"))
    if kind == "intersection":
        return (dict(monitor), ()) if u is None else _filled(monitor, u)
    made = dict(monitor)
    from_u: tuple[str, ...] = ()
    if u is not None:
        if made.get("u") is not None:
            raise problem_at("/u", _UNUSED)
        made, from_u = {**made, "u": u}, (f"{_TOP}/u",)
    elif kind in NEEDS_U and made.get("u") is None:
        old = [source for pointer, source in functions_of(before) if pointer.endswith("/u")]
        if old and all(source == old[0] for source in old):
            made["u"] = old[0]
    if before["kind"] == kind:
        made |= {name: before[name] for name in NEEDED.get(kind, ()) if made.get(name) is None}
    return made, from_u


def _filled(monitor: Monitor, u: Any) -> tuple[dict[str, Any], tuple[str, ...]]:
    """An intersection with ``u`` in the members that need one, or in the first member."""
    lacking = [
        pointer
        for pointer, member in members_of(monitor)
        if member.get("kind", "arc_length") in NEEDS_U and member.get("u") is None
    ]
    if not lacking:
        lacking = [pointer for pointer, member in members_of(monitor) if member.get("u") is None][:1]
        if lacking != [f"{_TOP}/monitors/0"]:
            raise problem_at("/u", _UNUSED)
    members = [
        {**member, "u": u} if f"{_TOP}/monitors/{number}" in lacking else member
        for number, member in enumerate(monitor["monitors"])
    ]
    return {**monitor, "monitors": members}, tuple(f"{pointer}/u" for pointer in lacking)
