"""The solution that is recovered from nodal values, and the estimate of the error on its own mesh."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from equimesh.domains.domain import Domain, map_mesh
from equimesh.fields.field import Field
from equimesh.fields.recovered import recover
from equimesh.least_error.cells import cells_of_grid
from equimesh.least_error.charts import DomainChart
from equimesh.least_error.elements import Norm, Rule
from equimesh.least_error.objective import ROUNDING_SHARE, Objective, Weights
from equimesh.least_error.ways import coordinates_of
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.types import Array
from equimesh.quality.cells import BilinearCells, CellPoints, MeshCells

ESTIMATE_POINTS = 3
"""Gauss points a direction and cell for estimates."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Recovery:
    """u as a function of x and y, from nodal values of a solver that does not know more."""

    u: Field
    domain: Domain
    mesh: Mesh
    """The mesh of the values, on the reference square."""
    values: Array
    """The values at the nodes, shape ``(n_xi, n_eta)``."""
    rounding: float
    """The estimated L2 error that is nothing but rounding of the values."""

    @classmethod
    def of(cls, mesh: Mesh, values: npt.ArrayLike, domain: Domain) -> Recovery:
        """From ``values`` of shape ``(n_xi, n_eta)`` at the nodes of ``mesh``, a mesh of ``domain``.

        Raises as :func:`~equimesh.fields.recovered.recover`.
        """
        found = recover(mesh, values, domain)
        return cls(
            u=found.u,
            domain=domain,
            mesh=found.reference,
            values=found.values,
            rounding=ROUNDING_SHARE * float(np.abs(found.values).max()) * math.sqrt(domain.area),
        )

    def estimate(self, norm: Norm, threads: int = 1) -> float:
        """The norm of u minus its bilinear interpolant on the mesh of the values: an estimate of the solver's error.

        It is zero where the values are those of a linear function. Layers that the mesh does not resolve at all are
        not seen.
        """
        return measured(self.u, self.domain, self.mesh, Rule(norm=norm, points=ESTIMATE_POINTS), threads)

    def gradient_norm(self) -> float:
        """The norm of the gradient of the bilinear interpolant of the values on their mesh, in the units of u."""
        return gradient_norm(BilinearCells(map_mesh(self.mesh, self.domain)), self.values)


def gradient_norm(cells: MeshCells, values: Array) -> float:
    """The norm of the gradient of the bilinear interpolant of nodal values on their ``cells``, in the units of u."""
    points, every = CellPoints.gauss(2), np.arange(cells.count)
    at, corners = cells.at(points, every), cells.corner_values(values, every)
    s, t = points.s[:, None], points.t[:, None]
    u_s = (1.0 - t) * (corners[1] - corners[0]) + t * (corners[2] - corners[3])
    u_t = (1.0 - s) * (corners[3] - corners[0]) + s * (corners[2] - corners[1])
    u_x, u_y = u_s * at.y_t - u_t * at.y_s, u_t * at.x_s - u_s * at.x_t
    return math.sqrt(float((points.weights[:, None] * (u_x**2 + u_y**2) / at.det).sum()))


def measured(u: Field, domain: Domain, mesh: Mesh, rule: Rule, threads: int = 1) -> float:
    """The norm of the error of the bilinear interpolant of u on a ``mesh`` of the reference square."""
    uniform = coordinates_of(Mesh.uniform(mesh.grid))
    weights = Weights(distortion=0.0, smoothness=0.0)
    objective = Objective(u, DomainChart(domain), cells_of_grid(mesh.grid.shape), uniform, weights, rule, threads)
    return objective.error(np.ascontiguousarray(coordinates_of(mesh)))


def moved_cells(before: Mesh, after: Mesh) -> float:
    """The root mean square of the moves of the nodes, in spacings of the uniform mesh of the square."""
    spacing: Array = np.array([n - 1 for n in before.grid.shape], dtype=float)
    moves = np.stack([after.x - before.x, after.y - before.y], axis=-1) * spacing
    return float(np.sqrt(np.mean(np.sum(moves**2, axis=-1))))
