"""Local equidistribution of 2D meshes by nonlinear Schwarz domain decomposition.

    >>> import equimesh as em
    >>> u = em.Expression("(1 - exp(15*(x - 1))) * sin(pi*y)")
    >>> problem = em.Problem(monitor=em.ArcLength(u=u), grid=em.Grid(n_xi=33, n_eta=33))
    >>> solution = em.solve(problem, em.Schwarz(subdomains=(2, 1)))
    >>> solution.status.sentence
    'The mesh satisfies the equidistribution equations to the asked tolerance.'

The method is that of R. D. Haynes and A. J. M. Howse, *Generating Equidistributed Meshes in 2D via Domain
Decomposition*. Begin reading in ``schwarz_iteration.py``.
"""

from equimesh.approach import Event, Initial
from equimesh.boundary import Boundary
from equimesh.certificate import Certificate, Relaxed
from equimesh.curvature import Curvature
from equimesh.curve import Curve
from equimesh.decomposition import Decomposition
from equimesh.domain import AnnulusSector, Domain, Rectangle
from equimesh.errors import (
    DecompositionError,
    EquimeshError,
    ExpressionError,
    InputError,
    Position,
    SamplesError,
    SolveError,
)
from equimesh.expression import Expression
from equimesh.field import Field
from equimesh.grid import Grid
from equimesh.intersection import Intersection
from equimesh.iteration import Iteration, SubdomainRecord
from equimesh.mesh import Mesh
from equimesh.mesh_data import MeshData
from equimesh.monitor import ArcLength, Monitor
from equimesh.nodal_field import NodalField, transfer
from equimesh.problem import Problem
from equimesh.quadrilateral import Quadrilateral
from equimesh.quality import Quality, measure
from equimesh.samples import GridSamples, ScatteredSamples
from equimesh.schwarz import Acceleration, LocalSolver, Ordering, Schwarz
from equimesh.schwarz_iteration import iterate
from equimesh.single_domain import Mode, Step
from equimesh.smoothed import Smoothed
from equimesh.solution import Solution
from equimesh.solving import solve
from equimesh.status import Status
from equimesh.tensor import Tensor, Weight
from equimesh.transmission import (
    Classical,
    LinearRobin,
    LineData,
    NonlinearRobin,
    Optimized,
    TransmissionCondition,
)

__all__ = [
    "Acceleration",
    "AnnulusSector",
    "ArcLength",
    "Boundary",
    "Certificate",
    "Classical",
    "Curvature",
    "Curve",
    "Decomposition",
    "DecompositionError",
    "Domain",
    "EquimeshError",
    "Event",
    "Expression",
    "ExpressionError",
    "Field",
    "Grid",
    "GridSamples",
    "Initial",
    "InputError",
    "Intersection",
    "Iteration",
    "LineData",
    "LinearRobin",
    "LocalSolver",
    "Mesh",
    "MeshData",
    "Mode",
    "Monitor",
    "NodalField",
    "NonlinearRobin",
    "Optimized",
    "Ordering",
    "Position",
    "Problem",
    "Quadrilateral",
    "Quality",
    "Rectangle",
    "Relaxed",
    "SamplesError",
    "ScatteredSamples",
    "Schwarz",
    "Smoothed",
    "Solution",
    "SolveError",
    "Status",
    "Step",
    "SubdomainRecord",
    "Tensor",
    "TransmissionCondition",
    "Weight",
    "iterate",
    "measure",
    "solve",
    "transfer",
]
