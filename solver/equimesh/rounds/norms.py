"""The norms of errors on a mesh, and of gradients."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from equimesh.blocks.blocks import Blocks
from equimesh.domains.domain import Domain
from equimesh.fields.expression import Field
from equimesh.least_error.cells import Cells, cells_of_grid, cells_of_mesh
from equimesh.least_error.charts import FREE, Chart, CurveChart, DomainChart
from equimesh.least_error.iteration import MORE_SLOPE_POINTS
from equimesh.least_error.kernels import Norm, Rule
from equimesh.least_error.objective import Objective, Weights
from equimesh.least_error.other_errors import ProjectedObjective, objective_of
from equimesh.least_error.projection import is_projected
from equimesh.least_error.starts import coordinates_of
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.second_order import (
    LATTICE,
    ValueDegree,
    nodes_of_cells,
    six_nodes,
)
from equimesh.numerics.types import Array
from equimesh.quality.cells import CellPoints, MeshCells
from equimesh.quality.elements import basis, nodes_of, quadrilateral, triangle
from equimesh_coupling.elements import lobatto
from equimesh_coupling.parts import cuts_at_corners


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
