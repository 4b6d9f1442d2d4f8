"""How cells grow along an edge: one ratio, or sections with a ratio each."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import TypeAlias

import numpy as np

from equimesh.errors import InputError
from equimesh.inputs import describe_value
from equimesh.numerics.types import Array
from equimesh_schema.document import is_number

# The largest ratio of the last cell of an edge to the first one, and its inverse the smallest.
MAX_RATIO = 1e6
# Ratios nearer to 1 have equal cells.
NO_GROWTH = 1e-12

Section: TypeAlias = tuple[float, float, float]
"""The share of the length, the share of the cells, and the ratio of the last cell to the first one."""
Grading: TypeAlias = tuple[Section, ...]
"""Sections from the start of an edge to its end; their shares need not add up to 1."""

EVEN: Grading = ((1.0, 1.0, 1.0),)


def grading_of(value: object, field: str) -> Grading:
    """The grading that a description gives: a ratio, or a list of sections ``[length, cells, ratio]``.

    Raises :class:`~equimesh.errors.InputError` with ``field`` for other values.
    """
    if isinstance(value, Sequence) and not isinstance(value, str):
        if not value:
            raise InputError(f"{_name(field)} is an empty list: give a ratio, or sections", field=field)
        return tuple(_section(section, f"{field}[{k}]") for k, section in enumerate(value))
    return ((1.0, 1.0, _ratio(value, field)),)


def reversed_grading(grading: Grading) -> Grading:
    """The grading of the same edge from its end to its begin."""
    return tuple((length, cells, 1.0 / ratio) for length, cells, ratio in grading[::-1])


def is_same(one: Grading, other: Grading) -> bool:
    """Whether two gradings agree to rounding."""
    return len(one) == len(other) and bool(np.allclose(one, other, rtol=1e-9, atol=0.0))


@lru_cache
def shares(grading: Grading, cells: int) -> Array:
    """The places of the nodes as shares of the length, from 0 to 1, shape ``(cells + 1,)``.

    In a section each cell is larger than the one before by one factor. Every section has at least one cell; with fewer
    cells than sections all cells are equal.
    """
    if cells < len(grading):
        return np.linspace(0.0, 1.0, cells + 1)
    lengths, portions, ratios = np.array(grading).T
    ends = np.concatenate([[0.0], np.cumsum(lengths) / lengths.sum()])
    last = np.round(np.cumsum(portions) / portions.sum() * cells).astype(np.int64)
    count, found = len(grading), np.zeros(1)
    first = 0
    for k in range(count):
        stop = cells if k == count - 1 else min(max(int(last[k]), first + 1), cells - (count - 1 - k))
        found = np.concatenate([found, ends[k] + (ends[k + 1] - ends[k]) * _grown(ratios[k], stop - first)[1:]])
        first = stop
    found[-1] = 1.0
    return found


def _grown(ratio: float, cells: int) -> Array:
    """Places from 0 to 1 of cells that grow by one factor, ``ratio`` from the first to the last one."""
    if cells == 1 or abs(ratio - 1.0) < NO_GROWTH:
        return np.linspace(0.0, 1.0, cells + 1)
    growth = np.log(ratio) / (cells - 1)
    return np.asarray(np.expm1(growth * np.arange(cells + 1)) / np.expm1(growth * cells))


def _section(value: object, field: str) -> Section:
    if not isinstance(value, Sequence) or isinstance(value, str) or len(value) != 3:
        message = f"{_name(field)} must be [share of the length, share of the cells, ratio], such as [0.2, 0.5, 4]"
        raise InputError(message, field=field)
    length, cells, ratio = (_ratio(entry, f"{field}[{k}]") for k, entry in enumerate(value))
    return length, cells, ratio


def _ratio(value: object, field: str) -> float:
    if not (is_number(value) and 1.0 / MAX_RATIO <= value <= MAX_RATIO):
        found = value if is_number(value) else describe_value(value)
        raise InputError(
            f"{_name(field)} is {found}: it must be a number from {1 / MAX_RATIO:g} to {MAX_RATIO:g}", field=field
        )
    return float(value)


def _name(field: str) -> str:
    return field.removeprefix("domain.")
