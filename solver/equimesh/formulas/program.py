"""Programs of formulas: checked, folded, and evaluated by routines."""

from __future__ import annotations

import keyword
import math
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NoReturn

import numpy as np

from equimesh.errors import ExpressionError
from equimesh.formulas.jet import OPERATIONS, Component, Jet, constant, coordinates
from equimesh.formulas.routine import Routine
from equimesh.formulas.spelling import refuse, shorten
from equimesh.formulas.syntax import Operation, ParsedExpression, parse
from equimesh.formulas.vocabulary import FUNCTIONS, LIMITS, PLANE, RESERVED, Language
from equimesh.numerics.types import Array

MAX_KEPT = 64
"""Formulas whose programs are kept: one is asked for again with other settings, and as a monitor and a function."""
CONDITIONS = frozenset(("<", "<=", ">", ">=", "==", "!=", "and", "or", "not"))


@dataclass(frozen=True, slots=True)
class Step:
    """One operation on the results of earlier steps; results in ``last_used`` are needed by no later step."""

    slot: int
    name: str
    arguments: tuple[int, ...]
    value_only: bool
    last_used: tuple[int, ...]


class Program:
    """Evaluates the operations of one expression.

    ``text`` is what was typed, ``understood`` the same in the language.
    ``slots[i]`` is the slot with the result of ``operations[i]``: the first operation with the same result.
    ``constants`` holds the jets of constants, ``steps`` the remaining operations, in order.
    """

    def __init__(
        self,
        text: str,
        parsed: ParsedExpression,
        values: Mapping[str, float],
        variables: Sequence[str] = PLANE.variables,
    ) -> None:
        """``values``: numbers for the names other than the one or two ``variables``."""
        self.text = text
        self.understood = parsed.understood
        self.operations = tuple(parsed.operations)
        self.variables = tuple(variables)
        self.slots: list[int] = []
        self.constants: dict[int, Jet] = {}
        seen: dict[tuple[object, ...], int] = {}
        with np.errstate(all="ignore"):
            for number, operation in enumerate(self.operations):
                arguments = tuple(self.slots[a] for a in operation.arguments)
                jet = self._constant(operation, arguments, values)
                if operation.name == "**":
                    self._check_exponent(text, operation)
                key: tuple[object, ...] = (operation.name, operation.symbol, *arguments)
                if jet is not None:
                    key = ("constant", repr(jet.value))
                if operation.name == "where" and arguments[0] in self.constants:
                    self.slots.append(arguments[1] if self.constants[arguments[0]].value else arguments[2])
                    continue
                slot = seen.setdefault(key, number)
                if jet is not None:
                    self.constants[slot] = jet
                self.slots.append(slot)
        self.result = self.slots[-1]
        self.steps = self._schedule()
        self._routines = dict[int, Routine]()

    def evaluate(self, x: Array, y: Array, order: int) -> tuple[Array, ...]:
        """Value and derivatives up to ``order`` at flat arrays of points, as :meth:`Field.evaluate`.

        With a single variable ``y`` is ignored, and the derivatives by it are zero.
        """
        return self.routine(order).evaluate(x, y)

    def routine(self, order: int) -> Routine:
        """What computes the value and the derivatives up to ``order``."""
        routine = self._routines.get(order)
        if routine is None:
            with np.errstate(all="ignore"):  # numbers are computed here; the loops at points never warn
                routine = Routine(lambda x, y: self._run(x, y, order, keep=False)[self.result].components(order))
            self._routines[order] = routine
        return routine

    def culprit(self, x: float, y: float, limit: float) -> Operation:
        """The innermost operation whose value or gradient at a point is not finite or larger than ``limit``.

        The result itself must be such; for ``where`` only the branch that is taken counts.
        """
        with np.errstate(all="ignore"):
            jets = self._run(np.array([x]), np.array([y]), 1, keep=True)

        def is_bad(number: int) -> bool:
            parts = (0.0 if part is None else part for part in jets[self.slots[number]].components(1))
            return not all(bool(np.all(np.abs(part) <= limit)) for part in parts)

        number = len(self.operations) - 1
        while True:
            operation = self.operations[number]
            inner = operation.arguments
            if operation.name == "where":
                inner = inner[1:2] if np.all(jets[self.slots[inner[0]]].value) else inner[2:3]
            bad = [argument for argument in inner if is_bad(argument)]
            if not bad:
                return operation
            number = bad[0]

    def _run(self, x: Component, y: Component, order: int, *, keep: bool) -> dict[int, Jet]:
        jets = dict(self.constants)
        symbols = dict(zip(self.variables, coordinates(x, y), strict=False))
        for step in self.steps:
            if step.name in symbols:
                jets[step.slot] = symbols[step.name]
            else:
                arguments = [jets[a] for a in step.arguments]
                jets[step.slot] = OPERATIONS[step.name](*arguments, 0 if step.value_only else order)
            if not keep:
                for slot in step.last_used:
                    del jets[slot]
        return jets

    def _constant(self, operation: Operation, arguments: tuple[int, ...], values: Mapping[str, float]) -> Jet | None:
        """The jet of an operation that is the same at all points."""
        if operation.name == "number":
            return constant(operation.value)
        if operation.name == "name":
            return constant(values[operation.symbol]) if operation.symbol in values else None
        if not all(argument in self.constants for argument in arguments):
            return None
        value = OPERATIONS[operation.name](*(self.constants[a] for a in arguments), 0).value
        return Jet(np.bool_(value)) if operation.name in CONDITIONS else constant(float(value))

    def _check_exponent(self, text: str, operation: Operation) -> None:
        exponent = self.constants.get(self.slots[operation.arguments[1]])
        if exponent is not None and abs(exponent.value) > LIMITS.exponent:
            at = self.operations[operation.arguments[1]].start
            message = f"the exponent {exponent.value:g} is too large: at most {LIMITS.exponent:g} is allowed"
            refuse(text, at, message)

    def _schedule(self) -> tuple[Step, ...]:
        """The steps that the result depends on; those that feed conditions alone need no derivatives."""
        needs_slopes: dict[int, bool] = {self.result: True}
        order: list[tuple[int, Operation, tuple[int, ...]]] = []
        for number in range(self.result, -1, -1):
            if number not in needs_slopes or number in self.constants:
                continue
            operation = self.operations[number]
            arguments = tuple(self.slots[a] for a in operation.arguments)
            order.append((number, operation, arguments))
            for k, argument in enumerate(arguments):
                flat = operation.name == "sign" or (operation.name == "where" and k == 0)
                needed = needs_slopes[number] and not flat
                needs_slopes[argument] = needs_slopes.get(argument, False) or needed
        free: set[int] = {self.result, *self.constants}
        steps: list[Step] = []
        for number, operation, arguments in order:  # backwards, so that the first use seen is the last one
            last_used = tuple(sorted(set(arguments) - free))
            free.update(arguments)
            name = operation.symbol if operation.name == "name" else operation.name
            steps.append(Step(number, name, arguments, not needs_slopes[number], last_used))
        return tuple(reversed(steps))


# Programs of formulas in text: the check of their parameters, and errors where they are not finite.

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
    values = {"pi": math.pi, "e": math.e, **constants, **parameters}
    # Numbers that are equal can differ in their sign: 0 and -0.
    signs = tuple(math.copysign(1.0, value) for value in values.values())
    return _compiled(text, tuple(parameters), tuple(values.items()), signs, language)


@lru_cache(maxsize=MAX_KEPT)
def _compiled(
    text: str,
    parameters: tuple[str, ...],
    values: tuple[tuple[str, float], ...],
    signs: tuple[float, ...],  # noqa: ARG001
    language: Language,
) -> Program:
    return Program(text, parse(text, (*language.names, *parameters), language), dict(values), language.variables)


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
    if not isinstance(parameters, Mapping):
        shown = shorten(repr(parameters))  # type: ignore[unreachable]
        message = f"parameters = {shown}: give the numbers by their names, such as {{'a': 2.0}}"
        raise ExpressionError(message, field="parameters")
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
