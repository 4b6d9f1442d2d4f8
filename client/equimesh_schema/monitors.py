"""Monitors: the error that a mesh minimises, or the metric that it equidistributes."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, Literal, TypeAlias

from equimesh_schema.document import LATER, Document, Limits, Shown, by_kind, described, required_of
from equimesh_schema.sources import Function, functions_of

__all__ = ["ArcLength", "Auto", "Curvature", "Intersection", "LeastError", "NodalSolution", "Tensor", "Weight"]
MAX_MONITORS = 8
NO_SMOOTHING = (
    "smoothing averages a metric, and this monitor minimises the interpolation error itself: leave it out, or name a"
    " kind with a metric, such as curvature"
)
OF_ARC_LENGTH = (
    "this belongs to the arc length, which is no longer the kind of a monitor that names none: add kind arc_length"
)
NO_DEGREE = (
    "a metric knows no elements: the degree is that of the element whose measured error is made small; leave it out, or"
    " take the kind least_error or auto"
)
NO_ADJOINT = (
    "a metric knows no functional: an adjoint tells whose error the next mesh of a solver makes small; leave it out, or"
    " take the kind nodal_solution"
)
ADJOINT = (
    "The adjoint solution of a functional at the same nodes, of degree 1, in the form of u. The next mesh then makes "
    "the error of the functional small. null for the error of u."
)
NO_EARLIER = (
    "a metric is made of u alone: earlier values tell what equation the solver of a nodal_solution solves; leave them"
    " out"
)
EARLIER = (
    "Values of the same solver on the first of its meshes that resolved u, of degree 1, in the form of u. They tell "
    "whether its errors at the nodes are those for Poisson's equation. null before there are any."
)
NO_U = {"u": "the norm is that of the error of interpolating u: give u, an expression or samples"}
Norm: TypeAlias = Literal["l2", "h1"]
ErrorNorm: TypeAlias = Annotated[
    Norm,
    Shown("Error to make small", words={"l2": "of u (L2)", "h1": "of its gradient (H1)"}),
    described("The interpolation error to minimise: that of u, or of its gradient."),
]
Measured: TypeAlias = Annotated[Function | None, described("The function whose interpolation is measured.")]
Smoothing: TypeAlias = Annotated[
    float,
    LATER,
    Shown(minimum=0.0, maximum=0.25),
    described(
        "Radius over which the metric is averaged, in units of the domain's shorter extent, at most 0.25; 0 for none."
    ),
]
Orthogonality: TypeAlias = Annotated[
    float | None,
    LATER,
    Shown("Largest angle", minimum=0.0, maximum=90.0),
    described(
        "Largest angle of non-orthogonality, between the normal of a face and the line of its two cell centres, in "
        "degrees, over 0 and at most 90. null for no bound."
    ),
]


Degree: TypeAlias = Annotated[
    int,
    LATER,
    Shown("Degree of the elements", minimum=1, maximum=4),
    described(
        "The degree of the elements that interpolate u: 1 (bilinear) to 4, on triangles 1 or 2. A mesh for one degree "
        "can be worse than the uniform one for another."
    ),
]


@dataclass(frozen=True, kw_only=True)
class MonitorDocument(Document):
    """What all monitors have. A ``u`` of None is that of `generate`."""

    USE: ClassVar[str]
    """When to take it, in a sentence."""
    TITLE: ClassVar[str] = ""
    """The name on a page, where that is not the kind."""
    NEEDED: ClassVar[tuple[str, ...]] = ("kind", "u")
    kind: str


@dataclass(frozen=True, kw_only=True)
class Auto(MonitorDocument):
    """The monitor with the smallest measured error among candidates, compared on a coarse grid."""

    USE = "You have u: candidates are tried on a coarse grid, and the best one for a solver is taken. The default."
    TITLE = "Automatic"
    JSON_NAMES: ClassVar = {"purpose": "for"}
    NEEDED = ("u",)
    REFUSED: ClassVar = {
        "smoothing": NO_SMOOTHING,
        **dict.fromkeys(("a", "b", "scaled"), OF_ARC_LENGTH),
    }
    MISSING: ClassVar = NO_U
    kind: Literal["auto"] = "auto"
    u: Function = None
    norm: ErrorNorm = "l2"
    purpose: Annotated[
        Literal["finite_element", "finite_volume", "interpolation"],
        LATER,
        Shown(
            "Chosen for",
            words={
                "finite_element": "finite elements: what a solver gets",
                "finite_volume": "finite volumes: a cell-centred code",
                "interpolation": "interpolation of u",
            },
        ),
    ] = "finite_element"
    """What the mesh is for.

    finite_element chooses by the error of a finite element solver, finite_volume by that of a code with cell-centred
    unknowns, interpolation by that of the interpolant.
    """
    orthogonality: Orthogonality = None
    degree: Degree = 1

    @classmethod
    def completed(cls, given: Mapping[str, Any]) -> Mapping[str, Any]:
        """Null for what the mesh is for is interpolation, as in specs that services have stored."""
        return {**given, "for": "interpolation"} if "for" in given and given["for"] is None else given


@dataclass(frozen=True, kw_only=True)
class LeastError(MonitorDocument):
    """The mesh of least interpolation error of u, measured on the cells of the file."""

    USE = "You have u, and want the settings in your hand: the measured interpolation error is minimised."
    JSON_NAMES: ClassVar = {"purpose": "for"}
    REFUSED: ClassVar = {"smoothing": NO_SMOOTHING}
    MISSING: ClassVar = NO_U
    kind: Literal["least_error"] = "least_error"
    u: Function = None
    norm: ErrorNorm = "l2"
    distortion: Annotated[float, Shown(minimum=0.0)] = 0.5
    """Weight of the deformation of cells, positive; less for a smaller error."""
    smoothness: Annotated[float, Shown(minimum=0.0)] = 1.0
    """Weight of uneven neighbours, positive; less for a smaller error."""
    rectilinear: Annotated[bool, LATER] = False
    """Keep lines straight: x depends on xi alone, y on eta alone."""
    orthogonality: Orthogonality = None
    degree: Degree = 1
    purpose: Annotated[
        Literal["finite_element", "interpolation"],
        LATER,
        Shown(
            "Error of",
            words={"finite_element": "finite elements: what a solver gets", "interpolation": "interpolation of u"},
        ),
    ] = "interpolation"
    """Whose error is made small: that of a finite element solver, or that of the interpolant."""
    obliqueness: Annotated[float, LATER, Shown(minimum=0.0)] = 0.0
    """Weight of oblique corners, not negative; 30 for few angles over 60 degrees."""


@dataclass(frozen=True, kw_only=True)
class NodalSolution(MonitorDocument):
    """The next mesh of a solver whose solution on a mesh is given: one round of adapting, without the exact u."""

    USE = "You solve for u: from its values at the nodes of one mesh to the next mesh."
    TITLE = "Values at nodes"
    REFUSED: ClassVar = {"smoothing": NO_SMOOTHING}
    MISSING: ClassVar = {"u": "a round follows from values at the nodes of a mesh: give u"}
    kind: Literal["nodal_solution"] = "nodal_solution"
    u: Function = None
    """Values of a solver at the nodes of a mesh: nodal, or samples with x and y of 2-D."""
    norm: ErrorNorm = "l2"
    orthogonality: Orthogonality = None
    degree: Annotated[int, LATER, Shown("Degree of the elements", minimum=1, maximum=4)] = 1
    """The degree p of the solver's elements: 1, or 2 to 4 with values at the Gauss-Lobatto points of
    edges and cells, too, whose x and y are given with them; every p-th one along xi and along eta is a node of the
    mesh. With triangles for cells it is 1 or 2, and the middles of the diagonals along which cells are cut take the
    place of the centres."""
    adjoint: Annotated[Function | None, LATER, described(ADJOINT)] = None
    earlier: Annotated[Function | None, LATER, described(EARLIER)] = None


@dataclass(frozen=True, kw_only=True)
class MetricDocument(MonitorDocument):
    """What all monitors have whose metric is equidistributed."""

    REFUSED: ClassVar = {"degree": NO_DEGREE, "adjoint": NO_ADJOINT, "earlier": NO_EARLIER}


@dataclass(frozen=True, kw_only=True)
class ArcLength(MetricDocument):
    """The scaled arc length of Haynes and Howse: M = k grad u grad u^T + I."""

    USE = "Fronts and layers: small cells where u is steep, after Haynes and Howse."
    kind: Literal["arc_length"] = "arc_length"
    u: Function = None
    a: Annotated[float, Shown("Strength a", minimum=0.0, maximum=1.0)] = 0.7
    """Strength of the adaptation, in [0, 1]; 0 gives the uniform mesh."""
    b: Annotated[float, Shown("Damping b", minimum=0.0)] = 0.05
    """Damping where u is steep, not negative."""
    scaled: Annotated[bool, LATER] = True
    """Take u in units of its range on the domain, and lengths in units of the domain's size (the root of its area).

    The mesh does not depend on units. false is the formula of the paper for u as it is given.
    """
    smoothing: Smoothing = 0.0
    orthogonality: Orthogonality = None


@dataclass(frozen=True, kw_only=True)
class ArcLengthMember(ArcLength):
    """The arc length as a member of an intersection, where it is the kind that is not named."""

    NEEDED = ("u",)


@dataclass(frozen=True, kw_only=True)
class Curvature(MetricDocument):
    """Huang's optimal metric tensors for the interpolation of u, made of its second derivatives."""

    USE = "A metric made for a small interpolation error of u (norm l2) or of its gradient (h1)."
    kind: Literal["curvature"] = "curvature"
    u: Function = None
    norm: ErrorNorm = "l2"
    isotropic: bool = False
    """Small cells only, without a preferred direction."""
    smoothing: Smoothing = 0.0
    orthogonality: Orthogonality = None


