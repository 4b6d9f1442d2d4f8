"""A field given as text, such as ``tanh(20*(x + y/2 - k))``: data, never code, with exact derivatives.

The language: numbers, ``x``, ``y``, ``t``, ``pi``, ``e``, declared parameters; ``+ - * / **``; the functions
of :data:`FUNCTIONS`; comparisons with ``and``, ``or``, ``not`` as the first argument of ``where``.
:mod:`equimesh.functions` says which derivatives hold at kinks.
"""

from __future__ import annotations

import keyword
import math
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import NoReturn, TypeAlias

import numpy as np
import numpy.typing as npt

from equimesh.errors import ExpressionError, InputError
from equimesh.poles import find_pole
from equimesh.program import Program
from equimesh.syntax import Operation, parse
from equimesh.tokens import refuse, shorten
from equimesh.vocabulary import FUNCTIONS, LIMITS, RESERVED

__all__ = ["FUNCTIONS", "LIMITS", "Expression"]

Array: TypeAlias = npt.NDArray[np.float64]

_REMEDIES = {
    "/": "keep the denominator away from 0, for instance by adding a small positive constant to it",
    "sqrt": "keep its argument positive; sqrt(... + 1e-6) has a finite slope",
    "**": "keep the base positive unless the exponent is a positive whole number; add for instance 1e-6",
    "exp": "keep its argument below 200; for a steep front use tanh",
    "sinh": "keep its argument below 200; for a steep front use tanh",
    "cosh": "keep its argument below 200; for a steep front use tanh",
    "log": "keep its argument positive",
    "log2": "keep its argument positive",
    "log10": "keep its argument positive",
    "asin": "keep its argument between -1 and 1; the slope is infinite at the ends",
    "acos": "keep its argument between -1 and 1; the slope is infinite at the ends",
    "acosh": "keep its argument above 1",
    "atanh": "keep its argument between -1 and 1",
    "tan": "keep its argument away from pi/2, 3*pi/2 and so on",
    "atan2": "move the point where both arguments vanish out of the unit square",
}


