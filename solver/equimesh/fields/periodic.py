"""Functions that repeat themselves, with the rectangle on which they are given."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from equimesh.domains.domain import Domain, Interval, Rectangle, closed_of
from equimesh.errors import InputError
from equimesh.fields.expression import Field
from equimesh.fields.nodal_field import HermiteField, NodalField
from equimesh.fields.on_domain import OnDomain
from equimesh.fields.samples import GridSamples
from equimesh.fields.scattered_samples import ScatteredSamples
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.types import Array, Pair

T = TypeVar("T", bound=Any)

FIELDS = ("u", "rho", "m11", "m12", "m22")
"""The names of the functions of a monitor."""
CHECK_POINTS = 65
"""Points of a seam at which a function must have the same value on both of its sides."""
RANGE_POINTS = 33
"""Points a direction at which the range of a function is measured."""
MAX_JUMP = 1e-6
"""The largest difference of the values there, as a share of the range of the function."""
MAX_ROUNDING = 1e-10
"""The largest difference that is rounding, as a share of the largest value."""
MAX_TILED = 8
"""Samples that are repeated beyond a side: the spline then joins the two sides smoothly."""
MAX_TILED_SHARE = 0.45
"""The largest distance from a side, as a share of the period, at which samples are repeated."""
SEAM_SHARE = 1e-9
"""Samples so near to the second copy of a seam, as a share of the period, are those of the first one."""


@dataclass(frozen=True, kw_only=True)
class Periodic:
    """``field`` of the points of a periodic ``domain``, continued to the whole plane.

    Implements :class:`~equimesh.fields.expression.Field`. Points of the rectangle keep their values to the last bit.
    """

    field: Field
    domain: Rectangle

    def evaluate(self, x: Array, y: Array, order: int = 0) -> tuple[Array, ...]:
        """u and its partial derivatives up to ``order``: see ``Field.evaluate``."""
        return self.field.evaluate(*within(self.domain, x, y), order)


def within(domain: Domain, x: Array, y: Array) -> Pair:
    """The points of a periodic rectangle that are the same as ``x``, ``y``; the points themselves elsewhere."""
    if not isinstance(domain, Rectangle):
        return x, y
    along_x, along_y = domain.closed_lines
    return _wrapped(x, domain.x) if along_x else x, _wrapped(y, domain.y) if along_y else y


def _wrapped(q: Array, ends: Interval) -> Array:
    period = ends[1] - ends[0]
    outside = (q < ends[0]) | (q > ends[1])
    if not outside.any():
        return q
    moved, far = np.array(q), q[outside]  # few nodes are beyond a seam
    moved[outside] = far - period * np.floor((far - ends[0]) / period)
    return moved


def repeated(monitor: T, domain: Domain) -> T:
    """The monitor with functions that repeat themselves as ``domain`` does; itself on a domain without closed lines.

    Raises :class:`~equimesh.errors.InputError` for a function that differs on the two sides of a seam.
    """
    if not any(closed_of(domain)):
        return monitor
    changed: dict[str, Any] = {}
    for name in FIELDS:
        if name in getattr(monitor, "__dataclass_fields__", ()):
            field = getattr(monitor, name)
            changed[name] = None if field is None else repeated_field(field, domain, name)
    if hasattr(monitor, "monitor"):
        changed["monitor"] = repeated(monitor.monitor, domain)
    if hasattr(monitor, "monitors"):
        changed["monitors"] = tuple(repeated(one, domain) for one in monitor.monitors)
    changed = {name: value for name, value in changed.items() if not _is_same(value, getattr(monitor, name))}
    return replace(monitor, **changed) if changed else monitor


def _is_same(one: Any, other: Any) -> bool:
    if isinstance(one, tuple):
        return all(a is b for a, b in zip(one, other, strict=True))
    return one is other


def repeated_field(field: Field, domain: Domain, name: str) -> Field:
    """A function of a domain as one that repeats itself; samples are joined smoothly across the seams."""
    if isinstance(field, Periodic):
        return field
    if isinstance(domain, Rectangle):
        if isinstance(field, NodalField | HermiteField):
            _require_repeated_nodes(field, domain, name)
        else:
            _require_repeated(field, domain, name)
        return Periodic(field=_tiled(field, (domain.x, domain.y), domain.closed_lines), domain=domain)
    if isinstance(field, OnDomain):
        unit = (0.0, 1.0)
        reference = _tiled(field.reference, (unit, unit), closed_of(domain))
        return field if reference is field.reference else replace(field, reference=reference)
    return field


def _require_repeated(field: Field, domain: Rectangle, name: str) -> None:
    """Refuse a function with different values on the two sides of a seam."""
    ends, along = (domain.x, domain.y), np.linspace(0.0, 1.0, CHECK_POINTS)
    allowed = _allowed_jump(field, domain)
    for axis, closed in enumerate(domain.closed_lines):
        if not closed:
            continue
        low, high = ends[1 - axis]
        t = low + (high - low) * along
        points = [(np.full(t.shape, end), t) if axis == 0 else (t, np.full(t.shape, end)) for end in ends[axis]]
        with np.errstate(all="ignore"):
            one, other = (field.evaluate(*at)[0] for at in points)
            jump = np.abs(one - other)
        k = int(np.argmax(jump)) if np.isfinite(jump).all() else 0
        if jump[k] > allowed:
            sides = f"{'xy'[axis]} = {ends[axis][0]:g} and {ends[axis][1]:g}"
            raise InputError(
                f"the rectangle is periodic in {'xy'[axis]}, but {name} is not: on its two sides, {sides}, {name} is"
                f" {one[k]:.6g} and {other[k]:.6g} where {'yx'[axis]} = {t[k]:.6g}; take a {name} that repeats itself,"
                " or leave periodic out",
                field="domain.periodic",
            )


def _require_repeated_nodes(field: NodalField | HermiteField, domain: Rectangle, name: str) -> None:
    """Refuse values at nodes that differ at the two copies of a node of a seam."""
    allowed = MAX_JUMP * float(np.ptp(field.values)) + MAX_ROUNDING * float(np.abs(field.values).max())
    for axis, closed in enumerate(domain.closed_lines):
        lines = np.moveaxis(field.values, axis, 0)
        jump = np.abs(lines[-1] - lines[0])
        k = int(np.argmax(jump))
        if closed and jump[k] > allowed:
            raise InputError(
                f"the rectangle is periodic in {'xy'[axis]}, but {name} is not: node {k} of the seam has the values"
                f" {lines[0][k]:.6g} and {lines[-1][k]:.6g} on its two sides; give both copies of a node one value, or"
                " leave periodic out",
                field="domain.periodic",
            )


def _allowed_jump(field: Field, domain: Rectangle) -> float:
    """The difference of two values of a function that is no jump."""
    line = np.linspace(0.0, 1.0, RANGE_POINTS)
    with np.errstate(all="ignore"):
        (u,) = field.evaluate(*domain.map(line[:, None], line))
    known = u[np.isfinite(u)]
    return MAX_JUMP * float(np.ptp(known)) + MAX_ROUNDING * float(np.abs(known).max()) if known.size else 0.0


def _tiled(field: Field, box: tuple[Interval, Interval], closed: tuple[bool, bool]) -> Field:
    """Samples on a grid with some more of them beyond closed sides; other functions as they are."""
    if isinstance(field, ScatteredSamples):
        field = field.grid
    if isinstance(field, NodalField | HermiteField):
        return _tiled_nodes(field, box, closed)
    if not isinstance(field, GridSamples):
        return field
    axes, values = [field.x, field.y], field.values
    for axis in (0, 1):
        if closed[axis]:
            axes[axis], tiled = _around(axes[axis], np.moveaxis(values, axis, 0), box[axis])
            values = np.moveaxis(tiled, 0, axis)
    if axes[0] is field.x and axes[1] is field.y:
        return field
    return GridSamples(x=axes[0], y=axes[1], values=values, box=box)


def _tiled_nodes(
    field: NodalField | HermiteField, box: tuple[Interval, Interval], closed: tuple[bool, bool]
) -> NodalField | HermiteField:
    """Values at the nodes of a closed mesh, with half a turn more of them beyond each seam: these may bend."""
    parts = [field.mesh.x, field.mesh.y, field.values]
    for axis in (0, 1):
        if not closed[axis]:
            continue
        nodes = parts[0].shape[axis] - 1
        number = np.arange(-(nodes // 2), nodes + nodes // 2 + 1)
        turns = number // nodes
        for k, part in enumerate(parts):
            lines = np.moveaxis(part, axis, 0)[number % nodes]
            if k == axis:
                lines = lines + (box[axis][1] - box[axis][0]) * turns[:, None]
            parts[k] = np.moveaxis(lines, 0, axis)
    x, y, values = (np.ascontiguousarray(part) for part in parts)
    return type(field)(mesh=Mesh(x, y), values=values)


def _around(axis: Array, values: Array, ends: Interval) -> tuple[Array, Array]:
    """The samples of one period, and some before and after it."""
    period = ends[1] - ends[0]
    inside = (axis >= ends[0] - SEAM_SHARE * period) & (axis < ends[1] - SEAM_SHARE * period)
    axis, values = axis[inside], values[inside]
    before = axis > ends[1] - MAX_TILED_SHARE * period
    before[: -min(MAX_TILED, axis.size)] = False
    after = axis < ends[0] + MAX_TILED_SHARE * period
    after[min(MAX_TILED, axis.size) :] = False
    return (
        np.concatenate([axis[before] - period, axis, axis[after] + period]),
        np.concatenate([values[before], values, values[after]]),
    )
