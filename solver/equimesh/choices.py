"""Options that are one of a few words."""

from __future__ import annotations

from enum import StrEnum
from typing import TypeVar

from equimesh.errors import InputError

E = TypeVar("E", bound=StrEnum)


def choice(kind: type[E], value: str, field: str) -> E:
    """The member of ``kind`` that ``value`` is or names; raises :class:`~equimesh.errors.InputError` for others."""
    try:
        return kind(value)
    except ValueError:
        known = ", ".join(f"'{member}'" for member in kind)
        raise InputError(f"{field} = {value!r}: choose one of {known}", field=field) from None
