"""The solution that is recovered from values at the nodes of a mesh in blocks, and the estimate of their error."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from equimesh.blocks.blocks import Blocks
from equimesh.errors import InputError
from equimesh.fields.field import Field
from equimesh.fields.quad_field import QuadField
from equimesh.least_error.charts import FREE, CurveChart
from equimesh.least_error.elements import Norm, Rule
from equimesh.least_error.objective import ROUNDING_SHARE, Objective, Weights
from equimesh.least_error.quad_cells import cells_of_mesh
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.numerics.types import Array
from equimesh.quality.cells import QuadCells
from equimesh.rounds.recovery import ESTIMATE_POINTS, gradient_norm


@dataclass(frozen=True, kw_only=True, eq=False)
class BlockRecovery:
    """u as a function of x and y, from values at the nodes of a ``mesh`` of ``domain``."""

    u: QuadField
    domain: Blocks
    mesh: QuadMesh
    values: Array
    """The values at the nodes, shape ``(n,)``."""
    rounding: float
    """The estimated L2 error that is nothing but rounding of the values."""

    @classmethod
    def of(cls, mesh: QuadMesh, values: npt.ArrayLike, domain: Blocks) -> BlockRecovery:
        """From ``values`` of shape ``(n,)``; raises as :class:`~equimesh.fields.quad_field.QuadField`.

        Raises :class:`~equimesh.errors.InputError` for a mesh with other cells than that of the domain, too.
        """
        if not np.array_equal(mesh.cells, domain.mesh.cells):
            raise InputError(
                "the mesh has other cells than the domain: give values on a mesh of this domain, such as"
                " domain.mesh or the mesh of a solution",
                field="mesh",
            )
        u = QuadField(mesh=mesh, values=values)
        rounding = ROUNDING_SHARE * float(np.abs(u.values).max()) * math.sqrt(domain.area)
        return cls(u=u, domain=domain, mesh=mesh, values=u.values, rounding=rounding)

    def estimate(self, norm: Norm, threads: int = 1) -> float:
        """As :meth:`equimesh.rounds.recovery.Recovery.estimate`."""
        return measured_on_blocks(self.u, self.mesh, Rule(norm=norm, points=ESTIMATE_POINTS), threads)

    def gradient_norm(self) -> float:
        """The norm of the gradient of the bilinear interpolant of the values on their mesh, in the units of u."""
        return gradient_norm(QuadCells(self.mesh), self.values)


def measured_on_blocks(u: Field, mesh: QuadMesh, rule: Rule, threads: int = 1) -> float:
    """The norm of the error of the bilinear interpolant of u on ``mesh``."""
    count = len(mesh.points)
    area = float(mesh.cell_areas().sum())
    chart = CurveChart([], np.full(count, FREE), np.zeros(count), area)
    points = np.ascontiguousarray(mesh.points.T)
    cells = cells_of_mesh(mesh.cells, chart.free, mesh.ties)
    return Objective(u, chart, cells, points, Weights(distortion=0.0, smoothness=0.0), rule, threads).error(points)


def moved_lengths(before: QuadMesh, after: QuadMesh) -> float:
    """The root mean square of the moves of the nodes, in sides of a square with the area of the mean cell."""
    size = float(np.mean(before.cell_areas()))
    moves = np.sum((after.points - before.points) ** 2, axis=1)
    return math.sqrt(float(np.mean(moves)) / size)
