"""Scalar functions of the plane: their interface, and formulas in text with exact derivatives.

The language: numbers, ``x``, ``y``, ``t``, ``pi``, ``e``, declared parameters; ``+ - * / **``; the functions
of :data:`FUNCTIONS`; comparisons with ``and``, ``or``, ``not`` as the first argument of ``where``.
:mod:`equimesh.formulas.jet` defines the derivatives at kinks.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Protocol, cast

import numpy as np
import numpy.typing as npt

from equimesh.blocks.blocks import Blocks
from equimesh.domains.domain import UNIT_SQUARE, Domain
from equimesh.errors import InputError
from equimesh.formulas.poles import find_pole
from equimesh.formulas.program import Program, check_parameters, compile_formula, raise_culprit, require_finite
from equimesh.formulas.routine import Routine
from equimesh.formulas.vocabulary import FUNCTIONS, LIMITS, PLANE
from equimesh.numerics.types import Array, Pair

__all__ = ["FUNCTIONS", "LIMITS", "Expression"]


@dataclass(frozen=True)
class Expression:
    """The function of x and y that ``text`` describes; a :class:`~equimesh.fields.expression.Field`.

    ``text`` stays what was typed; :attr:`understood` is the same in the language itself: ``2*x`` for ``2x``.
    ``parameters`` gives values to further names, ``t`` (default 0) to the name t; both are constants.
    Raises :class:`~equimesh.errors.ExpressionError`, with the position in the text, for text that is not in the
    language, and with ``field`` ``"parameters.<name>"`` or ``"t"`` for values that cannot be used.
    """

    text: str
    parameters: Mapping[str, float] = field(default_factory=dict, kw_only=True, hash=False)
    t: float = field(default=0.0, kw_only=True)
    _program: Program = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        parameters = check_parameters(self.parameters)
        object.__setattr__(self, "parameters", MappingProxyType(parameters))
        object.__setattr__(self, "t", require_finite(self.t, "t"))
        object.__setattr__(self, "_program", compile_formula(self.text, parameters, PLANE, t=self.t))

    def __reduce__(self) -> tuple[object, ...]:
        return _restore, (self.text, dict(self.parameters), self.t)

    @property
    def understood(self) -> str:
        """The text as it was understood, in the language itself; what is in the language already is unchanged.

        As a text it gives the same function. See the page of expressions for the rules.
        """
        return self._program.understood

    @property
    def names(self) -> frozenset[str]:
        """The variables and parameters that occur in the text: of ``x``, ``y``, ``t`` and the parameters."""
        used = {operation.symbol for operation in self._program.operations if operation.name == "name"}
        return frozenset(used - {"pi", "e"})

    def evaluate(self, x: npt.ArrayLike, y: npt.ArrayLike, order: int = 0) -> tuple[Array, ...]:
        """The value and all partial derivatives up to ``order``, as :meth:`equimesh.fields.expression.Field.evaluate`.

        ``x`` and ``y`` are broadcast against each other. Where the function is not defined the result is nan
        or infinite, without a warning; see :meth:`check_finite`.
        """
        if order not in (0, 1, 2):
            raise InputError(f"order = {order}: the order of the derivatives is 0, 1 or 2", field="order")
        xs, ys = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
        if xs.shape != ys.shape:
            xs, ys = np.broadcast_arrays(xs, ys)
        results = self._program.evaluate(xs.ravel(), ys.ravel(), order)
        return results if xs.ndim == 1 else tuple(result.reshape(xs.shape) for result in results)

    def routine(self, order: int) -> Routine:
        """What computes the value and all partial derivatives up to ``order``."""
        return self._program.routine(order)

    def check_finite(self, n: int = 33, domain: Domain | Blocks = UNIT_SQUARE) -> None:
        """Evaluate u and its gradient on ``n`` x ``n`` points of the closed ``domain``, and look for poles between.

        Of blocks the points are the nodes of their initial mesh, and there is no look between them.

        Raises :class:`~equimesh.errors.ExpressionError` at the first point where one of them is not finite, or too
        large to square, or towards which the gradient grows without bound; its position is that of the innermost
        part of the text that causes it.
        """
        where = "unit square" if domain == UNIT_SQUARE else "domain"
        x, y = _places(domain, n)
        u, *slopes = self.evaluate(x, y, order=1)
        bad_value = ~(np.abs(u) <= LIMITS.magnitude)
        bad = bad_value | ~(np.abs(slopes[0]) <= LIMITS.magnitude) | ~(np.abs(slopes[1]) <= LIMITS.magnitude)
        if not bad.any():
            if isinstance(domain, Blocks):
                return
            pole = find_pole(self.evaluate, n, map=domain.map, box=domain.box)
            if pole is not None:
                wrong = f"the gradient of u grows without bound at (x, y) = ({pole.x:.6g}, {pole.y:.6g})"
                raise_culprit(self._program, (pole.x, pole.y), wrong, math.sqrt(pole.slope), where=where)
            return
        place = np.unravel_index(int(np.argmax(bad)), bad.shape)
        what = "value" if bad_value[place] else "gradient"
        is_finite = np.isfinite([u[place], slopes[0][place], slopes[1][place]]).all()
        wrong = f"is larger than {LIMITS.magnitude:g}" if is_finite else "is not finite"
        at = (float(x[place]), float(y[place]))
        wrong = f"the {what} of u {wrong} at (x, y) = ({at[0]:.6g}, {at[1]:.6g})"
        raise_culprit(self._program, at, wrong, LIMITS.magnitude, where=where)

    def summary(self, n: int = 33, domain: Domain | Blocks = UNIT_SQUARE) -> dict[str, Any]:
        """The text as it was understood, its names, and the extremes of u and of the length of its gradient.

        They are those on ``n`` x ``n`` points of ``domain``. Of blocks the points are the nodes of their initial mesh.
        """
        u, u_x, u_y = self.evaluate(*_places(domain, n), order=1)
        gradient = np.hypot(u_x, u_y)
        return {
            "understood": self.understood,
            "names": sorted(self.names),
            "u": {"min": float(u.min()), "max": float(u.max())},
            "gradient": {"min": float(gradient.min()), "max": float(gradient.max())},
            "constant": bool(u.min() == u.max() and not gradient.any()),
        }


def _places(domain: Domain | Blocks, n: int) -> Pair:
    """The points at which an expression is looked at."""
    if isinstance(domain, Blocks):
        return domain.mesh.x, domain.mesh.y
    line = np.linspace(0.0, 1.0, n)
    return domain.map(*np.meshgrid(line, line, indexing="ij"))


def _restore(text: str, parameters: dict[str, float], t: float) -> Expression:
    return Expression(text, parameters=parameters, t=t)


# The interface of scalar functions of the plane.


class Field(Protocol):
    """A scalar function u(x, y) with derivatives: an expression, or a spline of samples.

    :func:`equimesh.testing.check_field` checks what is promised here.
    """

    def evaluate(self, x: Array, y: Array, order: int = 0) -> tuple[Array, ...]:
        """The value and all partial derivatives up to ``order`` (0, 1 or 2) at points of any shape.

        Returns ``(u,)``, ``(u, u_x, u_y)`` or ``(u, u_x, u_y, u_xx, u_xy, u_yy)``, each of the points' shape. The
        derivatives are exact, and the value at a point does not depend on the other points. ``x`` and ``y`` are not
        written into. Never raises for points inside the closed domain. Values may be non-finite; the caller checks.
        """
        ...


def require_field(field: object, name: str) -> Field:
    """``field`` if it can be evaluated, the expression that a text describes.

    Raises :class:`~equimesh.errors.InputError` for anything else, with ``name`` as its field.
    """
    if isinstance(field, str):
        try:
            return Expression(field)
        except InputError as error:
            error.field = name
            raise
    if not callable(getattr(field, "evaluate", None)):
        what = f"the function {getattr(field, '__name__', '')}" if callable(field) else repr(str(field)[:40])
        raise InputError(
            f"{name} = {what} cannot be evaluated here: give a formula as a text, or values as"
            " em.GridSamples(x=..., y=..., values=...) on a grid, em.NodalField(mesh=..., values=...) at nodes",
            field=name,
        )
    return cast(Field, field)


def require_fields(owner: object, *names: str) -> None:
    """Replace these attributes of a frozen ``owner`` by what :func:`require_field` returns for them."""
    for name in names:
        object.__setattr__(owner, name, require_field(getattr(owner, name), name))
