"""Second-order jets: a function of (x, y) at many points, with its gradient and Hessian.

A component of a jet is an array over the points, a number when it is the same at all points, or ``None`` when it is
zero everywhere; the last two take no time. d/dy of x is ``None``, d/dx of ``15*x`` is ``15.0``.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

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
