"""Objectives whose error is not that of interpolating one function: of a goal, and of a solver.

The error of a functional of a Galerkin solution is ``a(u - u_h, z - z_h)``, with z the solution of the adjoint problem
(R. Becker and R. Rannacher, *An optimal control approach to a posteriori error estimation in finite element methods*,
Acta Numerica 10, 2001). It is at most the sum over the cells K of ``|e_u|_K |e_z|_K``, the norms of the errors of both
gradients. With z = u that is the squared error in H1.

The sum is larger than the error: around a point whose value is the functional, parts of both signs cancel. On step-14
of deal.II it fell from 1.0e-4 to 3.7e-5, and the error from 4e-5 to 1e-6. Recovered u and z tell the error of a
functional to a factor of two where z is smooth. Around a point nothing but a solution of degree 2 does.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from equimesh.fields.expression import Field
from equimesh.least_error import kernels
from equimesh.least_error.evaluation import OF_PROJECTION
from equimesh.least_error.kernels import SUMS, NodalValues, Nodes, Values
from equimesh.least_error.objective import Objective
from equimesh.least_error.projection import (
    Places,
    Unknowns,
    are_finite,
    matrix_for,
    of_four_corners,
    projected_errors,
    unknowns_of,
)
from equimesh.numerics.types import Array
from equimesh.quality.elements import Element

LEAST_SHARE = 1e-12
"""The least squared error of a cell over the mean: where one of both is zero, the other still counts a little."""


@dataclass(frozen=True, kw_only=True, eq=False)
class DualField:
    """A solution ``u``, whose error counts on each cell as much as that of the ``adjoint`` is large.

    Implements :class:`~equimesh.fields.expression.Field`: as a function it is u.
    """

    u: Field
    adjoint: Field

    def evaluate(self, x: Array, y: Array, order: int = 0) -> tuple[Array, ...]:
        """u and its partial derivatives up to ``order``: see ``Field.evaluate``."""
        return self.u.evaluate(x, y, order)


class DualObjective(Objective):
    """The objective with the sum of the products of two errors, in place of the squared error of one function.

    Both are errors of bilinear interpolation, in the norm of the rule. They are computed by the loops for one function
    on cells without common nodes: with the factors ``|e_z| / |e_u|`` and ``|e_u| / |e_z|`` of a cell, the derivative of
    the product is the mean of those of both squares.
    """

    def _squared_error(self, nodes: Nodes) -> float:
        """The sum of the products, with its sums of the nodes in place of all others; infinite where not finite."""
        both: Any = self._u
        corners = nodes.corners
        apart = Nodes(nodes.x[corners], nodes.y[corners], np.arange(corners.size))
        found = [self._of(field, nodes, apart) for field in (both.u, both.adjoint)]
        if any(one is None for one in found):
            return math.inf
        (squares, sums), (others, other_sums) = found  # type: ignore[misc]
        squares, others = (one + LEAST_SHARE * one.mean() for one in (squares, others))
        if not (squares.all() and others.all()):  # one of both is known exactly
            self._sums.fill(0.0)
            return 0.0
        products = np.sqrt(squares * others)
        halves = np.repeat(0.5 * products / squares, 4)[:, None], np.repeat(0.5 * products / others, 4)[:, None]
        own = halves[0] * sums + halves[1] * other_sums
        self._sums[:] = np.add.reduceat(own[self.cells.places], self.cells.starts[:-1])
        return float(products.sum())

    def _of(self, u: Field, nodes: Nodes, apart: Nodes) -> tuple[Array, Array] | None:
        """The squared errors of all cells, and the sums of all corners; ``None`` where u is not finite."""
        element, elements, rule = self._rule.element, self._elements, self._rule
        shape, split = (element.weights.size, len(elements)), nodes.x.size
        x, y = np.empty((2, split + shape[0] * shape[1]))
        x[:split], y[:split] = nodes.x, nodes.y
        kernels.place_points(nodes, elements, element.shape, split, x, y)
        values = u.evaluate(x, y, order=2 if rule.norm == "h1" else 1)
        if not math.isfinite(sum(float(part[split:].sum()) for part in values)):
            return None
        nodal = NodalValues(*(part[:split].copy() for part in values[:3]))
        if not self._has_slopes(nodes, nodal, u):
            return None
        corner = NodalValues(*(part[nodes.corners] for part in nodal))
        at = [np.ascontiguousarray(part[split:].reshape(shape)) for part in values]
        sums = np.zeros((nodes.corners.size, SUMS))
        if rule.norm == "h1":
            kernels.slope_errors(apart, elements, element, corner, Values(*at), sums)
        else:
            kernels.value_errors(apart, elements, element, corner, NodalValues(*at[:3]), sums)
        return squared_errors(apart, element, corner.u, at, rule.norm), sums


class ProjectedObjective(Objective):
    """The objective with the error of the Ritz projection of u, for degree 1 and the norm of u."""

    def _squared_error(self, nodes: Nodes) -> float:
        """The square of the error, with its sums of the nodes in place of all others; negative without a projection."""
        element, elements = self._rule.element, self._elements
        nodal, values = self._at_once(nodes)
        if not self._has_slopes(nodes, nodal):
            return math.inf
        at = Values(*(part.reshape(element.weights.size, -1) for part in values))
        if not are_finite(at):
            return math.inf
        self._sums.fill(0.0)
        elements, element = of_four_corners(elements, element)
        self._matrix.fill(0.0)
        places, number = Places(nodes, elements, nodal, at), unknowns_of(self.cells).number
        return float(projected_errors(places, element, number, self._matrix, self._sums))

    def _kind_of_error(self) -> tuple[int, Unknowns | None]:
        return OF_PROJECTION, unknowns_of(self.cells)

    @property
    def _order(self) -> int:
        return 2

    @cached_property
    def _matrix(self) -> Array:
        """Memory that is kept: to get its pages anew for each mesh takes as long as to compute with it."""
        return matrix_for(unknowns_of(self.cells))


def objective_of(u: Field) -> type[Objective]:
    """The class of the objective of interpolating ``u``."""
    return DualObjective if isinstance(u, DualField) else Objective


def squared_errors(apart: Nodes, element: Element, corner: Array, at: list[Array], norm: str) -> Array:
    """The squared error of the interpolant of ``corner`` values on each cell; see :class:`DualObjective`."""
    x, y, u = (np.ascontiguousarray(part.reshape(-1, 4).T) for part in (apart.x, apart.y, corner))
    (x_s, x_t), (y_s, y_t) = ((element.along_s @ q, element.along_t @ q) for q in (x, y))
    det = x_s * y_t - x_t * y_s
    if norm == "l2":
        return element.weights @ (det * (element.shape @ u - at[0]) ** 2)
    u_s, u_t = element.along_s @ u, element.along_t @ u
    e_x, e_y = (u_s * y_t - u_t * y_s) / det - at[1], (u_t * x_s - u_s * x_t) / det - at[2]
    found: Array = element.weights @ (det * (e_x**2 + e_y**2))
    return found
