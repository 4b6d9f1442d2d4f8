"""Checked entries of the JSON of a description: objects, lists, names, numbers."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

from equimesh.blocks.curves import Point
from equimesh.domains.domain import MAX_COORDINATE
from equimesh.errors import InputError
from equimesh.inputs import check_name, describe_value

# Characters of a value that a message repeats.
SHOWN = 40


def members(value: object, field: str, known: Collection[str]) -> Mapping[str, Any]:
    """``value`` as an object with no other members than the ``known`` ones."""
    found = mapping(value, field)
    for name in found:
        if name not in known:
            message = f"{place(field)} has a member {name[:SHOWN]!r} that is not known: {', '.join(known)} are"
            raise InputError(message, field=f"{field}.{name[:SHOWN]}")
    return found


def mapping(value: object, field: str) -> Mapping[str, Any]:
    """``value`` as an object whose names are texts."""
    if not isinstance(value, Mapping) or not all(isinstance(name, str) for name in value):
        raise InputError(f"{place(field)} is {describe_value(value)}: it must be an object", field=field)
    return value


def named(value: object, field: str, what: str) -> Mapping[str, Any]:
    """``value`` as an object whose members are named by the caller; ``what`` each of them is."""
    found = mapping(value, field)
    for name in found:
        check_name(name, what, field)
    return found


def entries(value: object, field: str, *, count: int | None = None, what: str = "a list") -> Sequence[Any]:
    """``value`` as a list, of ``count`` entries where that is given; ``what`` it must be is said where it is none."""
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
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not is_number or not abs(value) <= MAX_COORDINATE or (positive and not value > 0):  # type: ignore[arg-type,operator]
        found = repr(value)[:SHOWN] if is_number else describe_value(value)
        wanted = f"a {'positive ' if positive else ''}number of at most {MAX_COORDINATE:g} in size"
        raise InputError(f"{place(field)} is {found}: it must be {wanted}", field=field)
    return float(value)  # type: ignore[arg-type]


def whole(value: object, field: str, largest: int) -> int:
    """``value`` as a whole number from 1 to ``largest``."""
    if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= largest:
        found = repr(value)[:SHOWN] if isinstance(value, (int, float)) else describe_value(value)
        raise InputError(f"{place(field)} is {found}: it must be a whole number from 1 to {largest}", field=field)
    return value


def point(value: object, field: str) -> Point:
    """``value`` as a pair of coordinates."""
    x, y = entries(value, field, count=2)
    return number(x, f"{field}[0]"), number(y, f"{field}[1]")


def place(field: str) -> str:
    """The name of a field in a message."""
    return field.removeprefix("domain.")
