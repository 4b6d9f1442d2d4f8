"""Checks of values from callers: arrays of numbers and choices; and numbers for JSON."""

import math
from collections.abc import Sequence
from enum import StrEnum
from typing import Any, TypeVar

import numpy as np
from numpy import ma  # now: its import parses code, which fails now and then in a thread next to others

from equimesh.errors import InputError, SamplesError
from equimesh.numerics.types import Array
from equimesh_schema.document import is_number


def real_array(value: object, name: str, *, ndim: int) -> Array:
    """``value`` as a read-only array of finite floats with ``ndim`` dimensions.

    Raises :class:`~equimesh.errors.SamplesError` with the field ``name``, naming the first bad entry.
    """
    if isinstance(value, (list, tuple)):
        _check_nested(value, name, ndim)
    raw = ma.filled(value.astype(np.float64), np.nan) if isinstance(value, ma.MaskedArray) else value
    try:
        array = np.asarray(raw) if not isinstance(raw, (list, tuple)) else np.array(raw, dtype=np.float64)
    except (OverflowError, ValueError, TypeError) as error:
        raise SamplesError(f"{name} cannot be read as an array of numbers: {error}", field=name) from error
    if array.dtype.kind not in "iuf":
        raise SamplesError(f"{name} holds {_kind(array.dtype)}: only real numbers are allowed", field=name)
    if array.ndim != ndim:
        raise SamplesError(
            f"{name} has shape {array.shape}: it must have {count_noun(ndim, 'dimension')}, not {array.ndim}",
            field=name,
        )
    with np.errstate(over="ignore", invalid="ignore"):  # a NaN of 32 bits may be one that warns when it is converted
        array = np.array(array, dtype=np.float64, order="C")
    bad = ~np.isfinite(array)
    if bad.any():
        index = np.unravel_index(int(np.argmax(bad)), array.shape)
        found = "NaN" if np.isnan(array[index]) else "infinite"
        raise SamplesError(
            f"{name}{brackets(index)} is {found}: every sample must be a finite number; fill in or leave out"
            f" the missing ones ({count_noun(int(bad.sum()), 'such entry', 'such entries')})",
            field=name,
        )
    array.setflags(write=False)
    return array


AT_PLACES = {"nodes": "a value at each node", "cells": "an average over each cell"}
"""What is needed of values on a mesh, by their location."""


def shaped_array(
    value: object, name: str, wanted: tuple[int, ...], what: str, *, hint: str = "", vectors: bool = False
) -> Array:
    """:func:`real_array` of the shape ``wanted``, of ``vectors`` with one more axis where that is allowed.

    Raises :class:`~equimesh.errors.SamplesError` that tells the shape, which is that of ``what`` at each place; a
    ``hint`` stands in place of those about values in another order.
    """
    shape = shape_of(value)
    axes = len(wanted) + (vectors and len(shape) > len(wanted))
    if shape and (len(shape) != axes or shape[: len(wanted)] != wanted):
        _check_nested(value, name, len(shape))
        if not hint and len(wanted) == 2:
            flat = "; reshape it" if shape == (math.prod(wanted),) else ""
            hint = "; transpose it" if shape[:2] == wanted[::-1] else flat
        order = ", xi first" if len(wanted) == 2 else ""
        raise SamplesError(f"{name} has shape {shape}, but {what} is needed, shape {wanted}{order}{hint}", field=name)
    return real_array(value, name, ndim=axes)


def shape_of(value: Any) -> tuple[int, ...]:
    """The shape of an array, or of nested lists by the first entries; empty for what is neither."""
    if isinstance(value, np.ndarray):
        return tuple(value.shape)
    if not isinstance(value, (list, tuple)):
        return ()
    return (len(value), *(shape_of(value[0]) if value else ()))


