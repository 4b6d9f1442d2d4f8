"""Sources: a function of the plane for compiled loops, which evaluate it without the interpreter."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

from equimesh.fields.bicubic import Axis, patch_curvatures, patch_slopes, patch_values
from equimesh.fields.expression import Expression, Field
from equimesh.fields.samples import GridSamples
from equimesh.formulas.routine import Table, calculate
from equimesh.numerics.calls import address_of, called_at
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array


class Code(NamedTuple):
    """Where the machine code of the loops is."""

    formula: int
    values: int
    slopes: int
    curvatures: int


class Source(NamedTuple):
    """A formula, or a spline by its polynomials, with its derivatives up to ``order``, 0 to 2.

    The memory of its table is that of one thread.
    """

    code: Code
    order: int
    is_spline: bool
    table: Table
    along_x: Axis
    along_y: Axis
    polynomials: Array


# What a source has of the kind that it is not.
_NO_AXIS = Axis(np.zeros(2), np.zeros((1, 4, 4)), np.zeros(2, dtype=np.int64))
_NO_POLYNOMIALS = np.zeros((1, 1, 4, 4))
_NO_TABLE = Table(
    np.zeros((0, 5), dtype=np.int64), np.zeros((0, 3), dtype=np.int64), np.zeros((1, 1)), 0, np.zeros(0, dtype=np.int64)
)


@cache
def nothing() -> Source:
    """A source that nobody evaluates."""
    return Source(_machine_code(), 0, False, _NO_TABLE, _NO_AXIS, _NO_AXIS, _NO_POLYNOMIALS)


@cache
def _machine_code() -> Code:
    line, rows = np.zeros(1), np.zeros((6, 1))
    spline = line, line, _NO_AXIS, _NO_AXIS, _NO_POLYNOMIALS, rows
    return Code(
        formula=address_of(calculate, _NO_TABLE, line, line, rows),
        values=address_of(patch_values, *spline),
        slopes=address_of(patch_slopes, *spline),
        curvatures=address_of(patch_curvatures, *spline),
    )


def source_of(field: Field, order: int) -> Source | None:
    """The ``field`` with its derivatives up to ``order``, 0 to 2; ``None`` where only its own code can evaluate it.

    Splines have polynomials where their pieces are not too many.
    """
    if isinstance(field, Expression):
        return nothing()._replace(order=order, table=field.routine(order).table())
    if isinstance(field, GridSamples) and field.spline.polynomials is not None:
        axes = (field.spline.along_x, field.spline.along_y)
        return Source(_machine_code(), order, True, _NO_TABLE, *axes, field.spline.polynomials)
    return None


@compiled
def fill(source: Source, x: Array, y: Array, rows: Array) -> None:
    """Fill the first one, three or six ``rows`` with the value and the derivatives at finite points ``x``, ``y``.

    The numbers are those of :meth:`~equimesh.fields.expression.Field.evaluate`, to the last bit.
    """
    if source.is_spline:
        at = x, y, source.along_x, source.along_y, source.polynomials, rows
        if source.order == 0:
            called_at(source.code.values, patch_values, at)
        else:
            called_at(source.code.slopes, patch_slopes, at)
        if source.order == 2:
            called_at(source.code.curvatures, patch_curvatures, at)
    else:
        called_at(source.code.formula, calculate, (source.table, x, y, rows))
