"""The solution that is recovered from values at the nodes of a mesh, the estimate of their error, and the next mesh."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Generic, Self, TypeVar

import numpy as np
import numpy.typing as npt

from equimesh.blocks.blocks import Blocks
from equimesh.domains.domain import Domain, map_mesh
from equimesh.errors import InputError
from equimesh.fields.expression import Field
from equimesh.fields.on_domain import recover
from equimesh.fields.quad_field import QuadField
from equimesh.least_error.cells import cells_of_grid, cells_of_mesh
from equimesh.least_error.charts import FREE, CurveChart, DomainChart
from equimesh.least_error.kernels import Norm, Rule
from equimesh.least_error.objective import ROUNDING_SHARE, Objective, Weights
from equimesh.least_error.starts import coordinates_of
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.numerics.types import Array
from equimesh.quality.cells import BilinearCells, CellPoints, MeshCells, QuadCells

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

        Raises as :func:`~equimesh.fields.on_domain.recover`.
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


# The solution that is recovered from values at the nodes of a mesh in blocks, and the estimate of their error.


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


# The mesh for the next solve, with what is known of it.

AnyMesh = TypeVar("AnyMesh", Mesh, QuadMesh)
"""The class of the meshes: those of grids, or of blocks."""
R = TypeVar("R", Recovery, BlockRecovery)
KEPT = "kept"
"""The name of the mesh before, where no candidate is valid or the values are those of a linear function."""


@dataclass(frozen=True, kw_only=True, eq=False)
class AnyKnowledge(Generic[R]):
    """What the values of a solver say of the mesh that they are on."""

    recovery: R
    """u, recovered from the values."""
    estimate: float
    """The estimated L2 error of the values on their own mesh, in the units of u times a length."""
    estimate_h1: float
    """The estimated error of the gradient, in the units of u. It must not rank meshes: an unresolved one looks good."""
    unresolved: float
    """``estimate_h1`` over the norm of the gradient, 0 to about 0.5: the share that the mesh does not resolve."""

    @classmethod
    def from_recovery(cls, recovery: R, threads: int) -> Self:
        """With the estimates of a recovered u."""
        slopes, size = recovery.estimate("h1", threads), recovery.gradient_norm()
        return cls(
            recovery=recovery,
            estimate=recovery.estimate("l2", threads),
            estimate_h1=slopes,
            unresolved=slopes / size if size > 0.0 else 0.0,
        )

    @property
    def is_exact(self) -> bool:
        """Whether the estimate is nothing but rounding."""
        return not self.estimate > self.recovery.rounding


@dataclass(frozen=True, kw_only=True, eq=False)
class NextMesh(Generic[AnyMesh]):
    """The mesh for the next solve."""

    reference: AnyMesh
    """The mesh for the next solve on the reference square; of blocks the mesh itself."""
    chosen: str
    """The name of the candidate that it was."""
    candidates: Mapping[str, float]
    """The candidates, with the errors of the interpolant of the recovered u on them in the requested norm."""
    gain: float
    """The error of the interpolant of the recovered u in the requested norm, on the mesh before over that on this one.

    Both are measured at the same points of each cell, which are fewer than those of the estimate. Where the values do
    not resolve the solution it can be below 1.
    """
    moved_cells: float
    """The root mean square of the moves of the nodes, in spacings of the uniform mesh, on blocks in lengths of the mean
    cell.
    """


@dataclass(frozen=True, kw_only=True, eq=False)
class Round(Generic[AnyMesh]):
    """The next mesh, and what the values say of the mesh that they are on."""

    mesh: AnyMesh
    """The next mesh of the domain, with as many nodes."""
    reference: AnyMesh
    """The same mesh on the reference square; of blocks the mesh itself."""
    estimate: float
    """The estimated L2 error of the values on their own mesh, 0 where that is nothing but rounding."""
    estimate_h1: float
    """The estimated error of the gradient, in the units of u. It must not rank meshes: an unresolved one looks good."""
    unresolved: float
    """``estimate_h1`` over the norm of the gradient, 0 to about 0.5: the share that the mesh does not resolve."""
    chosen: str
    """As :attr:`NextMesh.chosen`."""
    candidates: Mapping[str, float]
    """As :attr:`NextMesh.candidates`."""
    gain: float
    """As :attr:`NextMesh.gain`."""
    moved_cells: float
    """As :attr:`NextMesh.moved_cells`."""
