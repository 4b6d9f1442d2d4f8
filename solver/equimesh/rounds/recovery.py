"""The solution that is recovered from values at the nodes of a mesh, the estimate of their error, and the next mesh."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from equimesh.blocks.blocks import Blocks
from equimesh.domains.domain import Domain, map_mesh
from equimesh.errors import InputError, SamplesError
from equimesh.fields.expression import Field
from equimesh.fields.on_domain import recover, reference_on
from equimesh.least_error.cells import Cells, cells_of_grid, cells_of_mesh
from equimesh.least_error.charts import FREE, Chart, CurveChart, DomainChart
from equimesh.least_error.dual import DualField, objective_of
from equimesh.least_error.iteration import MORE_SLOPE_POINTS
from equimesh.least_error.kernels import Norm, Rule
from equimesh.least_error.objective import ROUNDING_SHARE, Objective, Weights
from equimesh.least_error.projection import MAX_CELLS, ProjectedObjective, is_projected
from equimesh.least_error.starts import coordinates_of
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.second_order import (
    LATTICE,
    ValueDegree,
    lattice_of,
    nodes_of_cells,
    nodes_of_elements,
    six_nodes,
)
from equimesh.numerics.types import Array
from equimesh.quality.cells import CellPoints, MeshCells, cells_of
from equimesh.quality.elements import CellKind, basis, nodes_of, quadrilateral, triangle
from equimesh.quality.ritz import projection
from equimesh_coupling.adaptation import MAX_UNRESOLVED_SHARE
from equimesh_coupling.display import draw_on, picture
from equimesh_coupling.elements import lobatto
from equimesh_coupling.goals import CONSTANT, NO_DUAL_DEGREE
from equimesh_coupling.parts import cuts_at_corners
from equimesh_schema import ErrorProducts
from equimesh_schema.notebook import html_of

TWO_KINDS = (
    "the mesh is one of a grid and the domain one of blocks, or the other way round: a mesh in blocks needs its domain"
    " in blocks"
)
"""The reason why a mesh and a domain of two kinds are refused."""
MORE_ESTIMATE_POINTS = 2
"""How many Gauss points a direction and cell estimates take more than the degree of the elements."""
LEFT_SHARES: Mapping[Norm, float] = {"l2": 0.05, "h1": 0.15}
"""The shares of the norms of what polynomials leave at the nodes that count as error.

On six functions, 17 x 17 points, degree 3, estimates were 0.65 to 4 times the error on the uniform mesh: without this
part 0.16 to 1, so that uniform meshes were taken for the best.
"""


MAX_POLYNOMIAL_SHARES: Mapping[Norm, float] = {"l2": 0.02, "h1": 0.07}
"""The largest unresolved shares at which u of degree 3 and 4 is that of polynomials in the next mesh; on blocks of L2.

