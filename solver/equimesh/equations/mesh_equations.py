"""The discrete local equidistribution equations on a window of the grid.

The same class is used for the whole grid and for every subdomain. It holds the equations of the window's interior
nodes and the conditions that close the window's four sides: the physical boundary, or an interface.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol, TypeAlias

import numpy as np
import scipy

from equimesh.equations.metric import ReferenceMetric, Tensor, Vector, quadratic
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.types import Array, IntArray

# Metric lengths of edges, and how they change as nodes move.


@dataclass(frozen=True)
class SeenGradient:
    """The gradient of u by difference stencils (Haynes and Howse, the vector w of section 4).

    All arrays have one shape, with one entry for each stencil.
    """

    x_xi: Array
    y_xi: Array
    x_eta: Array
    y_eta: Array
    u_xi: Array
    u_eta: Array

    @property
    def jacobian(self) -> Array:
        """``x_xi y_eta - x_eta y_xi``."""
        return self.x_xi * self.y_eta - self.x_eta * self.y_xi

    def of(self, along_xi: Array | float, along_eta: Array | float) -> Vector:
        """The gradient of a quantity whose computational derivatives are given."""
        j = self.jacobian
        return (
            (along_xi * self.y_eta - along_eta * self.y_xi) / j,
            (along_eta * self.x_xi - along_xi * self.x_eta) / j,
        )

    @property
    def gradient(self) -> Vector:
        """The gradient of u."""
        return self.of(self.u_xi, self.u_eta)


@dataclass(frozen=True)
class LocalMetric:
    """The metric at some points, with the gradient of u by the stencils there; all of one shape."""

    metric: ReferenceMetric
    point: Vector
    g: Vector

    @cached_property
    def base(self) -> Tensor:
        """The pointwise part ``B``."""
        return self.metric.base(*self.point)

    @cached_property
    def slopes(self) -> tuple[Tensor, Tensor] | None:
        """The derivatives of ``B`` by the two coordinates of the point; ``None`` where it is constant."""
        return self.metric.base_slopes(*self.point)

    @cached_property
    def strength(self) -> tuple[Array, Array, Vector]:
        """``k``, its derivative by ``g . B^-1 g``, and ``B^-1 g``."""
        return self.metric.strength(self.g, self.base)


@dataclass(frozen=True)
class HalfFlux:
    """Half the squared metric length ``f`` of the direction ``d``, and its derivatives."""

    d: Vector
    local: LocalMetric

    @cached_property
    def value(self) -> Array:
        """``f``."""
        k, _, _ = self.local.strength
        return 0.5 * (quadratic(self.local.base, self.d) + k * self._along_gradient**2)

    @cached_property
    def by_direction(self) -> Vector:
        """The derivative by ``d``."""
        (b11, b12, b22), g, d = self.local.base, self.local.g, self.d
        kgd = self.local.strength[0] * self._along_gradient
        return b11 * d[0] + b12 * d[1] + kgd * g[0], b12 * d[0] + b22 * d[1] + kgd * g[1]

    @cached_property
    def by_gradient(self) -> Vector:
        """The derivative by ``g``."""
        k, slope, raised = self.local.strength
        gd = self._along_gradient
        return slope * gd**2 * raised[0] + k * gd * self.d[0], slope * gd**2 * raised[1] + k * gd * self.d[1]

    @cached_property
    def by_position(self) -> Vector | None:
        """The derivative by the point where ``B`` is taken; ``None`` where that is constant."""
        if self.local.slopes is None:
            return None
        # B enters through d . B d, and through g . B^-1 g with the derivative -(B^-1 g) . dB (B^-1 g).
        _, slope, raised = self.local.strength
        weight = slope * self._along_gradient**2
        first, second = (0.5 * (quadratic(c, self.d) - weight * quadratic(c, raised)) for c in self.local.slopes)
        return first, second

    def by_node(self, weight: Array | float, share: Array | float, spread: Vector, excess: Vector) -> Vector:
        """Derivative of ``f`` by the position of one stencil node.

        ``weight`` is the node's weight in ``d``, ``share`` that in the point, ``spread`` its ``G_c``, ``excess`` its
        ``grad u(c) - g``.
        """
        through_g = self.by_gradient[0] * spread[0] + self.by_gradient[1] * spread[1]
        by_node = (
            self.by_direction[0] * weight + through_g * excess[0],
            self.by_direction[1] * weight + through_g * excess[1],
        )
        if self.by_position is None:
            return by_node
        return by_node[0] + share * self.by_position[0], by_node[1] + share * self.by_position[1]

    @property
    def _along_gradient(self) -> Array:
        g, d = self.local.g, self.d
        return np.asarray(g[0] * d[0] + g[1] * d[1])


Triplet: TypeAlias = tuple[IntArray, IntArray, Array]
Triplets: TypeAlias = list[Triplet]

# The corners of a cell, counter-clockwise, as offsets along (xi, eta).
CORNERS = ((0, 0), (1, 0), (1, 1), (0, 1))
# Its four edges as (first corner, second corner, row of the equations they enter). The flux through an edge enters
# the equation of its first corner with a plus, that of its second with a minus.
EDGES = ((0, 1, 0), (3, 2, 0), (0, 3, 1), (1, 2, 1))


@dataclass(frozen=True)
class NodalState:
    """Node coordinates and u with its gradient on a window of the grid, arrays of shape ``(m_xi, m_eta)``.

    Coordinates are those of the reference square. ``numbers`` are those of the unknowns x and y of every node.
    """

    x: Array
    y: Array
    u: Array
    u_x: Array
    u_y: Array
    numbers: tuple[IntArray, IntArray]
    d_xi: float
    d_eta: float
    metric: ReferenceMetric

    def turned(self) -> NodalState:
        """The same window with the roles of (x, xi) and (y, eta) exchanged; the equations do not change."""
        return NodalState(
            x=self.y.T,
            y=self.x.T,
            u=self.u.T,
            u_x=self.u_y.T,
            u_y=self.u_x.T,
            numbers=(self.numbers[1].T, self.numbers[0].T),
            d_xi=self.d_eta,
            d_eta=self.d_xi,
            metric=replace(self.metric, turned=not self.metric.turned),
        )


@dataclass(frozen=True)
class Rows:
    """Some rows of the system: their numbers, values, and, on request, derivatives as triplets.

    Row ``r`` is the equation attached to unknown ``r``. ``triplets`` gives (row, column, value) arrays of equal
    length; equal pairs add up.
    """

    rows: IntArray
    values: Array
    triplets: Callable[[], Triplets]


class Condition(Protocol):
    """The condition that closes one side of a window: one equation for each unknown of the side.

    Its equations replace those of the interior, and of earlier conditions, for the same unknowns.
    """

    def rows(self, window: NodalState) -> Rows:
        """The equations at the present state of the window."""
        ...


class MeshEquations:
    """Residual and Jacobian of the discrete equations on one window.

    The unknown vector ``z`` holds x, then y, of all nodes of the window in C order. Interior equations: the squared
    metric lengths ``S1^2`` of the two xi-edges that meet at a node are equal, and so are ``S2^2`` of the two
    eta-edges (Haynes and Howse, equation (4), squared and differenced; edge metrics are means of the two adjacent
    cells). Second order in the spacing, 9-point stencil.

    ``cross_line`` > 0 is the weight of an additional term: ``x_etaeta`` in the first and ``y_xixi`` in the second
    equation. Without it neighbouring lines are coupled through the metric only. With it the equations are elliptic, and
    often have a valid solution where they had none.
    """

    def __init__(
        self,
        metric: ReferenceMetric,
        shape: tuple[int, int],
        spacing: tuple[float, float],
        conditions: Sequence[Condition],
        cross_line: float = 0.0,
    ) -> None:
        self.metric = metric
        self.shape = shape
        self.d_xi, self.d_eta = spacing
        self.conditions = tuple(conditions)
        self.cross_line = cross_line
        self.size = shape[0] * shape[1]
        number = np.arange(self.size).reshape(shape)
        self.numbers = (number, number + self.size)

    def window(self, z: Array) -> NodalState:
        """The state of the window at ``z``; u is not finite where the nodes leave its domain of definition."""
        x, y = z[: self.size].reshape(self.shape), z[self.size :].reshape(self.shape)
        u, u_x, u_y = self.metric.u_with_gradient(x, y)
        return NodalState(x, y, u, u_x, u_y, self.numbers, self.d_xi, self.d_eta, self.metric)

    @staticmethod
    def vector(mesh: Mesh) -> Array:
        """The unknowns of a mesh of the window's shape."""
        return np.concatenate([mesh.x.ravel(), mesh.y.ravel()])

    def mesh(self, z: Array) -> Mesh:
        """The mesh of the unknowns ``z``."""
        return Mesh(z[: self.size].reshape(self.shape).copy(), z[self.size :].reshape(self.shape).copy())

    def residual(self, z: Array) -> Array:
        """``F(z)``, an equation per unknown; dimensionless."""
        window = self.window(z)
        value = np.zeros(2 * self.size)
        for interior in self._interior(window):
            np.add.at(value, interior.rows, interior.values)
        for condition in self.conditions:
            closing = condition.rows(window)
            value[closing.rows] = closing.values
        return value

    def jacobian(self, z: Array) -> scipy.sparse.csc_array:
        """The sparse derivative of :meth:`residual`, exact for the discrete equations."""
        window = self.window(z)
        closings = [condition.rows(window) for condition in self.conditions]
        owner = np.zeros(2 * self.size, dtype=np.int64)
        for number, closing in enumerate(closings, 1):
            owner[closing.rows] = number
        parts = [_owned(part, owner, 0) for interior in self._interior(window) for part in interior.triplets()]
        for number, closing in enumerate(closings, 1):
            parts.extend(_owned(part, owner, number) for part in closing.triplets())
        rows, columns, data = (np.concatenate([part[k] for part in parts]) for k in range(3))
        return scipy.sparse.coo_array((data, (rows, columns)), shape=(2 * self.size, 2 * self.size)).tocsc()

    def mean_flux(self, z: Array) -> float:
        """The mean squared metric length of the coordinate directions: the natural unit of the residual."""
        return float(np.mean([2 * flux.value for flux in Cells(self.window(z)).fluxes]))

    def _interior(self, window: NodalState) -> list[Rows]:
        flux = self._interior_rows(window)
        return [flux, self._cross_line_rows(window)] if self.cross_line else [flux]

    def _cross_line_rows(self, window: NodalState) -> Rows:
        """The second difference of x along eta, and of y along xi, times the weight of the cross-line term."""
        rows, values = [], []
        triplets: Triplets = []
        fields = ((window.x, self.numbers[0], self.d_eta), (window.y.T, self.numbers[1].T, self.d_xi))
        for q, number, spacing in fields:
            row, scale = number[1:-1, 1:-1].ravel(), self.cross_line / spacing**2
            rows.append(row)
            values.append(scale * (q[1:-1, 2:] - 2 * q[1:-1, 1:-1] + q[1:-1, :-2]).ravel())
            for shift, weight in ((0, 1.0), (1, -2.0), (2, 1.0)):
                column = number[1:-1, shift : number.shape[1] - 2 + shift].ravel()
                triplets.append((row, column, np.full(row.size, weight * scale)))
        return Rows(np.concatenate(rows), np.concatenate(values), lambda: triplets)

    def _interior_rows(self, window: NodalState) -> Rows:
        cells = Cells(window)
        rows, values = [], []
        for (first, second, component), flux in zip(EDGES, cells.fluxes, strict=True):
            for corner, sign in ((first, 1.0), (second, -1.0)):
                inside = self._cells_with_interior_corner(corner)
                rows.append(cells.unknown(corner, component)[inside].ravel())
                values.append(sign * flux.value[inside].ravel())
        return Rows(np.concatenate(rows), np.concatenate(values), lambda: self._interior_triplets(cells))

    def _interior_triplets(self, cells: Cells) -> Triplets:
        triplets = []
        for (first, second, component), by_unknown in zip(EDGES, cells.flux_derivatives, strict=True):
            for corner, sign in ((first, 1.0), (second, -1.0)):
                inside = self._cells_with_interior_corner(corner)
                row = cells.unknown(corner, component)[inside].ravel()
                for node in range(4):
                    for axis in range(2):
                        column = cells.unknown(node, axis)[inside].ravel()
                        triplets.append((row, column, sign * by_unknown[node][axis][inside].ravel()))
        return triplets

    @staticmethod
    def _cells_with_interior_corner(corner: int) -> tuple[slice, slice]:
        """The cells whose given corner is an interior node of the window."""
        along_xi, along_eta = CORNERS[corner]
        return (
            slice(0, -1) if along_xi else slice(1, None),
            slice(0, -1) if along_eta else slice(1, None),
        )


