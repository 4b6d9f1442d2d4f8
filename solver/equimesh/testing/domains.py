"""The conformance kit of :class:`~equimesh.domains.domain.Domain`."""

import numpy as np

from equimesh.domains.domain import UNIT, Domain
from equimesh.numerics.types import Array
from equimesh.testing.fields import corners, points_in
from equimesh.testing.functions import check_derivative, check_function, place, require, require_finite

SLOPES = ("x_s", "x_t", "y_s", "y_t")
UNIT_BOX = (UNIT, UNIT)
BEYOND = 1e-5  # distance outside the unit square at which maps must hold, too
LINE = 257  # points a direction, or on a side
PANELS = 64  # a direction, of the integral of the determinant
AREA_ACCURACY = 1e-5  # relative
BOX_ACCURACY = 1e-4  # of the size: no point of the sides comes nearer to the smallest box than this


def check_domain(domain: Domain) -> None:
    """Raise :class:`AssertionError` where ``domain`` breaks a promise of :class:`~equimesh.domains.domain.Domain`.

    Checked: shapes and broadcasting, finite values up to 1e-5 outside the unit square, the Jacobian by Taylor
    remainders, its positive determinant up to the sides, the area as the integral of the determinant, and the box as
    the smallest one that holds the image.
    """
    points = points_in(UNIT_BOX, margin=0.0)
    check_function(domain.map, "map(s, t)", ("x", "y"), points)
    check_function(domain.jacobian, "jacobian(s, t)", SLOPES, points)
    _check_broadcast(domain)
    outside = corners(((-BEYOND, 1.0 + BEYOND), (-BEYOND, 1.0 + BEYOND)))
    for where in (points, outside):
        require_finite(domain.map(*where), "map(s, t)", ("x", "y"), where)
        require_finite(domain.jacobian(*where), "jacobian(s, t)", SLOPES, where)
    x_s, x_t, y_s, y_t = domain.jacobian(*points)
    check_derivative(lambda s, t: domain.map(s, t)[0], (x_s, x_t), ("x_s", "x_t"), points, 1.0)
    check_derivative(lambda s, t: domain.map(s, t)[1], (y_s, y_t), ("y_s", "y_t"), points, 1.0)
    _check_determinant(domain)
    _check_area(domain)
    _check_box(domain)


def _check_broadcast(domain: Domain) -> None:
    s, t = np.linspace(0.0, 1.0, 3)[:, None], np.linspace(0.0, 1.0, 4)[None, :]
    for name, results in (("map(s, t)", domain.map(s, t)), ("jacobian(s, t)", domain.jacobian(s, t))):
        found = {np.shape(result) for result in results}
        require(found == {(3, 4)}, f"{name} of shapes (3, 1) and (1, 4) has shapes {sorted(found)}, not (3, 4)")


def _check_determinant(domain: Domain) -> None:
    line = np.linspace(0.0, 1.0, LINE)
    points = np.repeat(line, LINE), np.tile(line, LINE)
    determinant = _determinant(domain, *points)
    worst = int(determinant.argmin())
    require(
        bool(determinant[worst] > 0.0),
        f"jacobian(s, t): the determinant is {determinant[worst]:.3g} at (s, t) = {place(points, worst)}, and must be"
        " positive",
    )


def _check_area(domain: Domain) -> None:
    nodes, weights = np.polynomial.legendre.leggauss(3)
    line = ((np.arange(PANELS)[:, None] + 0.5 + 0.5 * nodes) / PANELS).ravel()
    share = np.tile(0.5 * weights / PANELS, PANELS)
    exact = float(share @ _determinant(domain, line[:, None], line[None, :]) @ share)
    require(
        abs(domain.area - exact) <= AREA_ACCURACY * exact,
        f"area = {domain.area:.9g}, but the integral of the determinant of jacobian(s, t) is {exact:.9g}",
    )


def _check_box(domain: Domain) -> None:
    line = np.linspace(0.0, 1.0, LINE * 4)
    zero, one = np.zeros_like(line), np.ones_like(line)
    sides = np.concatenate([line, line, zero, one]), np.concatenate([zero, one, line, line])
    for name, coordinate, (low, high) in zip("xy", domain.map(*sides), domain.box, strict=True):
        size = high - low
        for end, wanted, found in (("least", low, coordinate.min()), ("largest", high, coordinate.max())):
            outwards = (wanted - found if end == "least" else found - wanted) / size
            require(
                -BOX_ACCURACY <= outwards <= 1e-9,
                f"box: the {end} {name} of the domain is {found:.9g}, not {wanted:.9g}",
            )


def _determinant(domain: Domain, s: Array, t: Array) -> Array:
    x_s, x_t, y_s, y_t = domain.jacobian(s, t)
    return x_s * y_t - x_t * y_s
