"""The curves of a description: from JSON, and from files of points."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from equimesh.blocks.airfoil import Airfoil
from equimesh.blocks.checks import check_not_crossing
from equimesh.blocks.curves import BoundaryCurve, Circle, FormulaCurve, Point
from equimesh.blocks.entries import entries, mapping, members, number, place, point
from equimesh.blocks.spline_curve import SplineCurve
from equimesh.domains.curve import Curve
from equimesh.errors import InputError
from equimesh.inputs import describe_value

# Points of one curve.
MAX_POINTS = 100_000
# Size of a file of points, in bytes.
MAX_BYTES = 10_000_000
# The members that name the kind of a curve, each with the others that it may have.
KINDS = {
    "circle": (),
    "points": ("closed", "corners"),
    "polyline": ("closed",),
    "naca": ("chord", "leading_edge", "angle"),
    "x": ("y", "parameters", "closed"),
}


def curve_of(value: object, field: str) -> BoundaryCurve:
    """The curve that an entry of ``curves`` describes.

    Raises :class:`~equimesh.errors.InputError` with a field at or below ``field``.
    """
    entry = mapping(value, field)
    kinds = [kind for kind in KINDS if kind in entry]
    if len(kinds) != 1:
        raise InputError(
            f"{place(field)} must have one of the members circle, points, polyline, naca, or x with y",
            field=field,
        )
    (kind,) = kinds
    members(entry, field, (kind, *KINDS[kind]))
    if kind == "circle":
        return _circle(entry["circle"], f"{field}.circle")
    if kind == "naca":
        return _airfoil(entry, field)
    if kind == "x":
        return _formula(entry, field)
    points = _points(entry[kind], f"{field}.{kind}")
    closed = _flag(entry.get("closed", points[0] == points[-1]), f"{field}.closed")
    numbers = entry.get("corners")
    corners = None if numbers is None else tuple(_whole(k, f"{field}.corners") for k in entries(numbers, field))
    where = f"{field}.{kind}"
    curve = SplineCurve(points=points, closed=closed, corners_at=corners, straight=kind == "polyline", where=where)
    check_not_crossing(curve, place(field), where)
    return curve


def with_points(curves: Mapping[str, Any], folder: Path | None) -> dict[str, Any]:
    """The same curves with the points of files in place of the names of the files, which lie in ``folder``.

    Raises :class:`~equimesh.errors.InputError` where a file cannot be read, or where there is no folder.
    """
    found = dict(curves)
    for name, entry in curves.items():
        for kind in ("points", "polyline"):
            if isinstance(entry, Mapping) and isinstance(entry.get(kind), str):
                field = f"domain.curves.{name}.{kind}"
                found[name] = {**entry, kind: [list(pair) for pair in read_points(entry[kind], folder, field)]}
    return found


def read_points(name: str, folder: Path | None, field: str) -> list[Point]:
    """The points of a file with two numbers a line, apart by commas or blanks; lines before the first pair are titles.

    Raises :class:`~equimesh.errors.InputError`, with the line, where a later line is no pair.
    """
    if folder is None:
        message = f"{name[:80]} is the name of a file: write the points as a list, or in Python give folder=..."
        raise InputError(message, field=field)
    try:
        with (folder / name).open("rb") as file:
            data = file.read(MAX_BYTES + 1)
        if len(data) > MAX_BYTES:
            raise InputError(f"{name} is larger than {MAX_BYTES // 1_000_000} MB", field=field)
        text = data.decode()
    except OSError as error:
        raise InputError(f"{name} cannot be read: {error.strerror}", field=field) from error
    except UnicodeDecodeError as error:
        raise InputError(f"{name} cannot be read: {error}", field=field) from error
    found: list[Point] = []
    for line, row in enumerate(text.splitlines(), start=1):
        parts = row.split("#")[0].replace(",", " ").replace(";", " ").split()
        try:
            x, y = (float(part) for part in parts)
        except ValueError:
            if parts and found:
                message = f"{name}, line {line}: {row.strip()[:60]!r} is no pair of numbers"
                raise InputError(message, field=field) from None
            continue
        found.append((x, y))
    if not found:
        raise InputError(f"{name} has no line with two numbers", field=field)
    return found


def _points(value: object, field: str) -> tuple[Point, ...]:
    rows = entries(value, field)
    if not 2 <= len(rows) <= MAX_POINTS:
        raise InputError(f"{place(field)} has {len(rows)} points: it must have 2 to {MAX_POINTS}", field=field)
    return tuple(point(row, f"{field}[{k}]") for k, row in enumerate(rows))


def _circle(value: object, field: str) -> Circle:
    entry = members(value, field, ("center", "radius"))
    center = point(entry.get("center", (0.0, 0.0)), f"{field}.center")
    return Circle(center=center, radius=number(entry.get("radius", 1.0), f"{field}.radius", positive=True))


def _airfoil(entry: Mapping[str, Any], field: str) -> Airfoil:
    digits = entry["naca"]
    if not isinstance(digits, str):
        message = f'{place(field)}.naca is {describe_value(digits)}: it must be a text of four digits, such as "0012"'
        raise InputError(message, field=f"{field}.naca")
    return Airfoil(
        digits=digits,
        chord=number(entry.get("chord", 1.0), f"{field}.chord", positive=True),
        leading_edge=point(entry.get("leading_edge", (0.0, 0.0)), f"{field}.leading_edge"),
        angle=number(entry.get("angle", 0.0), f"{field}.angle"),
        where=f"{field}.naca",
    )


def _formula(entry: Mapping[str, Any], field: str) -> FormulaCurve:
    for name in ("x", "y"):
        if not isinstance(entry.get(name), str):
            raise InputError(
                f"{place(field)}.{name} must be a formula in t, for t from 0 to 1", field=f"{field}.{name}"
            )
    try:
        curve = Curve.of_expressions(
            entry["x"], entry["y"], mapping(entry.get("parameters", {}), f"{field}.parameters")
        )
    except InputError as error:
        error.field = f"{field}.{error.field}"
        raise
    found = FormulaCurve(curve=curve, closed=_flag(entry.get("closed", False), f"{field}.closed"), where=field)
    check_not_crossing(found, place(field), field)
    return found


def _flag(value: object, field: str) -> bool:
    if not isinstance(value, bool):
        raise InputError(f"{place(field)} is {describe_value(value)}: it must be true or false", field=field)
    return value


def _whole(value: object, field: str) -> int:
    if isinstance(value, bool) or not isinstance(value, int):
        raise InputError(f"{place(field)} must be whole numbers of points", field=field)
    return value