Above, they leave as much at the nodes as the error is, and nodes stay where they are. On a peak of 17 x 17 points the
error of degree 3 stayed as it was, and with limited cubics fell by a factor of 40; at a share of 0.002 by 3.9 and 1.8.
"""


class NodalValues(NamedTuple):
    """The values of a solver at the nodes of a mesh, of degree 1."""

    mesh: Mesh
    values: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Recovery:
    """u as a function of x and y, recovered from the nodal values of a solver."""

    u: Field
    domain: Domain | Blocks
    mesh: Mesh
    """The mesh of the values, on the reference square; of blocks the mesh itself."""
    values: Array
    """The values at the nodes of elements: see :func:`~equimesh.meshes.second_order.nodes_of_elements`."""
    degree: ValueDegree = 1
    """The degree of these elements."""
    cells: CellKind = "quad"
    """Their cells: the quadrilaterals, or the triangles that these are cut into."""
    left: Array | None = None
    """What a recovery of degree 3 or 4 leaves at the nodes of each cell, shape ``(m, p + 1, p + 1)``."""
    rounding: float
    """The estimated L2 error that is nothing but rounding of the values."""

    @classmethod
    def of(
        cls,
        mesh: Mesh,
        values: npt.ArrayLike,
        domain: Domain | Blocks,
        degree: ValueDegree = 1,
        cells: CellKind = "quad",
    ) -> Recovery:
        """From ``values`` at the nodes of elements of a ``degree`` on ``mesh``, a mesh of ``domain``.

        A mesh of blocks may have other numbers of cells than the domain, which is then taken with those.

        Raises as :func:`~equimesh.fields.on_domain.recover`, on blocks as
        :class:`~equimesh.fields.quad_field.QuadField`; :class:`~equimesh.errors.InputError` for a mesh with other cells
        than the domain, too, and for a mesh and a domain of two kinds.
        """
        if degree > 1:
            _check_count(values, mesh, degree, cells)
        if mesh.is_grid == isinstance(domain, Blocks):
            raise InputError(TWO_KINDS, field="mesh")
        if isinstance(domain, Blocks):
            domain = domain.with_counts_of(mesh)
        found = recover(mesh, values, domain, degree, cells)
        known = found.values
        rounding = ROUNDING_SHARE * float(np.abs(known).max()) * math.sqrt(domain.area)
        of: Any = {"domain": domain, "degree": degree, "cells": cells, "rounding": rounding}
        return cls(u=found.u, mesh=found.reference, values=known, left=found.left, **of)

    def limited(self) -> Recovery:
        """The same with u as limited cubics between all nodes of the elements; itself where such cells are folded."""
        domain: Any = self.domain
        nodes = lattice_of(on_domain(self.mesh, domain), self.degree)
        if nodes.is_folded or (nodes.is_grid and reference_on(nodes, domain).is_folded):
            return self
        return replace(self, u=recover(nodes, self.values, domain).u)

    def estimate(self, norm: Norm, threads: int = 1, *, of_solver: bool = True) -> float:
        """The norm of u minus its interpolant on the mesh of the values: an estimate of the solver's error.

        It is zero where the values are those of a polynomial of the degree of the elements. Layers that the mesh does
        not resolve at all are not seen. In L2 the projection stands in place of the interpolant, where :func:`measured`
        knows it, unless ``of_solver`` is false: values at the nodes of long cells can be wrong by more than the
        interpolant is. A share of what polynomials leave at the nodes counts as error.
        """
        plain = measured(self.u, self.domain, self.mesh, self._rule(norm), threads)
        if self.left is not None:
            left = nodal_norms(cells_of(on_domain(self.mesh, self.domain)), self.left)
            return math.hypot(plain, LEFT_SHARES[norm] * left[norm])
        return self.of_solver(plain, threads) if norm == "l2" and of_solver else plain

    def of_solver(self, plain: float, threads: int = 1) -> float:
        """The estimate of the error in L2 of which the part of the interpolant, ``plain``, is known."""
        if self.left is not None or not plain > self.rounding:
            return plain
        return measured(self.u, self.domain, self.mesh, self._rule("l2"), threads, of_solver=True, plain=plain)

    def _rule(self, norm: Norm) -> Rule:
        return Rule(norm=norm, cells=self.cells, points=self.degree + MORE_ESTIMATE_POINTS, degree=self.degree)

    def fitted(self) -> Recovery:
        """The recovery of degree 1 on a grid whose gradients are those of cubics; any other one is as it is."""
        if self.degree > 1 or not self.mesh.is_grid or isinstance(self.domain, Blocks):
            return self
        mesh = on_domain(self.mesh, self.domain)
        return replace(self, u=recover(mesh, self.values, self.domain, fitted=True).u)

    def gradient_norm(self) -> float:
        """The norm of the gradient of the interpolant of the values on their mesh, in the units of u."""
        mesh = on_domain(self.mesh, self.domain)
        if self.cells == "triangle":
            return gradient_norm_on_triangles(mesh, self.values.ravel(), self.degree)
        if self.degree == 1:
            return gradient_norm(cells_of(mesh), self.values)
        return nodal_norms(cells_of(mesh), self.values.ravel()[nodes_of_cells(mesh, self.degree)])["h1"]


def _check_count(values: npt.ArrayLike, mesh: Mesh, degree: ValueDegree, cells: CellKind) -> None:
    """Refuse values of another shape than the nodes of elements of a ``degree``; the message says which is needed."""
    needed, found = nodes_of_elements(mesh, degree), np.shape(values)
    inside = {"quad": "cells", "triangle": "the diagonals along which cells are cut"}[cells]
    if found != needed:
        raise SamplesError(
            f"values has shape {found}, and elements of degree {degree} have nodes of shape {needed} on this mesh: give"
            f" values at the middles of edges and {inside}, too, or the degree of your elements",
            field="values",
        )


def on_domain(reference: Mesh, domain: Domain | Blocks) -> Any:
    """The mesh of the domain whose ``reference`` is known: a mesh of its class, of blocks the mesh itself."""
    return reference if not reference.is_grid or isinstance(domain, Blocks) else map_mesh(reference, domain)


def gradient_norm(cells: MeshCells, values: Array) -> float:
    """The norm of the gradient of the bilinear interpolant of nodal values on their ``cells``, in the units of u."""
    points, every = CellPoints.gauss(2), np.arange(cells.count)
    at, corners = cells.at(points, every), cells.corner_values(values, every)
    s, t = points.s[:, None], points.t[:, None]
    u_s = (1.0 - t) * (corners[1] - corners[0]) + t * (corners[2] - corners[3])
    u_t = (1.0 - s) * (corners[3] - corners[0]) + s * (corners[2] - corners[1])
    u_x, u_y = u_s * at.y_t - u_t * at.y_s, u_t * at.x_s - u_s * at.x_t
    return math.sqrt(float((points.weights[:, None] * (u_x**2 + u_y**2) / at.det).sum()))


def gradient_norm_on_triangles(mesh: Mesh, values: Array, degree: ValueDegree) -> float:
    """The norm of the gradient of the interpolant of flat ``values`` at the nodes of elements of degree 1 or 2."""
    triangles, element = mesh.triangles(), triangle(finer=True)
    nodal = values[triangles]
    if degree == 2:
        lattice = nodes_of_cells(mesh).reshape(-1, 9)
        nodal = values[six_nodes(lattice[:, np.argsort(LATTICE.ravel())], triangles)]
    of = basis("triangle", degree, element)
    (x_s, y_s), (x_t, y_t) = ((mesh.points[triangles[:, k]] - mesh.points[triangles[:, 0]]).T for k in (1, 2))
    det = x_s * y_t - x_t * y_s
    u_s, u_t = of.along_s.T @ nodal.T, of.along_t.T @ nodal.T
    u_x, u_y = u_s * y_t - u_t * y_s, u_t * x_s - u_s * x_t
    return math.sqrt(float((element.weights[:, None] * (u_x**2 + u_y**2) / det).sum()))


def nodal_norms(cells: MeshCells, values: Array) -> Mapping[Norm, float]:
    """The norms of interpolants of ``values`` at nodes of cells, shape ``(m, p + 1, p + 1)``, and of the gradient."""
    degree = values.shape[1] - 1
    points, of = CellPoints.gauss(degree + 1), basis("quad", degree, quadrilateral(degree + 1))
    at, places = cells.at(points, np.arange(cells.count)), lobatto(degree)
    k, m = (np.abs(q[:, None] - places).argmin(axis=1) for q in nodes_of("quad", degree))
    nodal, weights = values[:, k, m].T, points.weights[:, None]
    u, u_s, u_t = (functions.T @ nodal for functions in (of.value, of.along_s, of.along_t))
    u_x, u_y = u_s * at.y_t - u_t * at.y_s, u_t * at.x_s - u_s * at.x_t
    squares = weights * at.det * u**2, weights * (u_x**2 + u_y**2) / at.det
    return {"l2": math.sqrt(float(squares[0].sum())), "h1": math.sqrt(float(squares[1].sum()))}


def measured(
    u: Field,
    domain: Domain | Blocks,
    mesh: Mesh,
    rule: Rule,
    threads: int = 1,
    *,
    of_solver: bool = False,
    plain: float | None = None,
) -> float:
    """The norm of the error of the interpolant of u on a ``mesh`` of the reference square, or of blocks.

    The elements of the interpolant are those of the ``rule``. ``of_solver`` takes the projection of u by the equation
    of Poisson in its place, in L2 for degree 1, on a mesh on which it is known in a moderate time: see
    :mod:`equimesh.least_error.projection`. ``plain`` is the norm of the interpolant, where it is known.
    """
    weights = Weights(distortion=0.0, smoothness=0.0)
    chart: Chart
    if mesh.is_grid:
        sides: Any = domain
        chart, cells = DomainChart(sides), cells_of_grid(mesh.grid.shape)
        start, points = (np.ascontiguousarray(coordinates_of(one)) for one in (Mesh.uniform(mesh.grid), mesh))
    else:
        start = points = np.ascontiguousarray(mesh.points.T)
        count, area = points.shape[1], float(mesh.cell_areas().sum())
        curves = CurveChart([], np.full(count, FREE), np.zeros(count), area)
        cuts = cuts_at_corners(mesh.cells) if rule.cells == "triangle" else {}
        chart, cells = curves, replace(cells_of_mesh(mesh.cells, curves.free, mesh.ties), corner_cuts=cuts)
    if of_solver and is_of_solver(rule, cells):
        finer = replace(rule, points=rule.points + MORE_SLOPE_POINTS)
        projected = _error(ProjectedObjective(u, chart, cells, start, weights, finer, threads), points)
        if math.isfinite(projected):
            return projected
    if plain is not None:
        return plain
    return _error(objective_of(u)(u, chart, cells, start, weights, rule, threads), points)


def _error(objective: Objective, points: Array) -> float:
    """The error on a mesh, whose triangles are those that it is best cut into."""
    objective.cut(points)
    return objective.error(points)


def is_of_solver(rule: Rule, cells: Cells) -> bool:
    """Whether the error of a solver can stand in place of that of the interpolant."""
    return rule.norm == "l2" and rule.degree == 1 and is_projected(cells)


def moved_cells(before: Mesh, after: Mesh) -> float:
    """The root mean square of the moves of the nodes, in spacings of the uniform mesh of the square.

    On blocks in sides of a square with the area of the mean cell.
    """
    if not before.is_grid:
        size = float(np.mean(before.cell_areas()))
        moves = np.sum((after.points - before.points) ** 2, axis=1)
        return math.sqrt(float(np.mean(moves)) / size)
    spacing: Array = np.array([n - 1 for n in before.grid.shape], dtype=float)
    moves = np.stack([after.x - before.x, after.y - before.y], axis=-1) * spacing
    return float(np.sqrt(np.mean(np.sum(moves**2, axis=-1))))


def are_of_poisson(earlier: NodalValues, u: Field, unknown: float, cells: CellKind) -> bool:
    """Whether values of a solver are nearer to those for Poisson's equation, with u as solution, than to u itself.

    Both are compared at the nodes of their mesh, in L2. True where they differ by less than is ``unknown`` of u, and on
    large meshes, on which the solution is not computed.
    """
    mesh, values = earlier
    found = projection(mesh, u, triangles=cells == "triangle") if len(mesh.cells) <= MAX_CELLS else None
    if found is None:
        return True
    (nodal, added), shares = found, np.repeat(mesh.cell_areas().ravel(), mesh.cells.shape[1]) / mesh.cells.shape[1]
    weights = np.bincount(mesh.cells.ravel(), shares, len(mesh.points)) * added
    is_known = float((weights * added).sum()) > unknown**2
    return not is_known or float((weights * (2.0 * (np.ravel(values) - nodal) - added)).sum()) > 0.0


# What tells the error of a functional.

PRODUCT_POINTS = 4
"""Gauss points a direction and cell for products of two errors."""


def error_products(one: Recovery, other: Recovery) -> ErrorProducts:
    """The integrals of products of the errors of ``one`` solution and of its adjoint, without their bound."""
    mesh = on_domain(one.mesh, one.domain)
    cells, points = cells_of(mesh), CellPoints.gauss(PRODUCT_POINTS)
    every = np.arange(cells.count)
    at, (s, t) = cells.at(points, every), (points.s[:, None], points.t[:, None])
    errors = []
    for known in (one, other):
        c = cells.corner_values(known.values, every)
        lower, upper = c[0] + s * (c[1] - c[0]), c[3] + s * (c[2] - c[3])
        along, across = (1.0 - t) * (c[1] - c[0]) + t * (c[2] - c[3]), upper - lower
        u, u_x, u_y = known.u.evaluate(at.x, at.y, order=1)
        slopes = (along * at.y_t - across * at.y_s) / at.det, (across * at.x_s - along * at.x_t) / at.det
        errors.append((u - lower - t * across, u_x - slopes[0], u_y - slopes[1]))
    (e, e_x, e_y), (z, z_x, z_y) = errors
    area = points.weights[:, None] * at.det
    products = (e_x * z_x + e_y * z_y, e_x * z, e_y * z, e * z)
    diffusion, stream_x, stream_y, reaction = (float((area * part).sum()) for part in products)
    return ErrorProducts(bound=0.0, diffusion=diffusion, stream_x=stream_x, stream_y=stream_y, reaction=reaction)


# The error of the values, and the mesh for the next solve.


KEPT = "kept"
"""The name of the mesh before, where no candidate is valid or the values are linear in x and y."""
MIN_SOLVER_SHARE = 1.1
"""The least error of a solver over that of the interpolant from which on it leads, whatever is resolved."""
MAX_UNRESOLVED_FITTED = 0.035
"""The largest share of the gradient left unresolved at which descents on fitted gradients end at a smaller error."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ErrorEstimate:
    """The error of a solver's values on their mesh, estimated from a u that is recovered from the values."""

    recovery: Recovery
    """u, recovered from the values."""
    estimate: float
    """The estimated L2 error of the values on their own mesh, in the units of u times a length."""
    estimate_h1: float
    """The estimated error of the gradient, in the units of u. A mesh that resolves nothing has a small one."""
    unresolved: float
    """``estimate_h1`` over the norm of the gradient, 0 to about 0.5: the share that the mesh does not resolve."""
    is_exact: bool
    """Whether the estimate is nothing but rounding."""
    solver_share: float = 1.0
    """``estimate`` over the L2 error of the interpolant. Above 1 the mesh serves interpolation more than a solver."""
    is_of_poisson: bool = True
    """Whether earlier values of the solver, if any are given, are like those for Poisson's equation."""
    products: ErrorProducts | None = None
    """What tells the error of a functional, where its adjoint is given."""

    @classmethod
    def of(
        cls,
        mesh: Mesh,
        values: npt.ArrayLike,
        domain: Domain | Blocks,
        threads: int = 1,
        degree: ValueDegree = 1,
        adjoint: npt.ArrayLike | None = None,
        earlier: NodalValues | None = None,
        cells: CellKind = "quad",
    ) -> ErrorEstimate:
        """From ``values`` at the nodes of elements of a ``degree`` on ``mesh``, a mesh of ``domain``.

        With the values of an ``adjoint`` at the same nodes cells are quadrilaterals, the error of the gradient is the
        root of the sum over the cells of the products of both errors, and its norm the root of the product of both.
        Where ``earlier`` values are not :func:`are_of_poisson`, the estimate is the error of the interpolant alone.

        Raises :class:`~equimesh.errors.SamplesError` for values of another shape or not finite, and
        :class:`~equimesh.errors.InputError` for a folded mesh, one of another domain, and an adjoint that is zero or of
        degree 2.
        """
        recovery = Recovery.of(mesh, values, domain, degree, cells if adjoint is None else "quad")
        plain, size, products = recovery.estimate("l2", threads, of_solver=False), recovery.gradient_norm(), None
        is_of_poisson = earlier is None or are_of_poisson(earlier, recovery.u, plain, cells)
        estimate = recovery.of_solver(plain, threads) if is_of_poisson else plain
        is_exact = not estimate > recovery.rounding
        if adjoint is not None:
            if degree != 1:
                raise InputError(NO_DUAL_DEGREE, field="degree")
            dual = Recovery.of(mesh, adjoint, domain)
            if not dual.values.any():
                raise InputError(CONSTANT, field="adjoint")
            is_exact = is_exact or not dual.estimate("l2", threads) > dual.rounding
            size = math.sqrt(size * dual.gradient_norm())
            products = error_products(recovery, dual)
            recovery = replace(recovery, u=DualField(u=recovery.u, adjoint=dual.u))
        slopes = recovery.estimate("h1", threads)
        return cls(
            recovery=recovery,
            estimate=estimate,
            estimate_h1=slopes,
            unresolved=slopes / size if size > 0.0 else 0.0,
            is_exact=is_exact,
            solver_share=estimate / plain if plain > 0.0 else 1.0,
            is_of_poisson=is_of_poisson,
            products=products and replace(products, bound=slopes**2),
        )

    def wanted(self, norm: Norm) -> Recovery:
        """u by which the next mesh is made: limited cubics where polynomials do not see its error.

        Of degree 1 gradients are fitted where u is resolved well.
        """
        if self.recovery.degree == 1:
            is_sharp = self.unresolved <= MAX_UNRESOLVED_FITTED and self.products is None
            return self.recovery.fitted() if is_sharp else self.recovery
        share = MAX_POLYNOMIAL_SHARES[norm if self.recovery.mesh.is_grid else "l2"]
        has_polynomials = self.recovery.left is not None and self.recovery.degree > 2
        return self.recovery.limited() if has_polynomials and self.unresolved > share else self.recovery

    @property
    def is_resolved(self) -> bool:
        """Whether the mesh resolves the solution, as far as the values tell."""
        return self.unresolved <= MAX_UNRESOLVED_SHARE

    @property
    def is_for_solver(self) -> bool:
        """Whether the error of a solver leads to the next mesh. Before that the interpolant finds layers faster."""
        is_near = self.is_resolved or self.solver_share > MIN_SOLVER_SHARE
        return self.is_of_poisson and self.products is None and is_near


