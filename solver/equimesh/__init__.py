"""Local equidistribution of 2D meshes by nonlinear Schwarz domain decomposition.

    >>> import equimesh as em
    >>> u = em.Expression("(1 - exp(15*(x - 1))) * sin(pi*y)")
    >>> problem = em.Problem(monitor=em.ArcLength(u=u), grid=em.Grid(n_xi=33, n_eta=33))
    >>> solution = em.solve(problem, em.Schwarz(subdomains=(2, 1)))
    >>> solution.status.sentence
    'The mesh satisfies the equidistribution equations to the requested tolerance.'

The method is that of R. D. Haynes and A. J. M. Howse, *Generating Equidistributed Meshes in 2D via Domain
Decomposition*. Begin reading in ``schwarz/iteration.py``. ``__all__`` is the table of contents.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from equimesh_coupling.errors import deferred as _deferred

if TYPE_CHECKING:
    from equimesh.adaptation.loop import adapt
    from equimesh.blocks.block_grid import BlockGrid
    from equimesh.blocks.blocks import Blocks
    from equimesh.domains.curve import Curve
    from equimesh.domains.domain import AnnulusSector, Domain, Rectangle
    from equimesh.domains.quadrilateral import Quadrilateral
    from equimesh.equations.problem import Boundary, Problem
    from equimesh.errors import DecompositionError, EquimeshError, ExpressionError, InputError, Position, SamplesError
    from equimesh.fields.chunked_samples import ChunkedSamples
    from equimesh.fields.expression import Expression, Field
    from equimesh.fields.nodal_field import NodalField
    from equimesh.fields.quad_field import QuadField
    from equimesh.fields.samples import GridSamples
    from equimesh.fields.scattered_samples import ScatteredSamples
    from equimesh.least_error.descent import Descent
    from equimesh.meshes.mesh import Grid, Mesh
    from equimesh.meshes.mesh_data import MeshData
    from equimesh.monitors.least_error import Auto, LeastError, NodalSolution
    from equimesh.monitors.metrics import ArcLength, Curvature
    from equimesh.monitors.monitor import Monitor
    from equimesh.monitors.smoothed import Smoothed
    from equimesh.monitors.tensor import Intersection, Tensor, Weight
    from equimesh.quality.measures import Quality, measure
    from equimesh.rounds.next_mesh import Round
    from equimesh.rounds.round import adapt_round
    from equimesh.schwarz.conditions import (
        Classical,
        LinearRobin,
        LineData,
        NonlinearRobin,
        Optimized,
        TransmissionCondition,
    )
    from equimesh.schwarz.decomposition import Decomposition, Ordering
    from equimesh.schwarz.iteration import schwarz_iterations as iterate
    from equimesh.schwarz.records import Iteration, SubdomainRecord
    from equimesh.schwarz.settings import Acceleration, LocalSolver, Schwarz
    from equimesh.sequences.pursuit import Earlier
    from equimesh.sequences.sequence import Sequence, SequenceStep
    from equimesh.single_domain.level import Mode, Step
    from equimesh.solving.certificate import Certificate
    from equimesh.solving.solution import Solution, SolveError
    from equimesh.solving.solve import solve
    from equimesh.solving.status import Event, Initial, Status
    from equimesh.solving.target import Target, solve_to
    from equimesh.specs.short import mesh
    from equimesh.specs.widget import widget
    from equimesh.transfers.integrals import integral
    from equimesh.transfers.mesh_values import MeshValues
    from equimesh.transfers.transfer import transfer
    from equimesh_coupling.adaptation import Adaptation, AdaptRound
    from equimesh_coupling.errors import BadValues, CouplingError, MissingLibrary, OldLibrary
    from equimesh_coupling.goals import Goal, WithAdjoint
    from equimesh_coupling.progress_bar import ProgressBar
    from equimesh_coupling.recovery import CellAverages, ErrorIndicator
    from equimesh_schema import Aim, Candidate, Relaxed

_FACES = ("io", "meshes", "plot", "quality", "schwarz", "specs", "testing", "upload")
"""Packages with public names of their own."""
_RENAMED = {
    "BlockProblem": "Problem",
    "BlockSolution": "Solution",
    "BlockSchwarz": "Schwarz",
    "BlockSequence": "Sequence",
    "BlockStep": "SequenceStep",
    "QuadMesh": "Mesh",
}


if not TYPE_CHECKING:

    def __getattr__(name: str) -> Any:
        """A name of ``__all__``, whose module is imported at its first use."""
        if name in _RENAMED:
            raise AttributeError(f"equimesh.{name} is equimesh.{_RENAMED[name]} now, of grids and of blocks")
        if name in _FACES:
            return import_module(f"equimesh.{name}")
        return _deferred(__name__, name)


def __dir__() -> list[str]:
    """What people need; modules stay out."""
    return sorted(__all__)


__all__ = [  # noqa: RUF022 - grouped by noun
    # From a function to its mesh in one short call
    "mesh",
    "widget",
    # The problem: a monitor on a grid of a domain
    "Problem",
    "Grid",
    "Boundary",
    # Domains: images of the unit square
    "Domain",
    "Rectangle",
    "AnnulusSector",
    "Quadrilateral",
    "Curve",
    # A domain of several blocks: holes, steps, airfoils
    "Blocks",
    "BlockGrid",
    # Fields: functions of x and y with derivatives
    "Field",
    "Expression",
    "GridSamples",
    "ChunkedSamples",
    "ScatteredSamples",
    "NodalField",
    "QuadField",
    # Values on a mesh, and the way to another mesh
    "MeshValues",
    "transfer",
    "integral",
    # Monitors: metrics that a mesh equidistributes
    "Monitor",
    "Auto",
    "LeastError",
    "NodalSolution",
    "ArcLength",
    "Curvature",
    "Weight",
    "Tensor",
    "Intersection",
    "Smoothed",
    # Settings of the Schwarz iteration
    "Schwarz",
    "Ordering",
    "LocalSolver",
    "Acceleration",
    "Decomposition",
    # Transmission conditions between subdomains
    "TransmissionCondition",
    "Classical",
    "LinearRobin",
    "NonlinearRobin",
    "Optimized",
    "LineData",
    # Solving: one call, for a grid or for an error, or a generator of Schwarz iterations
    "solve",
    "solve_to",
    "Target",
    "iterate",
    "Initial",
    "Mode",
    "ProgressBar",
    # Meshes that follow a solution in time
    "Sequence",
    "SequenceStep",
    "Earlier",
    # Records of a running solve
    "Event",
    "Step",
    "Descent",
    "Iteration",
    "SubdomainRecord",
    # Results
    "Solution",
    "Status",
    "Certificate",
    "Relaxed",
    "Candidate",
    "Aim",
    # Meshes for a solution that is not known
    "adapt",
    "Adaptation",
    "AdaptRound",
    "adapt_round",
    "Round",
    # What other solvers return on a mesh
    "CellAverages",
    "ErrorIndicator",
    "Goal",
    "WithAdjoint",
    # Meshes and their quality
    "Mesh",
    "MeshData",
    "Quality",
    "measure",
    # Errors, drawn as a tree in ``equimesh/errors.py``
    "EquimeshError",
    "InputError",
    "ExpressionError",
    "Position",
    "SamplesError",
    "DecompositionError",
    "SolveError",
    "CouplingError",
    "MissingLibrary",
    "OldLibrary",
    "BadValues",
]
