"""Second-order jets: functions of (x, y) with gradient and Hessian, and the operations of expressions on them.

A component of a jet is an array over the points, a number when it is the same at all points, or ``None`` when it is
zero everywhere; the last two take no time. d/dy of x is ``None``, d/dx of ``15*x`` is ``15.0``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np
import scipy

Component: TypeAlias = Any  # array of one block of points, np.float64, or None: see the module's docstring
FIRST = (0, 1)
SECOND = ((0, 0), (0, 1), (1, 1))  # the indices of xx, xy, yy


@dataclass(frozen=True, slots=True)
class Jet:
    """``value``, ``gradient`` (x, y) and ``hessian`` (xx, xy, yy); a condition is a jet with truth values."""

    value: Component
    gradient: tuple[Component, Component] = (None, None)
    hessian: tuple[Component, Component, Component] = (None, None, None)

    @property
    def is_flat(self) -> bool:
        """Whether the derivatives are zero everywhere."""
        return self.gradient[0] is None and self.gradient[1] is None

    @property
    def number(self) -> float | None:
        """The value when it is one number at all points, else ``None``."""
        return float(self.value) if self.is_flat and isinstance(self.value, float) else None

    def components(self, order: int) -> tuple[Component, ...]:
        """``(u,)``, ``(u, u_x, u_y)`` or ``(u, u_x, u_y, u_xx, u_xy, u_yy)``."""
        return (self.value, *self.gradient, *self.hessian)[: (1, 3, 6)[order]]


def constant(value: float) -> Jet:
    """The jet of a number."""
    return Jet(np.float64(value))


def coordinates(x: Component, y: Component) -> tuple[Jet, Jet]:
    """The jets of the functions x and y."""
    one = np.float64(1.0)
    return Jet(x, (one, None)), Jet(y, (None, one))


def times(a: Component, b: Component) -> Component:
    """Product of two components, nothing where one vanishes."""
    if a is None or b is None:
        return None
    if isinstance(a, float):
        if a == 1.0:
            return b
        if a == 0.0:
            return None
    if isinstance(b, float):
        if b == 1.0:
            return a
        if b == 0.0:
            return None
    return a * b


def plus(a: Component, b: Component) -> Component:
    """Sum of two components."""
    if a is None:
        return b
    return a if b is None else a + b


def minus(a: Component, b: Component) -> Component:
    """Difference of two components."""
    if b is None:
        return a
    return -b if a is None else a - b


def over(a: Component, b: Component) -> Component:
    """Quotient of a component and a value."""
    return None if a is None else a / b


def each(combine: Callable[[Component, Component], Component], a: Jet, b: Jet, value: Component) -> Jet:
    """A jet whose derivatives are linear in those of ``a`` and ``b``, one by one."""
    gradient = tuple(combine(p, q) for p, q in zip(a.gradient, b.gradient, strict=True))
    hessian = tuple(combine(p, q) for p, q in zip(a.hessian, b.hessian, strict=True))
    return Jet(value, gradient, hessian)


def add(a: Jet, b: Jet, order: int) -> Jet:  # noqa: ARG001 - one signature for all operations
    """``a + b``."""
    return each(plus, a, b, a.value + b.value)


def subtract(a: Jet, b: Jet, order: int) -> Jet:  # noqa: ARG001
    """``a - b``."""
    return each(minus, a, b, a.value - b.value)


def negate(a: Jet, order: int) -> Jet:  # noqa: ARG001
    """``-a``."""
    return each(lambda p, _: None if p is None else -p, a, a, -a.value)


def multiply(a: Jet, b: Jet, order: int) -> Jet:
    """``a * b``."""
    u, v, du, dv = a.value, b.value, a.gradient, b.gradient
    if order == 0:
        return Jet(u * v)
    gradient = tuple(plus(times(du[i], v), times(u, dv[i])) for i in FIRST)
    if order == 1:
        return Jet(u * v, gradient)
    hessian = tuple(
        plus(
            plus(times(a.hessian[k], v), times(u, b.hessian[k])),
            times(np.float64(2.0), times(du[i], dv[i])) if i == j else plus(times(du[i], dv[j]), times(du[j], dv[i])),
        )
        for k, (i, j) in enumerate(SECOND)
    )
    return Jet(u * v, gradient, hessian)


def divide(a: Jet, b: Jet, order: int) -> Jet:
    """``a / b``, by differentiating ``q b = a``: no square of b that could overflow."""
    q, b_ = a.value / b.value, b.value
    if order == 0:
        return Jet(q)
    if b.is_flat:
        return each(lambda p, _: over(p, b_), a, b, q)
    dq = tuple(over(minus(a.gradient[i], times(q, b.gradient[i])), b_) for i in FIRST)
    if order == 1:
        return Jet(q, dq)
    hessian = tuple(
        over(
            minus(
                minus(a.hessian[k], times(q, b.hessian[k])),
                plus(times(dq[i], b.gradient[j]), times(dq[j], b.gradient[i])),
            ),
            b_,
        )
        for k, (i, j) in enumerate(SECOND)
    )
    return Jet(q, dq, hessian)


def chain(a: Jet, f: Component, f1: Component, f2: Component, order: int) -> Jet:
    """``f(a)`` from f, f' and f'' at the value of ``a``."""
    gradient = tuple(times(f1, a.gradient[i]) for i in FIRST)
    if order == 1:
        return Jet(f, gradient)
    hessian = tuple(
        plus(times(f1, a.hessian[k]), times(f2, times(a.gradient[i], a.gradient[j]))) for k, (i, j) in enumerate(SECOND)
    )
    return Jet(f, gradient, hessian)


