"""Solutions: a mesh of a grid or of blocks with its measures, its certificate and its files."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, Literal, TypeAlias

import numpy as np

from equimesh.blocks.blocks import Blocks
from equimesh.domains.domain import closed_of
from equimesh.equations.problem import D, Problem, understood
from equimesh.errors import EquimeshError
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.mesh_data import MeshData, joined
from equimesh.meshes.nested import Closed
from equimesh.monitors.least_error import Auto, LeastError, NodalSolution
from equimesh.monitors.monitor import Monitor, map_of
from equimesh.numerics.types import Array, IntArray
from equimesh.quality.cells import Angles, AnyMesh, UniformCells, cells_of, measure_angles
from equimesh.quality.comparison import UniformComparison, compare_with_uniform
from equimesh.quality.degrees import gains_by_degree
from equimesh.quality.faces import Faces, measure_faces
from equimesh.quality.interpolation import InterpolationErrors
from equimesh.quality.measures import (
    CutOff,
    Quality,
    measure_all,
    measure_cut_off,
    measure_errors,
)
from equimesh.quality.ritz import solver_gain
from equimesh.quality.shapes import Shapes
from equimesh.schwarz.decomposition import Decomposition
from equimesh.schwarz.rates import predicted_rate
from equimesh.schwarz.records import Iteration, last_rate, plain
from equimesh.schwarz.settings import Schwarz
from equimesh.single_domain.level import Mode
from equimesh.solving.certificate import Certificate, about_faces, warnings
from equimesh.solving.status import Status
from equimesh.sweeps.deviation import deviation
from equimesh_coupling.display import draw_on, picture
from equimesh_schema import Aim, Candidate, DegreeGain, Estimate, Relaxed, SolverGain
from equimesh_schema.notebook import html_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Measurements of a mesh after its solve: its quality, and the numbers of its certificate.
#
# All rows of the mesh may be here, or some: the measures are those of the whole mesh.


def interpolated_cells(monitor: Monitor) -> Literal["quad", "triangle"]:
    """The cells on which u is interpolated: triangles where a least-error monitor or a round asks for them."""
    return monitor.cells if isinstance(monitor, LeastError | NodalSolution) else "quad"


def degree_of(monitor: Monitor) -> int:
    """The degree of the elements by which u is interpolated: that of a least-error monitor or a round, else 1."""
    return monitor.degree if isinstance(monitor, Auto | LeastError | NodalSolution) else 1


def _unknown() -> Array | None:
    return None


@dataclass(frozen=True, kw_only=True, eq=False)
class MeasuredMesh:
    """A mesh of any topology, or the rows of a grid that are here.

    ``mesh`` is that of the domain, ``reference`` the one on the reference square; of blocks the mesh itself. ``u``
    gives its values at the nodes that are here, or ``None`` where they are not to be kept.
    """

    problem: Problem[Any]
    mesh: AnyMesh
    reference: AnyMesh
    u: Callable[[], Array | None] = _unknown
    threads: int = 1
    _shapes: list[Shapes] = field(default_factory=list, init=False, repr=False)

    @property
    def _given(self) -> Mesh | None:
        """The mesh to compare with where it is given; of a grid it is the image of the uniform one."""
        return None if self.mesh.is_grid else self.problem.initial

    def quality(self, nodal: Array | None = None, errors: InterpolationErrors | None = None) -> Quality:
        """All quality measures; ``nodal`` is u at the nodes, and ``errors`` are its errors, where these are known."""
        monitor = self.problem.monitor
        return measure_all(
            self.mesh,
            monitor,
            uniform=self._given,
            domain=self.problem.domain,
            kind=interpolated_cells(monitor),
            degree=degree_of(monitor),
            nodal=nodal,
            errors=errors,
            shapes=self.shapes,
            threads=self.threads,
        )

    @property
    def shapes(self) -> Shapes:
        """What is measured of the mesh alone: quality and faces have it in common.

        A cached property of Python 3.11 has one lock for all objects: parts that are threads would wait for each other.
        """
        if not self._shapes:
            self._shapes.append(Shapes.of(cells_of(self.mesh, self._closed), threads=self.threads))
        return self._shapes[0]

    @property
    def _closed(self) -> Closed:
        return closed_of(self.problem.domain)

    def errors(self) -> InterpolationErrors | None:
        """The errors of interpolating u alone; ``None`` where there is no u."""
        monitor = self.problem.monitor
        if monitor.u is None:
            return None
        return measure_errors(
            self.mesh,
            monitor.u,
            uniform=self._given,
            domain=self.problem.domain,
            kind=interpolated_cells(monitor),
            degree=degree_of(monitor),
            threads=self.threads,
        )

    def against_uniform(self, mesh: Mesh, errors: InterpolationErrors | None) -> UniformComparison:
        """The whole ``mesh``, of these ``errors``, next to the uniform mesh of its size, or to the initial one."""
        monitor = self.problem.monitor
        return compare_with_uniform(
            mesh,
            monitor,
            domain=self.problem.domain,
            uniform=self._given,
            kind=interpolated_cells(monitor),
            degree=degree_of(monitor),
            interpolation=errors,
            threads=self.threads,
        )

    def faces(self) -> Faces:
        """Non-orthogonality and skewness of the faces, as OpenFOAM defines them."""
        is_plain = self.mesh.is_grid and not any(self._closed)
        return measure_faces(self.mesh, self._closed, shapes=self.shapes if is_plain else None)

    def min_jacobian(self) -> float:
        """The smallest corner Jacobian, 1 on the uniform mesh of a rectangle; on blocks relative to the mean cell."""
        return self.mesh.min_jacobian / (self.problem.domain.area if self.mesh.is_grid else 1.0)

    def gains(self, errors: InterpolationErrors | None) -> tuple[DegreeGain, ...]:
        """The gains of elements of each degree; none without u, and on a folded mesh."""
        problem, given, mesh = self.problem, self._given, self.shapes.cells
        if problem.monitor.u is None or errors is None or not mesh.all_valid:
            return ()
        other = UniformCells(problem.grid, problem.domain, mesh.rows) if given is None else cells_of(given)
        return gains_by_degree(mesh, other, problem.monitor.u, errors, interpolated_cells(problem.monitor))

    def deviation(self, residual: float) -> float | None:
        """The residual of the equidistribution equations; ``None`` where these were not solved.

        ``residual`` is the residual of the solve. For a gradient map it is returned.
        """
        if isinstance(self.problem.monitor, NodalSolution | LeastError) or not self.mesh.is_grid:
            return None
        if map_of(self.problem.monitor) == "gradient":
            return residual
        metric, u = self.problem.metric, None
        if metric.arc_length is not None and metric.arc_length.factor is not None:
            u = self.u()
            u = u if metric.arc_length.factor == 1.0 or u is None else metric.arc_length.factor * u
        return deviation(metric, self.problem.boundary, self.reference, u=u, threads=self.threads)

    def warnings(
        self,
        status: Status,
        relaxed: Sequence[Relaxed],
        errors: InterpolationErrors | None,
        faces: Faces,
        gains: Sequence[DegreeGain],
    ) -> tuple[str, ...]:
        """Sentences to read before using the mesh."""
        found = warnings(self.problem, status, relaxed, (self.mesh, self.reference), errors, gains)
        return (*found, *about_faces(faces))


@dataclass(frozen=True, kw_only=True, repr=False)
class Solution(Generic[D]):
    """A mesh of the physical domain, the record of its computation, and whether it is the requested one.

    The mesh is a :class:`~equimesh.meshes.mesh.Mesh` of a grid, or a :class:`~equimesh.meshes.mesh.Mesh` of
    blocks, whose errors are compared with those on the initial mesh of the domain. What only equidistribution on a grid
    has is left at its default on blocks: ``None``, NaN, 0 or empty.
    """

    problem: Problem[D]
    """The problem that was solved."""
    schwarz: Schwarz | None = None
    """The settings of the Schwarz iteration; ``None`` for a solve of the whole mesh."""
    mesh: Mesh
    """The mesh of the domain."""
    reference: Mesh
    """The same mesh on the reference square; of blocks the mesh itself. Solves can start from it."""
    status: Status
    """The end of the solve."""
    newton_steps: int = 0
    """Newton steps, sweeps, or steps of descent on the finest mesh, of subdomains their exchanges; of a Schwarz
    iteration that equidistributes, summed over iterations and subdomains.
    """
    residual: float = math.nan
    """The largest residual at the end; of a Schwarz iteration, over all subdomains. Dimensionless.

    For sweeps it is the largest relative deviation of a squared metric length from the mean of its line. For Newton's
    method it is the residual relative to the mean flux. For a gradient map it is the root mean square of the relative
    deviations of the cells' shares from their mean. NaN for least error.
    """
    mode: Mode | None = None
    """The condition that ends a single-domain solve; ``None`` for a Schwarz iteration and for a gradient map."""
    iterations: tuple[Iteration, ...] = ()
    """One record for each Schwarz iteration; empty for a single-domain solve."""
    descent: tuple[Mapping[str, Any], ...] = ()
    """One record for each step of a least-error solve, as :meth:`~equimesh.least_error.descent.Descent.numbers`."""
    target: Aim | None = None
    """The requested interpolation error and what was reached; ``None`` where a grid was given."""
    comparison: tuple[Candidate, ...] = ()
    """The candidates among which the monitor was chosen; empty where it was given."""
    estimate: Estimate | None = None
    """The estimated error of the values that a round of adapting was given; ``None`` for other meshes."""
    detours: tuple[str, ...] = ()
    """Sentences about deviations of the solve from the request."""
    note: str = ""
    """Details of the status."""
    remedy: str = ""
    """The remedy in a sentence; empty when nothing is wrong."""
    relaxed: tuple[Relaxed, ...] = ()
    """The differences between the requested and the solved equations."""
    algebraic_error: float | None = None
    """Estimate of the largest error of a node's coordinate from stopping the iteration, in units of the square."""
    discretization_error: float | None = None
    """Estimate of the largest error of a node's coordinate from the grid, in units of the square."""
    threads: int = 1
    """The threads of the solve; as many measure the quality of a large mesh."""

    def __getstate__(self) -> dict[str, Any]:
        """The fields, for pickle: measures are made anew where they are asked for."""
        return {one.name: getattr(self, one.name) for one in fields(self)}

    def __repr__(self) -> str:
        size = " x ".join(map(str, self.mesh.node_shape))
        steps = f", {len(self.iterations)} iterations" if self.iterations else ""  # a descent counts none
        return f"<Solution: {size} points, {self.status}{steps}>"

    @property
    def message(self) -> str:
        """The status in a sentence, its details, and the remedy."""
        return " ".join(text for text in (self.status.sentence, self.note, self.remedy) if text)

    @cached_property
    def quality(self) -> Quality:
        """All quality measures of the mesh."""
        return self._measured.quality(vars(self).get("u"), vars(self).get("interpolation"))

    @cached_property
    def interpolation(self) -> InterpolationErrors | None:
        """The errors of interpolating u on the mesh and on the uniform or initial mesh; ``None`` where there is no u.

        On triangles where a least-error monitor asks for them, else on quadrilaterals.
        """
        # A solve for the least error asks for its errors. The metric of its monitor takes longer than a small solve.
        if isinstance(self.problem.monitor, LeastError) and "quality" not in vars(self):
            return self._measured.errors()
        return self.quality.interpolation_error

    @cached_property
    def solver_gain(self) -> SolverGain | None:
        """How many times smaller the error of a solver is than on the uniform or initial mesh; ``None`` without a u.

        Of the Ritz projection of u, see :func:`~equimesh.quality.ritz.solver_gain`. NaN where :attr:`interpolation` is
        not resolved, since a layer of u that lies inside a cell is seen by no solver. Elements have the degree of the
        monitor.
        """
        errors, monitor = self.interpolation, self.problem.monitor
        if errors is None or monitor.u is None:
            return None
        triangles = interpolated_cells(monitor) == "triangle"
        found = solver_gain(self.mesh, self.initial, monitor.u, triangles=triangles, degree=degree_of(monitor))
        l2, h1 = errors.resolved
        return found and replace(found, l2=found.l2 if l2 else math.nan, h1=found.h1 if h1 else math.nan)

    @cached_property
    def against_uniform(self) -> UniformComparison:
        """The mesh next to the uniform mesh of its size, of blocks the initial one: u, Q_eq, the error of each cell."""
        return self._measured.against_uniform(self.mesh, self.interpolation)

    @property
    def initial(self) -> Mesh:
        """The mesh with which this one is compared: the uniform mesh of the domain, of blocks their initial mesh."""
        return self.problem.initial

    @cached_property
    def u(self) -> Array | None:
        """u at the nodes of the mesh; ``None`` where there is no u."""
        measured: Quality | None = vars(self).get("quality")
        if measured is not None and measured.u is not None:
            return measured.u.reshape(self.mesh.node_shape)
        own = self.problem.monitor.u
        return None if own is None else own.evaluate(self.mesh.x, self.mesh.y)[0]

    @property
    def ties(self) -> IntArray:
        """Nodes of closed lines or periodic sides that are one, shape ``(k, 2)``: a copy, and its original."""
        return self.mesh.ties

    @cached_property
    def joined(self) -> Mesh:
        """The mesh of the domain with one number for each node, also on a seam that lies on itself, as of a ring.

        Copies that are a period apart stay, as its ``ties``. Of blocks it is the mesh itself.
        """
        return joined(self.mesh)

    @cached_property
    def faces(self) -> Faces:
        """Non-orthogonality and skewness of the faces, as OpenFOAM defines them."""
        return self._measured.faces()

    @cached_property
    def angles(self) -> Angles:
        """The smallest and largest angle of a corner, and the share of corners between 30 and 150 degrees."""
        return measure_angles(self.mesh)

    @cached_property
    def cut_off(self) -> CutOff:
        """The areas between the curved sides of the domain and the cells, as shares of its area."""
        return measure_cut_off(self.problem.domain, self.reference)

    @cached_property
    def _measured(self) -> MeasuredMesh:
        """The measures of the mesh."""
        mesh, reference = self.mesh, self.reference
        return MeasuredMesh(
            problem=self.problem, mesh=mesh, reference=reference, u=lambda: self.u, threads=self.threads
        )

    @cached_property
    def warnings(self) -> tuple[str, ...]:
        """Sentences to read before using the mesh, as the certificate has them."""
        errors, faces, gains = self.interpolation, self.faces, self.gains_by_degree
        return self.detours + self._measured.warnings(self.status, self.relaxed, errors, faces, gains)

    @cached_property
    def gains_by_degree(self) -> tuple[DegreeGain, ...]:
        """How many times smaller the error of elements of degree 1, 2 and 3 is than on the uniform or initial mesh.

        On triangles of degree 1 and 2. Empty without a u, and for a folded mesh.
        """
        return self._measured.gains(self.interpolation)

    @cached_property
    def certificate(self) -> Certificate:
        """The certificate of the mesh; see :class:`~equimesh.solving.certificate.Certificate`."""
        return Certificate(
            status=self.status,
            mode=self.mode,
            equation_residual=self._measured.deviation(self.residual),
            min_jacobian=self._measured.min_jacobian(),
            faces=self.faces,
            discretization_error=self.discretization_error,
            algebraic_error=self.algebraic_error,
            relaxed=self.relaxed,
            warnings=self.warnings,
            interpolation=self.interpolation,
            gains_by_degree=self.gains_by_degree,
            solver_gain=self.solver_gain if self._takes_longer else None,
            target=self.target,
            comparison=self.comparison,
            estimate=self.estimate,
            compared_with=self.mesh.compared_with,
            understood=understood(self.problem),
        )

    @property
    def _takes_longer(self) -> bool:
        """Whether the solve takes several times as long as to measure what a solver gets."""
        return bool(self.comparison) or isinstance(self.problem.monitor, LeastError)

    @property
    def gain(self) -> float:
        """How many times smaller the L2 error is than on the uniform mesh, or on the initial one of blocks.

        Of a solver where the certificate has it, else of interpolating u. NaN where there is no u or no valid mesh.
        """
        found = self.certificate.solver_gain or self.certificate.interpolation_gain
        return math.nan if found is None else found["l2"]

    def plot(self, axes: Axes | None = None) -> Axes:
        """Draw the mesh on ``axes`` of matplotlib, or on those of pyplot, with the error of each cell as its colour."""
        return draw_on(self.mesh, self.against_uniform.adapted.error, axes)

    def write(
        self,
        path: str | os.PathLike[str],
        *,
        cells: Literal["quad", "triangle"] = "quad",
        order: Literal[1, 2] = 1,
    ) -> tuple[Path, ...]:
        """Write the mesh with its data in the format of the suffix; see :func:`equimesh.io.write_mesh`."""
        from equimesh.fields.curved_sides import curved_edges
        from equimesh.io.write import write_mesh

        data = self.data()
        if order == 2:
            data = replace(data, curved=curved_edges(self.mesh, self.problem.domain))
        return write_mesh(path, data, cells=cells, order=order)

    def _repr_html_(self) -> str:
        """A picture and a table, for notebooks."""
        facts = [("points", " x ".join(map(str, self.mesh.node_shape))), ("status", self.status.sentence)]
        if self.interpolation is not None:
            errors = f"{self.interpolation.l2:.3g} in L2, {self.interpolation.h1:.3g} in H1"
            facts.append(("interpolation error of u", errors))
        facts.append(("non-orthogonality", f"at most {self.faces.non_orthogonality:.0f} degrees"))
        certificate, compared = self.certificate, self.against_uniform.adapted
        return html_of(certificate.headline, facts, certificate.warnings, picture(compared.mesh, compared.error))

    @property
    def decomposition(self) -> Decomposition | None:
        """The subdomains of the Schwarz iteration on a grid; ``None`` on blocks."""
        grid = self.problem.grid
        if self.schwarz is None or grid is None:
            return None
        return self.schwarz.rectangles(grid) if self.descent else self.schwarz.decompose(grid)

    @property
    def rate(self) -> float | None:
        """Observed factor by which the error, or else the change, falls in one iteration of the last condition."""
        problem: Problem[Any] = self.problem
        return last_rate(problem, self.iterations) if self.iterations else None

    @property
    def predicted_rate(self) -> float | None:
        """The rate that theory predicts, where there is one; see :func:`equimesh.schwarz.rates.predicted_rate`."""
        parts, settings = self.decomposition, self.schwarz
        is_known = parts is not None and settings is not None and not self.descent
        return predicted_rate(parts, settings) if is_known else None  # type: ignore[arg-type]

    def convergence(self) -> dict[str, Any]:
        """The history of the Schwarz iteration or of the descent as plain numbers, ``None`` where one is not known."""
        history = plain(self.iterations, self.rate, self.predicted_rate)
        return {**history, "descent": list(self.descent)} if self.descent else history

    def data(self, *, joined: bool = False) -> MeshData:
        """The contents of a mesh file: nodes, u, Q_eq, and the number of the subdomain or block of every cell.

        With ``joined`` the mesh is :attr:`joined`, without the second copies of nodes of a seam that lies on itself.
        """
        owner, parts = np.zeros(self.mesh.cell_shape, dtype=np.int64), self.decomposition
        for number, cells in enumerate(self.mesh.block_cells):
            owner.reshape(-1)[cells] = number
        owner = owner if parts is None else parts.owner_of_cells()
        data = MeshData(mesh=self.mesh, q_eq=self.quality.q_eq.cells, u=self.u, subdomain=owner)
        return data.joined if joined else data


def status_unless_folded(status: Status, *, folded: bool) -> Status:
    """The status, or ``FOLDED`` in place of a success where the mesh is ``folded``."""
    return Status.FOLDED if status.succeeded and folded else status


OnBlocks: TypeAlias = Solution[Blocks]
"""A solution on a domain in blocks."""
AnySolution: TypeAlias = Solution[Any]
"""A solution on a grid, or on blocks."""


class SolveError(EquimeshError):
    """A solve that ended without the requested mesh. ``solution`` is a :class:`Solution` with the partial result."""

    def __init__(self, message: str, solution: AnySolution) -> None:
        super().__init__(message)
        self.solution: Any = solution

    def __reduce__(self) -> tuple[type[SolveError], tuple[str, AnySolution]]:
        """The arguments for pickle, so that the caller of a worker gets the error."""
        return type(self), (str(self), self.solution)
