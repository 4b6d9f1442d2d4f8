"""The spec of a mesh: its monitor, domain, grid or target, and how it is solved."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, TypeAlias

from equimesh_schema.document import LATER, Document, Either, Limits, Parameters, Words, hinted, is_whole
from equimesh_schema.domains import Domain, Rectangle
from equimesh_schema.monitors import Monitor, Norm
from equimesh_schema.schwarz import Schwarz

MAX_PARTS = 4096
"""The most parts that a spec may ask for; how many a grid can have is checked by the solver."""
WITHOUT_NUL = r"^[^\x00]*$"
"""The pattern of texts that databases store: PostgreSQL refuses U+0000."""
UNIT_SQUARE = Rectangle()
MODES = Words(
    discretization="Meshes to compute on: iterates until the error of the solution on the grid is small compared with "
    "that of the grid itself.",
    tight="Studies that compare meshes digit by digit: solves the equations to rounding.",
)
BOUNDARIES = Words("trace", "equidistributed_1d", "orthogonal")
INITIALS = Words("nested", "uniform")
CELLS = Words("quad", "triangle")
SUFFIXES: Mapping[str, str] = {
    ".vtu": "vtu",
    ".vtk": "vtk",
    ".vts": "vts",
    ".vtm.zip": "vtm",
    ".hdf": "hdf",
    ".xdmf": "xdmf",
    ".xdmf.zip": "xdmf",
    ".msh": "msh",
    ".mesh": "medit",
    ".su2": "su2",
    ".inp": "abaqus",
    ".ism": "hohqmesh",
    ".re2": "re2",
    ".nmsh": "nmsh",
    ".specfem.zip": "specfem",
    ".p3d.zip": "p3d",
    ".foam.zip": "foam",
    ".npz": "npz",
}
"""Formats of mesh files by the suffixes of their names."""
NumberOfParts: TypeAlias = Annotated[
    Annotated[int, Limits(ge=1, le=MAX_PARTS)] | Literal["auto"] | None,
    Either(f"a whole number from 1 to {MAX_PARTS}, 'auto' or null"),
]


@dataclass(frozen=True, kw_only=True)
class Grid(Document):
    """Points of the mesh in each direction; 12 points make 11 cells."""

    n_xi: int = 64
    """Points along xi, at least 4."""
    n_eta: int = 64
    """Points along eta, at least 4."""
    points: Annotated[int | None, LATER] = None
    """Points of the whole mesh, at least 25, in place of n_xi and n_eta, on blocks of the cells of the domain: the
    numbers of points or cells with the least error are found."""


@hinted(points="did you mean 'max_points'?")
@dataclass(frozen=True, kw_only=True)
class Target(Document):
    """An interpolation error of u in place of a grid."""

    norm: Norm = "l2"
    """The norm of the error: l2 of u, or h1, of its gradient; of a round that of its monitor."""
    error: float | None = None
    """The requested error, positive, in the units of u; null: the least one on max_points points."""
    max_points: int | None = None
    """Most points of the grid, at least 25; null: the limit of the service."""


@dataclass(frozen=True, kw_only=True)
class MeshSpec(Document):
    """Everything that defines a mesh; all but `monitor` has a default."""

    monitor: Monitor
    domain: Annotated[Domain, LATER] = UNIT_SQUARE
    grid: Grid | None = Grid()
    """Absent: 64 x 64, or the grid that a target needs. Blocks have points of their own: null, or `points` alone."""
    target: Annotated[Target | None, LATER] = None
    """The error that the grid is to reach, in place of `grid`."""
    boundary: Annotated[str, BOUNDARIES] = "trace"
    """How points move along the sides; equidistributed_1d is the paper's."""
    initial: Annotated[str, INITIALS] = "nested"
    """The initial mesh: from coarser grids, or uniform as in the paper."""
    schwarz: Schwarz | None = None
    """Absent or null: solved as a single domain. With blocks an iteration between these."""
    mode: Annotated[str, MODES, LATER] = "discretization"
    """How exactly the discrete equations are solved: to the error of the grid, or tight, to rounding."""
    allow_relaxed: Annotated[bool, LATER] = True
    """Whether the mesh may be for a weaker monitor where the requested one cannot be solved; its certificate then says
    so."""
    cells: Annotated[str, CELLS] = "quad"
    """Cells of the mesh file."""
    label: Annotated[Annotated[str, Limits(max_length=200, pattern=WITHOUT_NUL)] | None, LATER] = None
    """Free text, for the list of meshes."""
    parts: Annotated[NumberOfParts, LATER] = None
    """How many parts of a cluster the mesh is computed in; auto: as many as fit its workers. null: one machine computes
    it, or where it is too large for that, a cluster in parts."""


MIN_GRID_POINTS = 25
"""The fewest points of a whole grid whose shape is found: 5 in each direction."""


def fault_of_points(document: Mapping[str, Any]) -> tuple[str, str] | None:
    """The field and the sentence of what is wrong with ``grid.points`` of a spec; None where nothing is."""
    grid = document.get("grid")
    points = grid.get("points") if isinstance(grid, Mapping) else None
    if grid is None or points is None:
        return None
    if "n_xi" in grid or "n_eta" in grid:
        return "grid.points", "points takes the place of n_xi and n_eta: give one of them"
    if document.get("target") is not None:
        return "target", "a target takes the place of the grid: give one of them"
    if not is_whole(points):
        return "grid.points", f"give a whole number of points, at least {MIN_GRID_POINTS} on a grid"
    return None


def with_target(document: Mapping[str, Any]) -> Mapping[str, Any]:
    """The spec with a target in place of ``grid.points``, of which :func:`fault_of_points` finds no fault."""
    grid, monitor = document.get("grid"), document.get("monitor")
    if not isinstance(grid, Mapping) or grid.get("points") is None:
        return document
    norm = monitor.get("norm") if isinstance(monitor, Mapping) else None
    target = {"norm": "h1" if norm == "h1" else "l2", "max_points": grid["points"]}
    return {**{name: value for name, value in document.items() if name != "grid"}, "target": target}


@dataclass(frozen=True, kw_only=True)
class ExpressionCheck(Document):
    """An expression to be checked."""

    expression: str
    parameters: Parameters = field(default_factory=dict)
    t: float = 0.0
    domain: Domain = UNIT_SQUARE
    """Where it is evaluated."""