@dataclass(frozen=True, kw_only=True)
class Weight(MetricDocument):
    """The metric rho I."""

    USE = "You know the sizes of cells: they are as small as rho > 0 is large, and not stretched."
    NEEDED = ("kind",)
    kind: Literal["weight"] = "weight"
    rho: Function = field(kw_only=False)
    """Positive on the whole domain."""
    u: Measured = None
    map: Annotated[
        Literal["lines", "gradient"],
        Shown(words={"lines": "equal lengths along mesh lines", "gradient": "equal shares of area, by a gradient"}),
    ] = "lines"
    """lines: equal metric lengths along each mesh line. gradient: equal rho times area of the cells, by a map that is
    a gradient; smoother meshes, also where rho is steep, and no subdomains."""
    smoothing: Smoothing = 0.0
    orthogonality: Orthogonality = None


@dataclass(frozen=True, kw_only=True)
class Tensor(MetricDocument):
    """The metric m11 dx^2 + 2 m12 dx dy + m22 dy^2."""

    USE = "You know sizes and directions, for instance from an error estimate: a positive definite metric."
    NEEDED = ("kind",)
    kind: Literal["tensor"] = "tensor"
    m11: Function = field(kw_only=False)
    """The entry of dx^2."""
    m12: Function = field(kw_only=False)
    """The entry of dx dy."""
    m22: Function = field(kw_only=False)
    """The entry of dy^2."""
    u: Measured = None
    smoothing: Smoothing = 0.0
    orthogonality: Orthogonality = None


