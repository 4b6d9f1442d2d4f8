"""The interface of scalar functions of the plane."""

from typing import Protocol, cast

from equimesh.errors import InputError
from equimesh.fields.expression import Expression
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
        raise InputError(
            f"{name} = {str(field)[:40]!r} is not a function of x and y: write em.Expression('...') for a formula,"
            " em.GridSamples(...) for values on a grid",
            field=name,
        )
    return cast(Field, field)


def require_fields(owner: object, *names: str) -> None:
    """Replace these attributes of a frozen ``owner`` by what :func:`require_field` returns for them."""
    for name in names:
        object.__setattr__(owner, name, require_field(getattr(owner, name), name))
