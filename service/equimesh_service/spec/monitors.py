"""Monitors in a spec: where their functions are."""

from collections.abc import Iterator, Mapping
from typing import Any

from equimesh_schema.monitors import FUNCTIONS, MONITORS, Intersection
from equimesh_schema.sources import AnySource

USES = {kind: monitor.USE for kind, monitor in MONITORS.documents.items()}


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
