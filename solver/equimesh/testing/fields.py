"""The conformance kit of :class:`~equimesh.fields.field.Field`."""

import numpy as np

from equimesh.domains.domain import UNIT, Box
from equimesh.fields.field import Field
from equimesh.numerics.types import Array
from equimesh.testing.functions import check_derivative, check_function, require_finite
from equimesh.testing.taylor import STEP

DERIVATIVES = ("u", "u_x", "u_y", "u_xx", "u_xy", "u_yy")
COUNTS = (1, 3, 6)  # the number of them for each order
POINTS = 200


def check_field(field: Field, box: Box = (UNIT, UNIT)) -> None:
    """Raise :class:`AssertionError` where ``field`` breaks a promise of :class:`~equimesh.fields.field.Field` in a box.

    The data of the field must be finite in ``box``, which is ``((x0, x1), (y0, y1))``. Checked at random points, which
    are the same in every call: shapes for all three orders, values point by point, arguments that are left alone, and
    each derivative by the Taylor remainder of the one before it.
    """
    size = min(high - low for low, high in box)
    points = points_in(box, margin=STEP * size)
    for order, count in enumerate(COUNTS):
        names, name = DERIVATIVES[:count], f"evaluate(x, y, order={order})"

        def derivatives(x: Array, y: Array, order: int = order) -> tuple[Array, ...]:
            return field.evaluate(x, y, order=order)

        check_function(derivatives, name, names, points)
        require_finite(derivatives(*corners(box)), name, names, corners(box))
        require_finite(derivatives(*points), name, names, points)

    def value(x: Array, y: Array) -> Array:
        return field.evaluate(x, y)[0]

    def u_x(x: Array, y: Array) -> Array:
        return field.evaluate(x, y, order=1)[1]

    def u_y(x: Array, y: Array) -> Array:
        return field.evaluate(x, y, order=1)[2]

    _, *first = field.evaluate(*points, order=1)
    _, again_x, again_y, xx, xy, yy = field.evaluate(*points, order=2)
    check_derivative(value, (first[0], first[1]), ("u_x of order 1", "u_y of order 1"), points, size)
    check_derivative(value, (again_x, again_y), ("u_x of order 2", "u_y of order 2"), points, size)
    check_derivative(u_x, (xx, xy), ("u_xx", "u_xy"), points, size)
    check_derivative(u_y, (xy, yy), ("u_xy", "u_yy"), points, size)


def points_in(box: Box, margin: float = 0.0) -> tuple[Array, Array]:
    """Random points of a box, ``margin`` away from its sides; always the same ones."""
    random = np.random.default_rng(20)
    x, y = (random.uniform(low + margin, high - margin, POINTS) for low, high in box)
    return x, y


def corners(box: Box) -> tuple[Array, Array]:
    """The four corners of a box."""
    (x0, x1), (y0, y1) = box
    return np.array([x0, x1, x1, x0]), np.array([y0, y0, y1, y1])
