"""Measurements of a mesh after its solve: its quality, and the numbers of its certificate.

All rows of the mesh may be here, or some: the measures are those of the whole mesh.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

from equimesh.domains.closing import closed_of
from equimesh.equations.problem import Problem
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.mesh_rows import MeshWindow
from equimesh.monitors.least_error import LeastError
from equimesh.monitors.monitor import Monitor, map_of
from equimesh.monitors.nodal_solution import NodalSolution
from equimesh.numerics.types import Array
from equimesh.quality.comparison import UniformComparison, compare_with_uniform
from equimesh.quality.faces import Faces, measure_faces
from equimesh.quality.interpolation import InterpolationErrors
from equimesh.quality.measures import Quality, measure_all
from equimesh.solving.mesh_warnings import about_faces, warnings
from equimesh.solving.status import Status
from equimesh.sweeps.deviation import deviation
from equimesh_schema import Relaxed


def interpolated_cells(monitor: Monitor) -> Literal["quad", "triangle"]:
    """The cells on which u is interpolated: triangles where a least-error monitor asks for them."""
    return monitor.cells if isinstance(monitor, LeastError) else "quad"


def _unknown() -> Array | None:
    return None


@dataclass(frozen=True, kw_only=True, eq=False)
class MeasuredMesh:
    """The rows of a mesh that are here: ``mesh`` on the domain, ``reference`` on the reference square.

    ``u`` gives its values at the nodes of these rows, or ``None`` where they are not to be kept.
    """

    problem: Problem
    mesh: MeshWindow
    reference: MeshWindow
    u: Callable[[], Array | None] = _unknown
    threads: int = 1

    def quality(self) -> Quality:
        """All quality measures."""
        monitor, domain = self.problem.monitor, self.problem.domain
        return measure_all(
            self.mesh, monitor, domain=domain, kind=interpolated_cells(monitor), nodal=self.u(), threads=self.threads
        )

    def against_uniform(self, mesh: Mesh, errors: InterpolationErrors | None) -> UniformComparison:
        """The whole ``mesh``, of these ``errors``, next to the uniform mesh of its size."""
        monitor, domain = self.problem.monitor, self.problem.domain
        return compare_with_uniform(
            mesh, monitor, domain=domain, kind=interpolated_cells(monitor), interpolation=errors, threads=self.threads
        )

    def faces(self) -> Faces:
        """Non-orthogonality and skewness of the faces, as OpenFOAM defines them."""
        return measure_faces(self.mesh, closed_of(self.problem.domain))

    def min_jacobian(self) -> float:
        """The smallest corner Jacobian, 1 on the uniform mesh of a rectangle."""
        return self.mesh.min_jacobian / self.problem.domain.area

    def deviation(self, residual: float) -> float | None:
        """The residual of the equidistribution equations; ``None`` where these were not solved.

        ``residual`` is that of the solve; for a gradient map it is the answer.
        """
        if isinstance(self.problem.monitor, NodalSolution | LeastError):
            return None
        if map_of(self.problem.monitor) == "gradient":
            return residual
        metric, u = self.problem.metric, None
        if metric.arc_length is not None and metric.arc_length.factor is not None:
            u = self.u()
            u = u if metric.arc_length.factor == 1.0 or u is None else metric.arc_length.factor * u
        return deviation(metric, self.problem.boundary, self.reference, u=u, threads=self.threads)

    def warnings(
        self, status: Status, relaxed: Sequence[Relaxed], errors: InterpolationErrors | None, faces: Faces
    ) -> tuple[str, ...]:
        """Sentences to read before using the mesh."""
        found = warnings(self.problem, status, relaxed, (self.mesh, self.reference), errors)
        return (*found, *about_faces(faces))