PlainMonitor: TypeAlias = ArcLength | Curvature | Weight | Tensor
MEMBERS = by_kind(ArcLengthMember, Curvature, Weight, Tensor, default="arc_length")
Member: TypeAlias = Annotated[PlainMonitor | Mapping[str, Any], MEMBERS]


@dataclass(frozen=True, kw_only=True)
class Intersection(MetricDocument):
    """Several monitors: each length is at least that of every monitor. Interpolation is measured for the first u."""

    USE = "Several of the others at once: cells as small as each of them requires."
    TITLE = "Intersection of several"
    NEEDED = ("kind",)
    kind: Literal["intersection"] = "intersection"
    monitors: Annotated[list[Member], Limits(max_length=MAX_MONITORS, json={"minItems": 2})] = field(kw_only=False)
    """2 to 8, none of them an intersection."""
    smoothing: Smoothing = 0.0
    orthogonality: Orthogonality = None


AnyMonitor: TypeAlias = Auto | LeastError | NodalSolution | PlainMonitor | Intersection
MONITORS = by_kind(
    *(Auto, LeastError, NodalSolution, ArcLength, Curvature, Weight, Tensor, Intersection), default="auto"
)
Monitor: TypeAlias = Annotated[AnyMonitor, MONITORS]
FUNCTIONS = tuple({name: None for kind in MONITORS.documents.values() for name in functions_of(kind)})
"""The names of the functions of all monitors."""
REQUIRED_FUNCTIONS = {
    name: tuple(function for function in functions_of(kind) if function in required_of(kind))
    for name, kind in MONITORS.documents.items()
}
"""The functions that a kind cannot do without."""