def chain2(a: Jet, b: Jet, f: Component, f1: Sequence[Component], f2: Sequence[Component], order: int) -> Jet:
    """``f(a, b)`` from f, its gradient (f_a, f_b) and its Hessian (f_aa, f_ab, f_bb)."""
    linear = each(lambda p, q: plus(times(f1[0], p), times(f1[1], q)), a, b, f)
    if order == 1:
        return Jet(f, linear.gradient)
    da, db = a.gradient, b.gradient
    hessian = tuple(
        plus(
            plus(linear.hessian[k], times(f2[0], times(da[i], da[j]))),
            plus(
                times(f2[1], plus(times(da[i], db[j]), times(da[j], db[i]))),
                times(f2[2], times(db[i], db[j])),
            ),
        )
        for k, (i, j) in enumerate(SECOND)
    )
    return Jet(f, linear.gradient, hessian)


# The operations and functions of expressions, on second-order jets.
#
# Where a function has no derivative, these choices hold. ``abs`` and ``sign`` have slope 0 at 0. ``min`` and ``max``
# take the mean of the two slopes at a tie. ``where`` has the derivatives of the branch taken. The tip of a cone has
# gradient and Hessian 0: ``hypot(a, b)`` where both vanish, ``sqrt(a)`` and ``a**p``, p >= 1/2, where ``a`` and its
# gradient vanish. Real singularities stay visible: ``sqrt(x)`` has infinite slope at 0.

MAX_MULTIPLIED_POWER = 16  # larger integer powers are left to np.power


def _smooth_tip(a: Jet, f1: Component, f2: Component) -> tuple[Component, Component]:
    """f' and f'' set to 0 where ``a`` and its gradient vanish: the tip of a cone, not a singular slope."""
    tip = a.value == 0.0
    if not np.any(tip):
        return f1, f2
    for slope in a.gradient:
        if slope is not None:
            tip = tip & (slope == 0.0)
    return np.where(tip, 0.0, f1), None if f2 is None else np.where(tip, 0.0, f2)


def _integer_power(u: Component, n: int) -> Component:
    if n > MAX_MULTIPLIED_POWER:
        return np.power(u, float(n))
    result: Component = None
    while n:
        if n & 1:
            result = u if result is None else result * u
        n >>= 1
        u = u * u if n else u
    return np.float64(1.0) if result is None else result


def sqrt(a: Jet, order: int) -> Jet:
    """The square root; see the module's docstring for its slope at 0."""
    f = np.sqrt(a.value)
    if order == 0 or a.is_flat:
        return Jet(f)
    f1 = 0.5 / f
    f2 = -0.5 * f1 / a.value if order == 2 else None
    return chain(a, f, *_smooth_tip(a, f1, f2), order)


