"""Reference elements: the map of a cell from its corners, rules of quadrature, and Lagrange bases of any degree.

A quadrilateral is the image of the unit square, with the corners (0, 0), (1, 0), (1, 1), (0, 1). A triangle is that of
the corners (0, 0), (1, 0), (0, 1).
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache, lru_cache
from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from equimesh.numerics.compiled import inlined
from equimesh.numerics.types import Array, IntArray
from equimesh.quality.cells import CellPoints
from equimesh_coupling.elements import lagrange_functions, lobatto

CellKind: TypeAlias = Literal["quad", "triangle"]
TRIANGLE_RULE = (
    (0.445948490915964886, 0.223381589678011466),
    (0.091576213509770743, 0.109951743655321868),
)
"""Two orbits of the rule of degree 4 with six points: the barycentric coordinate that occurs twice, and the weight.

D. A. Dunavant, *High degree efficient symmetrical Gaussian quadrature rules for the triangle*, Int. J. Numer. Meth.
Eng. 21 (1985). The rule is exact for the squared error of a quadratic u.
"""
FINER_TRIANGLE_RULE = (
    (0.249286745170910421, 0.116786275726379366),
    (0.063089014491502282, 0.050844906370206817),
)
"""Two orbits of the rule of degree 6 with twelve points, from the same source."""
UNEVEN_ORBIT = ((0.053145049844816947, 0.310352451033784405), 0.082851075618373575)
"""Its third orbit: two barycentric coordinates of six points, and the weight."""


CORNERS: Mapping[CellKind, Array] = {
    "quad": np.array([[0.0, 1.0, 1.0, 0.0], [0.0, 0.0, 1.0, 1.0]]),
    "triangle": np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
}
"""s and t of the corners of the reference elements."""


class Element(NamedTuple):
    """A reference element: shape functions and their derivatives at the points of a quadrature rule.

    ``shape``, ``along_s`` and ``along_t`` have the shape ``(points, corners)``; ``weights`` sum to its area.
    """

    shape: Array
    along_s: Array
    along_t: Array
    weights: Array


Jacobian: TypeAlias = tuple[float, float, float, float]
"""x by s and by t, then y by s and by t."""


@inlined
def at_point(
    element: Element, q: int, count: int, corner: Array, row: int, value: float
) -> tuple[Jacobian, tuple[float, float], float]:
    """At point q: the derivatives of the map of a cell, those of a function by s and t, and ``value`` plus its value.

    The first two rows of ``corner`` are x and y of the corners, and ``row`` has the function. It is one loop so that
    the compiler reads the shape functions once; what a caller does not use is not computed.
    """
    x_s, x_t, y_s, y_t, along_s, along_t = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(count):
        x_s += element.along_s[q, k] * corner[0, k]
        x_t += element.along_t[q, k] * corner[0, k]
        y_s += element.along_s[q, k] * corner[1, k]
        y_t += element.along_t[q, k] * corner[1, k]
        along_s += element.along_s[q, k] * corner[row, k]
        along_t += element.along_t[q, k] * corner[row, k]
        value += element.shape[q, k] * corner[row, k]
    return (x_s, x_t, y_s, y_t), (along_s, along_t), value


@inlined
def determinant(by: Jacobian) -> float:
    """The determinant of a map with these derivatives."""
    return by[0] * by[3] - by[1] * by[2]


@inlined
def gradient(s: float, t: float, by: Jacobian, factor: float) -> tuple[float, float]:
    """The gradient of a function with the derivatives ``s`` and ``t``, times the determinant and a ``factor``."""
    return (s * by[3] - t * by[2]) * factor, (t * by[0] - s * by[1]) * factor


@cache
def quadrilateral(points: int) -> Element:
    """The bilinear element with the Gauss rule of this many ``points`` a direction."""
    s, t, weights = CellPoints.gauss(points)
    return Element(
        shape=np.stack([(1 - s) * (1 - t), s * (1 - t), s * t, (1 - s) * t], axis=1),
        along_s=np.stack([t - 1, 1 - t, t, -t], axis=1),
        along_t=np.stack([s - 1, -s, s, 1 - s], axis=1),
        weights=weights,
    )


@cache
def triangle(*, finer: bool = False) -> Element:
    """The linear element with the rule of degree 4, or of degree 6 if it is to be ``finer``."""
    shape, weights = [], []
    for twice, weight in FINER_TRIANGLE_RULE if finer else TRIANGLE_RULE:
        for k in range(3):
            shape.append([1.0 - 2.0 * twice if corner == k else twice for corner in range(3)])
            weights.append(0.5 * weight)
    if finer:
        (one, two), weight = UNEVEN_ORBIT
        three = 1.0 - one - two
        for point in ((one, two, three), (two, three, one), (three, one, two)):
            shape += [[*point], [*point[::-1]]]
            weights += [0.5 * weight] * 2
    return Element(
        shape=np.array(shape),
        along_s=np.tile([-1.0, 1.0, 0.0], (len(weights), 1)),
        along_t=np.tile([-1.0, 0.0, 1.0], (len(weights), 1)),
        weights=np.array(weights),
    )


class Basis(NamedTuple):
    """A Lagrange basis at the points of a rule, and the places of its nodes.

    The first nodes are the corners. ``places`` of shape ``(nodes, corners)`` are the shape functions of the corners at
    the nodes: they map the nodes with the cell. ``value``, ``along_s`` and ``along_t`` are the functions of the basis
    and their derivatives, of shape ``(nodes, points)``.
    """

    places: Array
    value: Array
    along_s: Array
    along_t: Array


def basis(cells: CellKind, degree: int, element: Element) -> Basis:
    """The basis of a ``degree`` at the points of the rule of ``element``.

    Its nodes are the Gauss-Lobatto points of both directions on quadrilaterals; the corners, and the middles of the
    edges for degree 2, on triangles.
    """
    return _basis(cells, degree, element.shape.tobytes())


@lru_cache(maxsize=32)
def _basis(cells: CellKind, degree: int, shape: bytes) -> Basis:
    corners = CORNERS[cells]
    points = np.frombuffer(shape).reshape(-1, corners.shape[1])
    places = shapes_at(cells, *nodes_of(cells, degree)).T.copy()
    return Basis(places, *lagrange(cells, degree, *(corners @ points.T)))


def rule(cells: CellKind, points: int) -> Element:
    """The element with the Gauss rule of so many ``points`` a direction; on triangles, that of about as many."""
    return quadrilateral(points) if cells == "quad" else triangle(finer=points > 3)


@cache
def finer_rule(cells: CellKind, points: int) -> Element:
    """A rule to check others: on triangles the Gauss rule of the square, two corners of which are at one point."""
    element = quadrilateral(points)
    if cells == "quad":
        return element
    s, t, weights = CellPoints.gauss(points)
    return Element(
        shape=np.stack([(1 - s) * (1 - t), s * (1 - t), t], axis=1),
        along_s=np.tile([-1.0, 1.0, 0.0], (s.size, 1)),
        along_t=np.tile([-1.0, 0.0, 1.0], (s.size, 1)),
        weights=weights * (1 - t),
    )


def shapes_at(cells: CellKind, s: Array, t: Array) -> Array:
    """The shape functions of the corners at some points, the first axis for the corners."""
    if cells == "triangle":
        return np.stack([1.0 - s - t, s, t])
    return np.stack([(1 - s) * (1 - t), s * (1 - t), s * t, (1 - s) * t])


@cache
def nodes_of(cells: CellKind, degree: int) -> tuple[Array, Array]:
    """s and t of the nodes of the basis, those of the corners first."""
    if cells == "triangle":
        count = 3 if degree == 1 else 6
        return np.array([0, 1, 0, 0.5, 0.5, 0])[:count], np.array([0, 0, 1, 0, 0.5, 0.5])[:count]
    s, t = np.meshgrid(lobatto(degree), lobatto(degree), indexing="ij")
    order = _corners_first(degree)
    return s.ravel()[order], t.ravel()[order]


@cache
def _corners_first(degree: int) -> IntArray:
    """The numbers of all nodes of a quadrilateral, in rows along t: first the corners, counter-clockwise."""
    numbers = np.arange((degree + 1) ** 2)
    corners = np.array([0, degree * (degree + 1), (degree + 1) ** 2 - 1, degree])
    return np.concatenate([corners, np.setdiff1d(numbers, corners)])


def lagrange(cells: CellKind, degree: int, s: Array, t: Array) -> tuple[Array, Array, Array]:
    """The functions of the basis at some points, and their derivatives along s and t; the first axis for the nodes."""
    if cells == "quad":
        one, two, three = (part[_corners_first(degree)] for part in lagrange_functions(degree, s, t))
        return one, two, three
    corners = shapes_at(cells, s, t)
    slopes = np.array([[-1.0, -1.0], [1.0, 0.0], [0.0, 1.0]])
    ones = np.ones_like(corners)
    if degree == 1:
        return corners, ones * _raised(slopes[:, 0], s), ones * _raised(slopes[:, 1], s)
    ahead = np.roll(corners, -1, axis=0)
    values = np.concatenate([corners * (2.0 * corners - 1.0), 4.0 * corners * ahead])
    derivatives = []
    for slope in slopes.T:
        own, next_one = _raised(slope, s), _raised(np.roll(slope, -1), s)
        middle = 4.0 * (own * ahead + corners * next_one)
        derivatives.append(np.concatenate([own * (4.0 * corners - 1.0), middle]))
    return values, derivatives[0], derivatives[1]


def _raised(numbers: Array, like: Array) -> Array:
    """``numbers`` along the first axis, before the axes of ``like``."""
    return np.reshape(numbers, (-1, *(1 for _ in like.shape)))
