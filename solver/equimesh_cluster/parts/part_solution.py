"""The solution that one part holds, and its measures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from equimesh.equations.problem import Problem, understood
from equimesh.meshes.mesh import Grid, MeshRows
from equimesh.numerics.types import Array
from equimesh.quality.measures import Quality, equidistribution
from equimesh.single_domain.level import Mode
from equimesh.solving.certificate import Certificate
from equimesh.solving.solution import MeasuredMesh
from equimesh.solving.status import Status
from equimesh_cluster.mesh_part import MeshPart
from equimesh_cluster.messages import Channel, Traffic
from equimesh_cluster.parts.rows import PartRows, rows_of_part
from equimesh_schema import Relaxed


@dataclass(frozen=True, kw_only=True)
class PartStep:
    """The record of one sweep, or of the end of a level: :class:`~equimesh.single_domain.level.Step` without a mesh.

    The numbers are of the whole mesh, and equal in every part. The traffic is of this part alone.
    """

    level: int
    levels: int
    grid: Grid
    step: int
    residual: float
    algebraic_error: float
    discretization_error: float
    contraction: float
    converged: bool
    traffic: dict[str, Traffic]
    """The traffic of this part since the last record, by the kind of the message."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PartRecord:
    """The record of the computation of a part.

    Only the traffic belongs to the part. All other fields are of the whole solution, and equal in every part; they mean
    the same as in :class:`~equimesh.solving.solution.Solution`.
    """

    mode: Mode
    status: Status
    newton_steps: int
    residual: float
    note: str = ""
    remedy: str = ""
    relaxed: tuple[Relaxed, ...] = ()
    algebraic_error: float | None = None
    discretization_error: float | None = None
    records: tuple[PartStep, ...] = ()
    """One record for each sweep on the levels that were solved in parts."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PartSolution(PartRecord):
    """The rows of one part of a solution, and the record of its computation."""

    problem: Problem
    mesh: MeshPart
    """The rows of the mesh of the domain: the rows of this part, and the first row of the next part."""
    reference: MeshRows
    """The mesh of the reference square: the rows of this part, and one more on each side."""
    threads: int = 1


# The quality and the certificate of a mesh in parts: those of the whole mesh, from what every part contributes.
#
# Each part measures its own cells. The parts send each other two rows of nodes, sums and extremes for each strip of
# rows, and a few numbers more. All of them get the same result, that of :class:`~equimesh.solving.solution.Solution`.


@dataclass(frozen=True, kw_only=True, eq=False)
class PartMeasures:
    """The measures of a whole mesh, small and the same in every part, and the values of the cells of one part."""

    quality: Quality
    """The quality measures of the whole mesh, without values of single cells."""
    certificate: Certificate
    """The certificate, with the faces and the interpolation errors."""
    q_eq: Array
    """Q_eq of the cells of the part, shape ``(rows of cells, n_eta - 1)``."""

    def without_cells(self) -> PartMeasures:
        """The measures without the values of the cells, to be sent to another process."""
        return PartMeasures(quality=self.quality, certificate=self.certificate, q_eq=np.empty((0, 0)))


def measure_part(part: PartSolution, channel: Channel) -> PartMeasures:
    """The measures of the whole mesh; ``part`` is the part of ``channel``. Every part has to call this function.

    It needs about 40 bytes for each point of the part, besides the part itself.
    """
    with np.errstate(all="ignore"):  # as in a solve: values that are not finite are detected where they matter
        mesh = rows_of_part(part.mesh, channel)
        measured = MeasuredMesh(
            problem=part.problem,
            mesh=mesh,
            reference=reference_rows(part.mesh, part.reference, channel),
            threads=part.threads,
        )
        quality = measured.quality()
        faces, errors = measured.faces(), quality.interpolation_error
        gains = measured.gains(errors)
        certificate = Certificate(
            status=part.status,
            mode=part.mode,
            equation_residual=measured.deviation(part.residual),
            min_jacobian=measured.min_jacobian(),
            faces=faces,
            discretization_error=part.discretization_error,
            algebraic_error=part.algebraic_error,
            relaxed=part.relaxed,
            warnings=measured.warnings(part.status, part.relaxed, errors, faces, gains),
            interpolation=errors,
            gains_by_degree=gains,
            understood=understood(part.problem),
        )
        return PartMeasures(quality=quality.without_cells(), certificate=certificate, q_eq=quality.q_eq.cells)


def equidistribution_of_part(part: PartSolution, channel: Channel) -> Array:
    """Q_eq of the cells of a part, as :func:`measure_part` finds it; every part has to call this.

    It needs about 35 bytes for each point of the part, besides the part itself, and less time than all measures.
    """
    mesh = rows_of_part(part.mesh, channel)
    return equidistribution(mesh, part.problem.monitor, threads=part.threads)


def reference_rows(part: MeshPart, reference: MeshRows, channel: Channel) -> MeshRows:
    """The rows of the mesh of the reference square that a part has, among those of all parts."""
    (first, last), rows = part.cell_rows, reference.rows
    there = PartRows(shape=rows.shape, begin=rows.begin, end=rows.end, first=first, last=last, channel=channel)
    return MeshRows(reference.x, reference.y, there)
