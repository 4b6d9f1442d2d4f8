"""The curves of a description: from JSON, and from files of points."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from equimesh.blocks.checks import check_not_crossing
from equimesh.blocks.curves import BoundaryCurve, Circle, FormulaCurve, Point, nearest_on, wrapped
from equimesh.blocks.spline_curve import SplineCurve
from equimesh.domains.curve import Curve
from equimesh.domains.domain import MAX_COORDINATE
from equimesh.errors import InputError
from equimesh.inputs import check_name, describe_value
from equimesh.numerics.types import Array
from equimesh_schema.document import is_number, is_whole

# Checked entries of the JSON of a description: objects, lists, names, numbers.

# Characters of a value that a message repeats.
SHOWN = 40


def members(value: object, field: str, known: Collection[str], such: str = "") -> Mapping[str, Any]:
    """``value`` as an object with no other members than the ``known`` ones."""
    found = mapping(value, field, such)
    for name in found:
        if name not in known:
            message = f"{place(field)} has a member {name[:SHOWN]!r} that is not known: {', '.join(known)} are"
            raise InputError(message, field=f"{field}.{name[:SHOWN]}")
    return found


def mapping(value: object, field: str, such: str = "") -> Mapping[str, Any]:
    """``value`` as an object whose names are texts, ``such`` as an example."""
    if not isinstance(value, Mapping) or not all(isinstance(name, str) for name in value):
        raise InputError(f"{place(field)} is {describe_value(value)}: it must be an object{such}", field=field)
    return value


def named(value: object, field: str, what: str, such: str = "") -> Mapping[str, Any]:
    """``value`` as an object whose members are named by the caller; ``what`` each of them is."""
    found = mapping(value, field, such)
    for name in found:
        check_name(name, what, field)
    return found


def entries(value: object, field: str, *, count: int | None = None, what: str = "a list") -> Sequence[Any]:
    """``value`` as a list, of ``count`` entries where that is given; ``what`` it must be is said where it is none.

    An array is a list of its rows.
    """
    if isinstance(value, np.ndarray) and value.ndim:
        value = value.tolist()
    if isinstance(value, str) or not isinstance(value, Sequence):
        raise InputError(f"{place(field)} is {describe_value(value)}: it must be {what}", field=field)
    if count is not None and len(value) != count:
        raise InputError(f"{place(field)} has {len(value)} entries: it must have {count}", field=field)
    return value


def name_among(value: object, field: str, known: Collection[str], what: str) -> str:
    """``value`` as one of the ``known`` names of ``what``."""
    if not isinstance(value, str) or value not in known:
        shown = repr(value)[:SHOWN]
        few = ", ".join(list(known)[:8]) + (", ..." if len(known) > 8 else "")
        raise InputError(f"{place(field)} = {shown} is no {what}: there are {few or 'none'}", field=field)
    return value


def number(value: object, field: str, *, positive: bool = False) -> float:
    """``value`` as a float of at most the size of a coordinate."""
    if not is_number(value) or not abs(value) <= MAX_COORDINATE or (positive and not value > 0):
        found = repr(value)[:SHOWN] if is_number(value) else describe_value(value)
        wanted = f"a {'positive ' if positive else ''}number of at most {MAX_COORDINATE:g} in size"
        raise InputError(f"{place(field)} is {found}: it must be {wanted}", field=field)
    return float(value)


def whole(value: object, field: str, largest: int) -> int:
    """``value`` as a whole number from 1 to ``largest``."""
    if not is_whole(value) or not 1 <= value <= largest:
        found = repr(value)[:SHOWN] if isinstance(value, (int, float)) else describe_value(value)
        raise InputError(f"{place(field)} is {found}: it must be a whole number from 1 to {largest}", field=field)
    return int(value)


def point(value: object, field: str) -> Point:
    """``value`` as a pair of coordinates."""
    x, y = entries(value, field, count=2)
    return number(x, f"{field}[0]"), number(y, f"{field}[1]")


def place(field: str) -> str:
    """The name of a field in a message."""
    return field.removeprefix("domain.")


# Profiles of airfoils with four digits, by their formula.
#
# E. N. Jacobs, K. E. Ward and R. M. Pinkerton, *The characteristics of 78 related airfoil sections from tests in the
# variable-density wind tunnel*, NACA Report 460 (1933). The last coefficient of the thickness is the one that closes
# the trailing edge.

# Half the thickness of a profile with thickness 1, in powers 1/2, 1, 2, 3 and 4 of the share of the chord.
THICKNESS = (1.4845, -0.63, -1.758, 1.4215, -0.518)
# Places on a profile at which the search for the nearest point begins.
SEARCH_POINTS = 1025


@dataclass(frozen=True, kw_only=True)
class Airfoil:
    """The profile with the four ``digits`` of NACA, such as ``"0012"``; a curve of boundaries.

    It begins at the trailing edge, its only corner, runs along the upper side to the leading edge and back along the
    lower side: counter-clockwise. With t from 0 to 2 the share of the chord is ``(1 - t)^2``, so that the formula is
    smooth at the leading edge, t = 1. ``leading_edge`` is its place, ``chord`` its length, ``angle`` the angle of
    attack in degrees, which turns the profile clockwise.

    Raises :class:`~equimesh.errors.InputError` with the field ``where`` for other digits.
    """

    digits: str
    chord: float = 1.0
    leading_edge: Point = (0.0, 0.0)
    angle: float = 0.0
    where: str = "domain.curves"

    def __post_init__(self) -> None:
        if not (len(self.digits) == 4 and self.digits.isascii() and self.digits.isdigit() and int(self.digits[2:]) > 0):
            message = f'naca = {self.digits[:20]!r}: four digits, the last two the thickness, such as "0012"'
            raise InputError(message, field=self.where)
        if bool(int(self.digits[0])) != bool(int(self.digits[1])):
            message = f"naca = {self.digits!r}: of camber and its place, the first two digits, both are 0 or none"
            raise InputError(message, field=self.where)

    @property
    def ends(self) -> tuple[float, float]:
        """0 and 2, both at the trailing edge."""
        return 0.0, 2.0

    @property
    def closed(self) -> bool:
        """A profile is closed."""
        return True

    @property
    def corners(self) -> Array:
        """0: the trailing edge."""
        return np.zeros(1)

    def evaluate(self, t: Array) -> tuple[Array, Array, Array, Array]:
        """``x, y, x_t, y_t``, exactly differentiated."""
        root = 1.0 - wrapped(self, np.asarray(t, dtype=np.float64))  # from 1 to -1; the upper side is positive
        share, side, share_t = root**2, np.copysign(1.0, root), -2.0 * root
        a, b, c, d, e = (int(self.digits[2:]) / 100.0 * k for k in THICKNESS)
        half = a * root + side * share * (b + share * (c + share * (d + share * e)))
        half_t = -(a + side * 2.0 * root * (b + share * (2.0 * c + share * (3.0 * d + share * 4.0 * e))))
        x, y, x_t, y_t = share, half, share_t, half_t
        if self.digits[0] != "0":
            # The thickness stands at right angles on the line of camber, whose angle is atan(slope).
            rise, slope, bend = self._camber(share)
            norm = np.sqrt(1.0 + slope**2)
            sine, cosine = slope / norm, 1.0 / norm
            angle_t = bend / (1.0 + slope**2) * share_t
            x, y = share - half * sine, rise + half * cosine
            x_t = share_t - half_t * sine - half * cosine * angle_t
            y_t = slope * share_t + half_t * cosine - half * sine * angle_t
        turn_x, turn_y = (
            self.chord * math.cos(math.radians(self.angle)),
            self.chord * math.sin(math.radians(self.angle)),
        )
        return (
            self.leading_edge[0] + turn_x * x + turn_y * y,
            self.leading_edge[1] - turn_y * x + turn_x * y,
            turn_x * x_t + turn_y * y_t,
            -turn_y * x_t + turn_x * y_t,
        )

    def nearest(self, x: Array, y: Array) -> Array:
        """The t of the nearest point of the profile."""
        return nearest_on(self, x, y, np.linspace(0.0, 2.0, SEARCH_POINTS))

    def _camber(self, share: Array) -> tuple[Array, Array, Array]:
        """The line of camber over the chord, which is not 0, and its first and second derivative."""
        height, place = int(self.digits[0]) / 100.0, int(self.digits[1]) / 10.0
        ahead = share < place
        factor = height / np.where(ahead, place**2, (1.0 - place) ** 2)
        constant = np.where(ahead, 0.0, 1.0 - 2.0 * place)
        rise = factor * (constant + 2.0 * place * share - share**2)
        return rise, 2.0 * factor * (place - share), -2.0 * factor


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
    if not is_whole(value):
        raise InputError(f"{place(field)} must be whole numbers of points", field=field)
    return int(value)