def _check_nested(value: object, name: str, ndim: int, index: tuple[int, ...] = ()) -> None:
    """Refuse lists that are ragged, too shallow or too deep, or hold anything but real numbers."""
    path = name + brackets(index)
    if isinstance(value, np.ndarray):
        return  # its shape and type are checked later
    if not isinstance(value, (list, tuple)):
        message = f"{path} is {describe_value(value)}: it must be a list of numbers"
        raise SamplesError(message, field=name, index=index)
    if ndim == 1:
        if not set(map(type, value)) <= {int, float}:
            for i, entry in enumerate(value):
                if isinstance(entry, bool) or not isinstance(entry, (int, float, np.integer, np.floating)):
                    message = f"{path}[{i}] is {describe_value(entry)}: it must be a real number"
                    raise SamplesError(message, field=name, index=(*index, i))
        return
    for i, row in enumerate(value):
        _check_nested(row, name, ndim - 1, (*index, i))
        if len(row) != len(value[0]):
            raise SamplesError(
                f"{path}[{i}] has {count_noun(len(row), 'entry', 'entries')} but {path}[0] has {len(value[0])}:"
                " every row must have the same length",
                field=name,
            )


def count_noun(n: int, one: str = "sample", many: str = "") -> str:
    """``n`` with its noun, singular or plural."""
    return f"{n} {one if n == 1 else many or one + 's'}"


def brackets(index: Sequence[Any]) -> str:
    """The index of an entry as it is written behind the name of an array."""
    return "".join(f"[{int(i)}]" for i in index)


def describe_value(value: object) -> str:
    """The kind of a value, for the message of an error."""
    if value is None:
        return "null"
    if isinstance(value, (bool, np.bool_)):
        return "a boolean"
    if isinstance(value, str):
        return f"the text {value[:20]!r}"
    if isinstance(value, (complex, np.complexfloating)):
        return "a complex number"
    if isinstance(value, (int, float, np.number)):
        return "a single number"
    return "a list" if isinstance(value, (list, tuple, np.ndarray)) else f"of type {type(value).__name__}"


def _kind(dtype: np.dtype[Any]) -> str:
    words = {"b": "booleans", "c": "complex numbers", "O": "mixed objects", "U": "text", "S": "bytes"}
    return words.get(dtype.kind, f"data of type {dtype}")


# Characters of a name, at most: names are repeated in files, answers and messages.
MAX_NAME = 100


def check_name(name: str, what: str, field: str) -> None:
    """Refuse a name that is too long, or has characters that cannot be shown or written to every file.

    ``what`` it is the name of, for the message. Raises :class:`~equimesh.errors.InputError`.
    """
    if len(name) > MAX_NAME:
        message = f"{what} has a name of {len(name)} characters, {name[:20]!r} ...: {MAX_NAME} are possible"
        raise InputError(message, field=field)
    if not name.isprintable():
        raise InputError(f"{what} has the name {name!a}: use letters, digits, signs and spaces", field=field)


E = TypeVar("E", bound=StrEnum)


def choice(kind: type[E], value: str, field: str) -> E:
    """The member of ``kind`` that ``value`` is or names; raises :class:`~equimesh.errors.InputError` for others."""
    try:
        return kind(value)
    except ValueError:
        known = ", ".join(f"'{member}'" for member in kind)
        raise InputError(f"{field} = {value!r}: choose one of {known}", field=field) from None


def require_flag(value: object, name: str, section: str = "") -> None:
    """Raise :class:`~equimesh.errors.InputError` for what is not True or False; the field is in the ``section``."""
    if not isinstance(value, bool | np.bool_):
        raise InputError(f"{name} = {str(value)[:20]}: give True or False", field=f"{section}{name}")


def keep_floats(settings: object, *names: str) -> None:
    """Keep real numbers of other types among these ``settings`` as floats: with float32 loops have fewer digits.

    What is no number stays as it is.
    """
    for name in names:
        value: Any = getattr(settings, name)
        if not isinstance(value, int | float) and is_number(value):
            object.__setattr__(settings, name, float(value))


def finite_or_none(number: float | None) -> float | None:
    """``number`` as a float for JSON, ``None`` where it is not known or not finite."""
    return float(number) if number is not None and math.isfinite(number) else None