def _owned(part: Triplet, owner: IntArray, number: int) -> Triplet:
    """The entries of some rows of the Jacobian, without the rows that another condition replaces."""
    row, column, data = part[0].ravel(), part[1].ravel(), part[2].ravel()
    kept = owner[row] == number
    return (row, column, data) if kept.all() else (row[kept], column[kept], data[kept])


class Cells:
    """All cells of a window at once: fluxes through their four edges and derivatives by their eight unknowns."""

    def __init__(self, window: NodalState) -> None:
        self.window = window

    def corner(self, values: Array, corner: int) -> Array:
        """Nodal values at one corner of every cell."""
        along_xi, along_eta = CORNERS[corner]
        n_xi, n_eta = values.shape
        return values[along_xi : n_xi - 1 + along_xi, along_eta : n_eta - 1 + along_eta]

    def unknown(self, corner: int, axis: int) -> IntArray:
        """Number of the unknown x (axis 0) or y (axis 1) at one corner of every cell."""
        along_xi, along_eta = CORNERS[corner]
        n_xi, n_eta = self.window.x.shape
        return self.window.numbers[axis][along_xi : n_xi - 1 + along_xi, along_eta : n_eta - 1 + along_eta]

    @cached_property
    def seen(self) -> SeenGradient:
        """Cell-centred derivatives: the mean of the two edge differences of the cell."""
        w = self.window
        derivatives = []
        for q in (w.x, w.y, w.u):
            c = [self.corner(q, corner) for corner in range(4)]
            derivatives.append((c[2] + c[1] - c[0] - c[3]) / (2 * w.d_xi))
            derivatives.append((c[2] + c[3] - c[0] - c[1]) / (2 * w.d_eta))
        x_xi, x_eta, y_xi, y_eta, u_xi, u_eta = derivatives
        return SeenGradient(x_xi, y_xi, x_eta, y_eta, u_xi, u_eta)

    @cached_property
    def gradient(self) -> Vector:
        """The gradient of u in each cell."""
        return self.seen.gradient

    @cached_property
    def centre(self) -> Vector:
        """The mean of the four corners of each cell."""
        x, y = (sum(self.corner(q, c) for c in range(4)) / 4 for q in (self.window.x, self.window.y))
        return np.asarray(x), np.asarray(y)

    @cached_property
    def fluxes(self) -> tuple[HalfFlux, ...]:
        """The cell's half of the squared metric length along each of :data:`EDGES`."""
        w = self.window
        spacing, local = (w.d_xi, w.d_eta), LocalMetric(w.metric, self.centre, self.gradient)
        return tuple(
            HalfFlux(
                (
                    (self.corner(w.x, second) - self.corner(w.x, first)) / spacing[component],
                    (self.corner(w.y, second) - self.corner(w.y, first)) / spacing[component],
                ),
                local,
            )
            for first, second, component in EDGES
        )

    @cached_property
    def flux_derivatives(self) -> list[list[Vector]]:
        """For each edge and corner, the derivative of the flux by the corner's position."""
        w, g = self.window, self.gradient
        spread, excess = [], []
        for corner, (along_xi, along_eta) in enumerate(CORNERS):
            spread.append(self.seen.of((along_xi - 0.5) / w.d_xi, (along_eta - 0.5) / w.d_eta))
            excess.append((self.corner(w.u_x, corner) - g[0], self.corner(w.u_y, corner) - g[1]))
        result = []
        for (first, second, component), flux in zip(EDGES, self.fluxes, strict=True):
            spacing = (w.d_xi, w.d_eta)[component]
            weight = {first: -1.0 / spacing, second: 1.0 / spacing}
            result.append([flux.by_node(weight.get(c, 0.0), 0.25, spread[c], excess[c]) for c in range(4)])
        return result
