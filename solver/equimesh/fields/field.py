"""The interface of scalar functions of the plane."""

from typing import Protocol

from equimesh.errors import InputError
from equimesh.numerics.types import Array


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


def require_field(field: Field, name: str) -> Field:
    """``field`` if it can be evaluated; raises :class:`~equimesh.errors.InputError` for anything else."""
    if not callable(getattr(field, "evaluate", None)):
        raise InputError(
            f"{name} = {str(field)[:40]!r} is not a function of x and y: write em.Expression('...') for a formula,"
            " em.GridSamples(...) for values on a grid",
            field=name,
        )
    return field