@dataclass(frozen=True, kw_only=True, eq=False)
class NextMesh:
    """The mesh for the next solve."""

    reference: Mesh
    """The mesh for the next solve on the reference square; of blocks the mesh itself."""
    chosen: str
    """The name of the candidate that was chosen."""
    norm: Norm
    """The norm in which it was chosen: the requested one, or L2 on blocks that do not resolve the solution."""
    candidates: Mapping[str, float]
    """The candidates, with the errors of the recovered u on them in that norm: of its interpolant, or of a solver.

    In L2 the error is that of a solver where :attr:`ErrorEstimate.is_for_solver` says so.
    """
    gain: float
    """The same error on the mesh before over that on this one.

    Both are measured at the same points of each cell, which are fewer than those of the estimate. Where the values do
    not resolve the solution it can be below 1.
    """
    moved_cells: float
    """The root mean square of the moves of the nodes, in spacings of the uniform mesh, on blocks in lengths of the mean
    cell.
    """


@dataclass(frozen=True, kw_only=True, eq=False)
class Round:
    """The next mesh, and the estimated error of the values on their own mesh."""

    mesh: Mesh
    """The next mesh of the domain, with as many nodes."""
    reference: Mesh
    """The same mesh on the reference square; of blocks the mesh itself."""
    estimate: float
    """The estimated L2 error of the values on their own mesh, 0 where that is nothing but rounding."""
    estimate_h1: float
    """The estimated error of the gradient, in the units of u. A mesh that resolves nothing has a small one."""
    unresolved: float
    """``estimate_h1`` over the norm of the gradient, 0 to about 0.5: the share that the mesh does not resolve."""
    chosen: str
    """As :attr:`NextMesh.chosen`."""
    norm: Norm
    """As :attr:`NextMesh.norm`."""
    candidates: Mapping[str, float]
    """As :attr:`NextMesh.candidates`."""
    gain: float
    """As :attr:`NextMesh.gain`."""
    moved_cells: float
    """As :attr:`NextMesh.moved_cells`."""
    products: ErrorProducts | None = None
    """What tells the error of a functional, where its adjoint is given."""

    def plot(self, axes: Any = None) -> Any:
        """Draw the next mesh on ``axes`` of matplotlib, or on those of pyplot, and return the axes."""
        return draw_on(self.mesh, None, axes)

    def _repr_html_(self) -> str:
        """A picture and a table, for notebooks."""
        facts = [
            ("estimated error", f"{self.estimate:.3g} in L2, {self.estimate_h1:.3g} in H1, of the values given"),
            ("unresolved", f"{self.unresolved:.0%} of the gradient"),
            ("chosen", self.chosen),
            ("moved", f"{self.moved_cells:.2g} cells"),
        ]
        return html_of("The next mesh", facts, picture=picture(self.mesh), alternative="the next mesh")