def power(a: Jet, b: Jet, order: int) -> Jet:
    """``a ** b``: any base for an integer number ``b``, a base that is not negative for any other."""
    u, n = a.value, b.number
    if n is None:
        return _general_power(a, b, order)
    if n == 0.5:
        return sqrt(a, order)
    if n.is_integer():
        if n < 0:
            return divide(constant(1.0), power(a, constant(-n), order), order)
        k = int(n)
        if order == 0 or a.is_flat or k < 2:
            return a if k == 1 else Jet(_integer_power(u, k))
        p2 = _integer_power(u, k - 2)
        p1 = p2 * u
        return chain(a, p1 * u, n * p1, n * (n - 1.0) * p2, order)
    f = np.power(u, n)
    if order == 0 or a.is_flat:
        return Jet(f)
    f1 = n * np.power(u, n - 1.0)
    f2 = n * (n - 1.0) * np.power(u, n - 2.0) if order == 2 else None
    return chain(a, f, *(_smooth_tip(a, f1, f2) if n > 0.5 else (f1, f2)), order)


def _general_power(a: Jet, b: Jet, order: int) -> Jet:
    u, w = a.value, b.value
    f = np.power(u, w)
    if order == 0:
        return Jet(f)
    log = np.where(u == 0.0, 0.0, np.log(u)) if a.number is None else np.log(u)  # u^w log u -> 0 with u, w > 0
    below = None if a.is_flat else np.power(u, w - 1.0)
    f1 = (None if a.is_flat else w * below, f * log)
    if order == 1:
        return chain2(a, b, f, f1, (), order)
    f2 = (
        None if a.is_flat else w * (w - 1.0) * np.power(u, w - 2.0),
        None if a.is_flat else below * (1.0 + w * log),
        f1[1] * log,
    )
    return chain2(a, b, f, f1, f2, order)


def hypot(a: Jet, b: Jet, order: int) -> Jet:
    """``sqrt(a**2 + b**2)`` without overflow."""
    h = np.hypot(a.value, b.value)
    if order == 0:
        return Jet(h)
    r = np.where(h == 0.0, 0.0, 1.0 / h)
    c, s = a.value * r, b.value * r
    return chain2(a, b, h, (c, s), (s * s * r, -c * s * r, c * c * r) if order == 2 else (), order)


def atan2(a: Jet, b: Jet, order: int) -> Jet:
    """The angle of the point (b, a); no derivative at the origin."""
    f = np.arctan2(a.value, b.value)
    if order == 0:
        return Jet(f)
    r = 1.0 / np.hypot(a.value, b.value)
    c, s = b.value * r, a.value * r
    return chain2(a, b, f, (c * r, -s * r), (-2.0 * c * s * r * r, (s * s - c * c) * r * r, 2.0 * c * s * r * r), order)


def where(condition: Jet, a: Jet, b: Jet, order: int) -> Jet:  # noqa: ARG001
    """``a`` where the condition holds, else ``b``; the other branch has no influence, even if it is nan."""

    def pick(p: Component, q: Component) -> Component:
        if p is None and q is None:
            return None
        return np.where(condition.value, 0.0 if p is None else p, 0.0 if q is None else q)

    return each(pick, a, b, pick(a.value, b.value))


def _extremum(less: Callable[..., Any], choose: Callable[..., Any]) -> Callable[..., Jet]:
    def pair(a: Jet, b: Jet, order: int) -> Jet:
        value = choose(a.value, b.value)
        if order == 0:
            return Jet(value)
        first, tie = less(a.value, b.value), a.value == b.value
        taken = where(Jet(first), a, b, order)
        if np.any(tie):
            half = constant(0.5)
            taken = where(Jet(tie), multiply(half, add(a, b, order), order), taken, order)
        return Jet(value, taken.gradient, taken.hessian)

    def fold(*arguments: Any) -> Jet:
        *jets, order = arguments
        result = jets[0]
        for jet in jets[1:]:
            result = pair(result, jet, order)
        return result  # type: ignore[no-any-return]

    return fold


