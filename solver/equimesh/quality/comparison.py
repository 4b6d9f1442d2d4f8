"""A mesh and the uniform mesh of its size: what both are worth, cell by cell."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from equimesh.domains.domain import UNIT_SQUARE, Domain, map_mesh
from equimesh.errors import InputError
from equimesh.fields.expression import Field
from equimesh.meshes.mesh import Mesh
from equimesh.monitors.monitor import Monitor
from equimesh.numerics.types import Array
from equimesh.quality.cells import CellPoints, MeshCells, cells_of
from equimesh.quality.degrees import squared_errors_of_cells
from equimesh.quality.elements import CellKind
from equimesh.quality.interpolation import InterpolationErrors
from equimesh.quality.measures import error_rule, metric_rule
from equimesh.quality.survey import Survey
from equimesh.quality.tally import ErrorTally


@dataclass(frozen=True, kw_only=True, eq=False)
class ComparedMesh:
    """One of two compared meshes, with the measures of its cells."""

    mesh: Mesh
    """The mesh of the domain."""
    q_eq: Array
    """Equidistribution of every cell, 1 best, of the ``cell_shape`` of the mesh; infinite on a folded cell."""
    u: Array | None
    """u at the nodes, of the ``node_shape`` of the mesh; ``None`` where there is no u."""
    error: Array | None
    """Root mean square of ``u - u_h`` over every cell, in the unit of u, of the ``cell_shape`` of the mesh.

    u_h is the interpolant of :class:`~equimesh.quality.interpolation.InterpolationErrors`. The sum of the squared
    numbers times the areas of the cells is the square of the L2 error, where that is resolved. Infinite on a folded
    mesh; ``None`` where there is no u.
    """


@dataclass(frozen=True, kw_only=True, eq=False)
class UniformComparison:
    """A mesh and the uniform mesh of the same domain and size; for blocks a mesh and the initial mesh."""

    adapted: ComparedMesh
    """The mesh itself."""
    uniform: ComparedMesh
    """The image of the uniform mesh of the unit square; for blocks the initial mesh."""
    interpolation: InterpolationErrors | None
    """The errors on both meshes, and their ratios, the gains; ``None`` where there is no u."""

    @property
    def is_exact(self) -> bool:
        """Whether the errors on both meshes are rounding, so that no gain is told."""
        return self.interpolation is not None and self.interpolation.is_exact

    @property
    def gain(self) -> float | None:
        """The L2 error on the uniform mesh over the L2 error on this mesh.

        The best estimate where the error is not resolved; ``None`` where there is no u or no valid mesh.
        """
        errors = self.interpolation
        if errors is None or not math.isfinite(errors.l2):
            return None
        return errors.estimated_gain("l2")


def compare_with_uniform(
    mesh: Mesh,
    monitor: Monitor,
    *,
    domain: Domain = UNIT_SQUARE,
    uniform: Mesh | None = None,
    kind: Literal["quad", "triangle"] = "quad",
    degree: int = 1,
    interpolation: InterpolationErrors | None = None,
    threads: int = 1,
) -> UniformComparison:
    """``mesh`` next to the uniform mesh of ``domain``, which must be valid, at the cost of measuring both.

    A mesh of blocks is compared with ``uniform``, the mesh that it began with; for a grid it takes the place of the
    uniform mesh. Raises :class:`~equimesh.errors.InputError` for a mesh of blocks without it.

    ``monitor`` must be bound to the domain. u is interpolated on cells of this ``kind`` by elements of this
    ``degree``. ``interpolation`` are the errors of the whole mesh, which
    :func:`~equimesh.quality.measures.measure` finds. ``threads`` share the cells.
    """
    if uniform is None and not mesh.is_grid:
        raise InputError("a mesh of blocks has no uniform one: give the mesh that it began with", field="uniform")
    if uniform is None:
        uniform = map_mesh(Mesh.uniform(mesh.grid), domain)
    return UniformComparison(
        adapted=_measured(mesh, monitor, (kind, degree), threads),
        uniform=_measured(uniform, monitor, (kind, degree), threads),
        interpolation=interpolation,
    )


def _measured(mesh: Mesh, monitor: Monitor, element: tuple[CellKind, int], threads: int) -> ComparedMesh:
    with np.errstate(all="ignore"):
        cells, u = cells_of(mesh), monitor.u
        nodal = None if u is None else u.evaluate(mesh.x, mesh.y)[0]
        tally, rule = None, metric_rule(cells)
        is_inside = rule is not CellPoints.corners()
        if u is not None and element == ("quad", 1) and cells.all_valid:
            tally = ErrorTally.of(cells, u, error_rule(cells), nodal=nodal)
        survey = Survey.of(cells, monitor, rule, tally=tally if is_inside else None, threads=threads)
        if tally is not None:
            tally.add_edges() if is_inside else tally.add_all(threads)
        return ComparedMesh(
            mesh=mesh,
            q_eq=survey.q_eq.reshape(mesh.cell_shape),
            u=nodal,
            error=_root_mean_squares(cells, u, element, tally),
        )


def _root_mean_squares(
    cells: MeshCells, u: Field | None, element: tuple[CellKind, int], tally: ErrorTally | None
) -> Array | None:
    """The error of every cell; ``tally`` has those of bilinear elements."""
    if u is None:
        return None
    if not cells.all_valid:
        return np.full(cells.own_shape, np.inf)
    kind, degree = element
    squares = squared_errors_of_cells(cells, u, degree, kind) if tally is None else tally.sums[0]
    return np.asarray(np.sqrt(squares / cells.area).reshape(cells.own_shape))
