"""Programs of formulas in text: the check of their parameters, and errors where they are not finite."""

import keyword
import math
import unicodedata
from collections.abc import Mapping
from typing import NoReturn

import numpy as np

from equimesh.errors import ExpressionError
from equimesh.formulas.program import Program
from equimesh.formulas.syntax import parse
from equimesh.formulas.typed import refuse, shorten
from equimesh.formulas.vocabulary import FUNCTIONS, LIMITS, RESERVED, Language

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
    "atan2": "move the point where both arguments vanish out of the {where}",
}


def compile_formula(text: object, parameters: Mapping[str, float], language: Language, **constants: float) -> Program:
    """The program of ``text`` in a ``language``; ``constants`` are the values of names of the language itself.

    Raises :class:`~equimesh.errors.ExpressionError` with the position in the text.
    """
    if not isinstance(text, str):
        raise ExpressionError(f"an expression is text, for instance '{language.example}'", field="expression")
    parsed = parse(text, (*language.names, *parameters), language)
    values = {"pi": math.pi, "e": math.e, **constants, **parameters}
    return Program(text, parsed, values, language.variables)


def raise_culprit(program: Program, at: tuple[float, float], wrong: str, limit: float, *, where: str) -> NoReturn:
    """Raise an error that names the innermost part whose value or gradient at a point exceeds ``limit``.

    ``wrong`` describes the fault. ``where`` names the set on which the formula must be finite, without an article.
    """
    operation = program.culprit(*at, min(limit, LIMITS.magnitude))
    part = shorten(program.text[operation.start : operation.end])
    remedy = _REMEDIES.get(operation.name, "rescale it so that it stays finite on the whole {where}").format(
        where=where
    )
    refuse(
        program.text,
        operation.start,
        f"{wrong}, because of {part}: {remedy}, or take another formula there with where(condition, a, b)",
    )


def check_parameters(parameters: Mapping[str, float]) -> dict[str, float]:
    """``parameters`` as floats; raises :class:`~equimesh.errors.ExpressionError` for names that cannot be used."""
    if len(parameters) > LIMITS.parameters:
        message = f"{len(parameters)} parameters: at most {LIMITS.parameters} are allowed"
        raise ExpressionError(message, field="parameters")
    return {_check_name(name): require_finite(value, f"parameters.{name}") for name, value in parameters.items()}


def _check_name(name: object) -> str:
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
        raise ExpressionError(f"'{name}' has a fixed meaning and cannot name a parameter: {remedy}", field=where)
    return name


def require_finite(value: object, where: str) -> float:
    """``value`` as a float."""
    if isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool):
        try:
            number = float(value)
        except OverflowError:
            raise ExpressionError(f"{where} is too large: the largest is about 1.8e308", field=where) from None
        if math.isfinite(number):
            return number
    raise ExpressionError(f"{where} = {shorten(repr(value))}: must be a finite number", field=where)