# name: f(v), f'(v, f), f''(v, f, f')
SMOOTH: Mapping[str, tuple[Callable[..., Any], Callable[..., Any], Callable[..., Any]]] = MappingProxyType(
    {
        "sin": (np.sin, lambda v, _: np.cos(v), lambda _v, f, _: -f),
        "cos": (np.cos, lambda v, _: -np.sin(v), lambda _v, f, _: -f),
        "tan": (np.tan, lambda _, f: 1.0 + f * f, lambda _, f, f1: 2.0 * f * f1),
        "asin": (np.arcsin, lambda v, _: 1.0 / np.sqrt(1.0 - v * v), lambda v, _, f1: v * f1 * f1 * f1),
        "acos": (np.arccos, lambda v, _: -1.0 / np.sqrt(1.0 - v * v), lambda v, _, f1: v * f1 * f1 * f1),
        "atan": (np.arctan, lambda v, _: 1.0 / (1.0 + v * v), lambda v, _, f1: -2.0 * v * f1 * f1),
        "sinh": (np.sinh, lambda v, _: np.cosh(v), lambda _v, f, _: f),
        "cosh": (np.cosh, lambda v, _: np.sinh(v), lambda _v, f, _: f),
        "tanh": (np.tanh, lambda _, f: 1.0 - f * f, lambda _, f, f1: -2.0 * f * f1),
        "asinh": (np.arcsinh, lambda v, _: 1.0 / np.hypot(1.0, v), lambda v, _, f1: -v * f1 * f1 * f1),
        "acosh": (
            np.arccosh,
            lambda v, _: 1.0 / (np.sqrt(v - 1.0) * np.sqrt(v + 1.0)),
            lambda v, _, f1: -v * f1 * f1 * f1,
        ),
        "atanh": (np.arctanh, lambda v, _: 1.0 / (1.0 - v * v), lambda v, _, f1: 2.0 * v * f1 * f1),
        "exp": (np.exp, lambda _, f: f, lambda _v, f, _: f),
        "log": (np.log, lambda v, _: 1.0 / v, lambda _v, _, f1: -f1 * f1),
        "log2": (np.log2, lambda v, _: 1.0 / (math.log(2.0) * v), lambda v, _, f1: -f1 / v),
        "log10": (np.log10, lambda v, _: 1.0 / (math.log(10.0) * v), lambda v, _, f1: -f1 / v),
        "erf": (
            lambda v: scipy.special.erf(v),  # SciPy's functions are loaded when one is needed
            lambda v, _: 2.0 / math.sqrt(math.pi) * np.exp(-v * v),
            lambda v, _, f1: -2.0 * v * f1,
        ),
    }
)


def _smooth(name: str) -> Callable[..., Jet]:
    f, f1, f2 = SMOOTH[name]

    def function(a: Jet, order: int) -> Jet:
        v = a.value
        value = f(v)
        if order == 0 or a.is_flat:
            return Jet(value)
        slope = f1(v, value)
        return chain(a, value, slope, f2(v, value, slope) if order == 2 else None, order)

    return function


def absolute(a: Jet, order: int) -> Jet:
    """``|a|``."""
    return chain(a, np.abs(a.value), np.sign(a.value), None, order)


def _pointwise(relation: Callable[..., Any]) -> Callable[..., Jet]:
    return lambda *arguments: Jet(relation(*(jet.value for jet in arguments[:-1])))


#: Every operation by its sign or name, called with its jets and the requested order of derivatives.
OPERATIONS: Mapping[str, Callable[..., Jet]] = MappingProxyType(
    {
        "+": add,
        "-": subtract,
        "*": multiply,
        "/": divide,
        "**": power,
        "negative": negate,
        **{name: _smooth(name) for name in SMOOTH},
        "abs": absolute,
        "sqrt": sqrt,
        "hypot": hypot,
        "atan2": atan2,
        "sign": _pointwise(np.sign),
        "min": _extremum(np.less, np.minimum),
        "max": _extremum(np.greater, np.maximum),
        "where": where,
        "<": _pointwise(np.less),
        "<=": _pointwise(np.less_equal),
        ">": _pointwise(np.greater),
        ">=": _pointwise(np.greater_equal),
        "==": _pointwise(np.equal),
        "!=": _pointwise(np.not_equal),
        "and": _pointwise(np.logical_and),
        "or": _pointwise(np.logical_or),
        "not": _pointwise(np.logical_not),
    }
)