@dataclass(frozen=True)
class Expression:
    """The function of x and y that ``text`` describes; a :class:`~equimesh.field.Field`.

    ``parameters`` gives values to further names, ``t`` (default 0) to the name t; both are constants.
    Raises :class:`~equimesh.errors.ExpressionError`, with the position in the text, for what is not in the
    language, and with ``field`` ``"parameters.<name>"`` or ``"t"`` for values that cannot be used.
    """

    text: str
    parameters: Mapping[str, float] = field(default_factory=dict, kw_only=True, hash=False)
    t: float = field(default=0.0, kw_only=True)
    _program: Program = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if not isinstance(self.text, str):
            raise ExpressionError("an expression is text, for instance 'tanh(20*(x - y))'", field="expression")
        if len(self.parameters) > LIMITS.parameters:
            message = f"{len(self.parameters)} parameters: at most {LIMITS.parameters} are allowed"
            raise ExpressionError(message, field="parameters")
        parameters = {
            _checked_name(name): _finite(value, f"parameters.{name}") for name, value in self.parameters.items()
        }
        object.__setattr__(self, "parameters", MappingProxyType(parameters))
        object.__setattr__(self, "t", _finite(self.t, "t"))
        operations = parse(self.text, (*RESERVED, *parameters))
        values = {"pi": math.pi, "e": math.e, "t": self.t, **parameters}
        object.__setattr__(self, "_program", Program(self.text, operations, values))

    def __reduce__(self) -> tuple[object, ...]:
        return _restore, (self.text, dict(self.parameters), self.t)

    @property
    def names(self) -> frozenset[str]:
        """The variables and parameters that occur in the text: of ``x``, ``y``, ``t`` and the parameters."""
        used = {operation.symbol for operation in self._program.operations if operation.name == "name"}
        return frozenset(used - {"pi", "e"})

    def evaluate(self, x: npt.ArrayLike, y: npt.ArrayLike, order: int = 0) -> tuple[Array, ...]:
        """The value and all partial derivatives up to ``order``, as :meth:`equimesh.field.Field.evaluate`.

        ``x`` and ``y`` are broadcast against each other. Where the function is not defined the result is nan
        or infinite, without a warning; see :meth:`check_finite`.
        """
        if order not in (0, 1, 2):
            raise InputError(f"order = {order}: the order of the derivatives is 0, 1 or 2", field="order")
        xs, ys = np.broadcast_arrays(np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64))
        results = self._program.evaluate(xs.ravel(), ys.ravel(), order)
        return tuple(result.reshape(xs.shape) for result in results)

    def check_finite(self, n: int = 33) -> None:
        """Evaluate u and its gradient on ``n`` x ``n`` points of the closed unit square, and look for poles between.

        Raises :class:`~equimesh.errors.ExpressionError` at the first point where one of them is not finite, or too
        large to square, or towards which the gradient grows without bound; its position is that of the innermost
        part of the text that is to blame.
        """
        x, y = np.meshgrid(np.linspace(0.0, 1.0, n), np.linspace(0.0, 1.0, n), indexing="ij")
        u, *slopes = self.evaluate(x, y, order=1)
        bad_value = ~(np.abs(u) <= LIMITS.magnitude)
        bad = bad_value | ~(np.abs(slopes[0]) <= LIMITS.magnitude) | ~(np.abs(slopes[1]) <= LIMITS.magnitude)
        if not bad.any():
            pole = find_pole(self, n)
            if pole is not None:
                self._refuse(pole.x, pole.y, "the gradient of u grows without bound", math.sqrt(pole.slope))
            return
        i, j = np.unravel_index(int(np.argmax(bad)), bad.shape)
        what = "value" if bad_value[i, j] else "gradient"
        finite = np.isfinite([u[i, j], slopes[0][i, j], slopes[1][i, j]]).all()
        wrong = f"is larger than {LIMITS.magnitude:g}" if finite else "is not finite"
        self._refuse(float(x[i, j]), float(y[i, j]), f"the {what} of u {wrong}", LIMITS.magnitude)

    def _refuse(self, x: float, y: float, wrong: str, limit: float) -> NoReturn:
        """Say what is ``wrong`` at a point, and blame the innermost part whose value or gradient exceeds ``limit``."""
        operation = self._program.culprit(x, y, min(limit, LIMITS.magnitude))
        part = shorten(self.text[operation.start : operation.end])
        refuse(
            self.text,
            operation.start,
            f"{wrong} at (x, y) = ({x:.6g}, {y:.6g}), because of {part}: "
            f"{_remedy(operation)}, or take another formula there with where(condition, a, b)",
        )


def _remedy(operation: Operation) -> str:
    return _REMEDIES.get(operation.name, "rescale it so that it stays finite on the whole unit square")


def _restore(text: str, parameters: dict[str, float], t: float) -> Expression:
    return Expression(text, parameters=parameters, t=t)


def _checked_name(name: object) -> str:
    """``name`` if it can be that of a parameter."""
    where = f"parameters.{name}" if isinstance(name, str) and name.isprintable() else "parameters"
    if not isinstance(name, str) or len(name) > LIMITS.digits or not name.isidentifier():
        shown = shorten(repr(name))
        remedy = f"use a letter followed by letters, digits or _, at most {LIMITS.digits} in all"
        raise ExpressionError(f"{shown} cannot name a parameter: {remedy}", field=where)
    if unicodedata.normalize("NFKC", name) != name:
        plain = unicodedata.normalize("NFKC", name)
        raise ExpressionError(f"'{name}' is written in look-alike characters: write {plain}", field=where)
    if name in RESERVED or name in FUNCTIONS or keyword.iskeyword(name):
        remedy = f"rename it, for instance to {name}_1"
        raise ExpressionError(f"'{name}' has a meaning of its own and cannot name a parameter: {remedy}", field=where)
    return name


def _finite(value: object, where: str) -> float:
    """``value`` as a float."""
    if isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool):
        try:
            number = float(value)
        except OverflowError:
            raise ExpressionError(f"{where} is too large: the largest is about 1.8e308", field=where) from None
        if math.isfinite(number):
            return number
    raise ExpressionError(f"{where} = {shorten(repr(value))}: a finite number is wanted", field=where)
