"""The result of a solve on a domain in blocks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from equimesh.equations.block_problem import BlockProblem
from equimesh.equations.problem import understood
from equimesh.least_error.block_schwarz import BlockSchwarz
from equimesh.meshes.mesh_data import MeshData
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.numerics.types import Array
from equimesh.quality.cells import Angles, measure_angles
from equimesh.quality.comparison import UniformComparison, compare_with_uniform
from equimesh.quality.cut_off import CutOff, measure_block_cut_off
from equimesh.quality.faces import Faces, measure_faces
from equimesh.quality.interpolation import InterpolationErrors
from equimesh.quality.measures import Quality, measure_interpolation, measure_quality
from equimesh.solving.certificate import Certificate
from equimesh.solving.measured_mesh import interpolated_cells
from equimesh.solving.mesh_warnings import about_cut_off, block_warnings
from equimesh.solving.status import Status
from equimesh_schema import Candidate, Estimate, Relaxed


@dataclass(frozen=True, kw_only=True, repr=False)
class BlockSolution:
    """A mesh of a domain in blocks, the record of its computation, and how good it is.

    Errors are compared with those on the ``initial`` mesh of the domain.
    """

    problem: BlockProblem
    """The problem that was solved."""
    mesh: QuadMesh
    """The mesh of the domain."""
    status: Status
    """How the solve ended."""
    descent: tuple[Mapping[str, Any], ...] = ()
    """One record for each step of descent, as :meth:`~equimesh.least_error.steps.Descent.numbers`."""
    comparison: tuple[Candidate, ...] = ()
    """The weights that were compared for an ``Auto`` monitor; empty where they were given."""
    estimate: Estimate | None = None
    """The estimated error of the values that a round of adapting was given; ``None`` for other meshes."""
    relaxed: tuple[Relaxed, ...] = ()
    """The differences between the requested and the used weights."""
    detours: tuple[str, ...] = ()
    """Sentences about deviations of the solve from the request."""
    note: str = ""
    """Details of the status."""
    remedy: str = ""
    """The remedy in a sentence; empty when nothing is wrong."""
    schwarz: BlockSchwarz | None = None
    """The settings of the Schwarz iteration between blocks; ``None`` for a solve of the whole mesh."""
    threads: int = 1
    """The threads of the solve; as many measure the quality of a large mesh."""

    def __repr__(self) -> str:
        return f"<BlockSolution: {self.problem.points} points, {self.status}>"

    @property
    def initial(self) -> QuadMesh:
        """The initial mesh of the domain."""
        return self.problem.domain.mesh

    @property
    def message(self) -> str:
        """The status in a sentence, its details, and the remedy."""
        return " ".join(text for text in (self.status.sentence, self.note, self.remedy) if text)

    @cached_property
    def u(self) -> Array | None:
        """u at the nodes, shape ``(n,)``; ``None`` where there is no u."""
        field = self.problem.monitor.u
        return None if field is None else field.evaluate(self.mesh.x, self.mesh.y)[0]

    @cached_property
    def quality(self) -> Quality:
        """All quality measures of the mesh."""
        return measure_quality(self.mesh, self.problem.monitor, self.interpolation, threads=self.threads)

    @cached_property
    def interpolation(self) -> InterpolationErrors | None:
        """How well the mesh interpolates u, compared with the initial mesh; ``None`` where there is no u."""
        return measure_interpolation(
            self.mesh,
            self.problem.monitor.u,
            uniform=self.initial,
            kind=interpolated_cells(self.problem.monitor),
            threads=self.threads,
        )

    @cached_property
    def against_initial(self) -> UniformComparison:
        """The mesh next to the initial one: u, Q_eq and the error of every cell on both."""
        return compare_with_uniform(
            self.mesh,
            self.problem.monitor,
            uniform=self.initial,
            kind=interpolated_cells(self.problem.monitor),
            interpolation=self.interpolation,
            threads=self.threads,
        )

    @cached_property
    def faces(self) -> Faces:
        """Non-orthogonality and skewness of the faces, as OpenFOAM defines them."""
        return measure_faces(self.mesh)

    @cached_property
    def angles(self) -> Angles:
        """The smallest and largest angle of a corner, and the share of corners between 30 and 150 degrees."""
        return measure_angles(self.mesh)

    @cached_property
    def cut_off(self) -> CutOff:
        """The areas between the curved sides of the domain and the cells, as shares of its area."""
        return measure_block_cut_off(self.problem.domain, self.mesh)

    @cached_property
    def warnings(self) -> tuple[str, ...]:
        """Sentences to read before using the mesh."""
        u, on_triangles = self.problem.monitor.u, interpolated_cells(self.problem.monitor) == "triangle"
        initial = None if on_triangles else self.initial
        found = block_warnings(self.mesh, initial, u, self.interpolation, self.faces)
        return (*self.detours, *found, *about_cut_off(self.cut_off))

    @cached_property
    def certificate(self) -> Certificate:
        """How good the mesh is; see :class:`~equimesh.solving.certificate.Certificate`."""
        return Certificate(
            status=self.status,
            mode=None,
            equation_residual=None,
            min_jacobian=self.mesh.min_jacobian,
            faces=self.faces,
            relaxed=self.relaxed,
            warnings=self.warnings,
            interpolation=self.interpolation,
            comparison=self.comparison,
            estimate=self.estimate,
            compared_with="initial",
            understood=understood(self.problem),
        )

    def convergence(self) -> dict[str, Any]:
        """The history of the descent as plain numbers, ``None`` where one is not known."""
        return {"iterations": [], "rate": None, "predicted_rate": None, "descent": list(self.descent)}

    def data(self) -> MeshData:
        """The contents of a mesh file: nodes, u, Q_eq, and the number of the block of every cell."""
        block = np.zeros(self.mesh.cell_shape, dtype=np.int64)
        for number, cells in enumerate(self.mesh.block_cells):
            block[cells] = number
        return MeshData(mesh=self.mesh, u=self.u, q_eq=self.quality.q_eq.cells, subdomain=block)
