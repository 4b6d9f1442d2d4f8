"""From what a time-stepper gives, u or a monitor, to the monitor of the next mesh."""

from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from typing import Any, TypeGuard

import numpy as np

from equimesh.errors import InputError
from equimesh.fields.field import Field, require_field
from equimesh.fields.nodal_field import NodalField
from equimesh.meshes.mesh import Mesh
from equimesh.monitors.auto import Auto
from equimesh.monitors.curvature import Curvature
from equimesh.monitors.intersection import Intersection
from equimesh.monitors.least_error import LeastError
from equimesh.monitors.monitor import Monitor
from equimesh.monitors.smoothed import Smoothed

# Radius of the smoothed curvature that stands for least error, in units of the domain's shorter extent.
SMOOTHING = 0.02


def monitor_for(template: Monitor, given: Any, mesh: Mesh) -> Monitor:
    """The monitor of a step, with the settings of ``template``.

    ``given`` is a monitor, which is returned as it is; u as an array of shape ``(n_xi, n_eta)`` at the nodes of
    ``mesh``, as a field or as a text; or several of these in a mapping or a sequence. Of several u a monitor each is
    made, and these are intersected: cells are as small as any of them requests. In an intersection
    the smoothed curvature stands for least error and auto, which have no metric of their own.

    Raises :class:`~equimesh.errors.InputError` for a template without u, and for values that cannot be used.
    """
    if isinstance(given, type):
        raise InputError(f"u is the class {given.__name__}: give a monitor, such as LeastError(u=...)", field="u")
    if callable(getattr(given, "metric", None)):
        monitor: Monitor = given
        return monitor
    if isinstance(given, Mapping):
        return _several(template, [(f"u.{name}", part) for name, part in given.items()], mesh)
    if isinstance(given, Sequence) and not isinstance(given, str) and any(_is_whole(part) for part in given):
        return _several(template, [(f"u.{number}", part) for number, part in enumerate(given)], mesh)
    return with_u(template, field_of(given, mesh, "u"))


def field_of(given: Any, mesh: Mesh, name: str) -> Field:
    """A function of x and y: ``given`` itself, the expression of a text, or nodal values as a field."""
    if isinstance(given, str) or callable(getattr(given, "evaluate", None)):
        return require_field(given, name)
    return NodalField(mesh=mesh, values=given)


def with_u(monitor: Monitor, u: Field) -> Monitor:
    """The monitor with another u: in its member where it is smoothed, in all members of an intersection."""
    names = {part.name for part in fields(monitor)} if _is_dataclass(monitor) else set()
    if isinstance(monitor, Intersection):
        return replace(monitor, monitors=tuple(with_u(member, u) for member in monitor.monitors))
    if "monitor" in names:
        inner: Any = monitor
        return _replaced(monitor, "monitor", with_u(inner.monitor, u))
    if "rho" in names:  # of a weight, the monitor is u itself
        return _replaced(monitor, "rho", u)
    if "u" in names and "m11" not in names:
        return _replaced(monitor, "u", u)
    raise InputError(
        f"a {type(monitor).__name__} follows no function u: give each step a monitor in its place", field="u"
    )


def _several(template: Monitor, given: Sequence[tuple[str, Any]], mesh: Mesh) -> Monitor:
    if len(given) == 1:
        return monitor_for(template, given[0][1], mesh)
    monitors = [
        part if callable(getattr(part, "metric", None)) else with_u(_metric(template), field_of(part, mesh, name))
        for name, part in given
    ]
    return Intersection(monitors=tuple(monitors))


def _metric(template: Monitor) -> Monitor:
    """The template, or a metric that stands for it."""
    if isinstance(template, LeastError | Auto):
        return Smoothed(monitor=Curvature(u=template.u, norm=template.norm), radius=SMOOTHING)
    return template


def _is_whole(part: Any) -> bool:
    """Whether this is a u or a monitor by itself, and no row of an array."""
    return (
        isinstance(part, str)
        or any(callable(getattr(part, n, None)) for n in ("metric", "evaluate"))
        or (np.ndim(part) == 2)
    )


def _is_dataclass(monitor: object) -> TypeGuard[Any]:
    return is_dataclass(monitor)


def _replaced(monitor: Any, name: str, value: object) -> Monitor:
    other: Monitor = replace(monitor, **{name: value})
    return other
