"""Monitors in a spec: the error that a mesh minimises, or the metric that it equidistributes."""

from collections.abc import Iterator, Mapping
from typing import Annotated, Any, ClassVar, Literal, TypeAlias

from pydantic import Field, FiniteFloat, Tag

from equimesh_service.spec.sources import AnySource, Source
from equimesh_service.spec.strict import TAG, Strict, by_kind

MAX_MONITORS = 8
USES = {
    "auto": "You have u: candidates are tried on a coarse grid, and the one of least error is taken. The default.",
    "least_error": "You have u, and want the settings in your hand: the measured interpolation error is minimised.",
    "nodal_solution": "You solve for u: from its values at the nodes of one mesh to the next mesh.",
    "arc_length": "Fronts and layers: small cells where u is steep, after Haynes and Howse.",
    "curvature": "A metric made for a small interpolation error of u (norm l2) or of its gradient (h1).",
    "weight": "You know the sizes of cells: they are as small as rho > 0 is large, and not stretched.",
    "tensor": "You know sizes and directions, for instance from an error estimate: a positive definite metric.",
    "intersection": "Several of the others at once: cells as small as each of them requires.",
}
# The sentences of the solver, which this room does not import.
NO_SMOOTHING = (
    "smoothing averages a metric, and this monitor minimises the interpolation error itself: leave it out, or name a"
    " kind with a metric, such as curvature"
)
OF_ARC_LENGTH = "this belongs to the arc length, which is no longer the kind of a monitor that names none: add kind"
FOREIGN_TO_AUTO = {"smoothing": NO_SMOOTHING, **dict.fromkeys(("a", "b", "scaled"), f"{OF_ARC_LENGTH} arc_length")}

_Smoothing = Annotated[
    FiniteFloat,
    Field(
        description="Radius over which the metric is averaged, in units of the domain's shorter extent, at most 0.25; "
        "0 for none."
    ),
]


_Orthogonality = Annotated[
    FiniteFloat | None,
    Field(
        description="Largest angle of non-orthogonality, between the normal of a face and the line of its two "
        "cell centres, in degrees, over 0 and at most 90. null for no bound."
    ),
]
_Norm = Annotated[
    Literal["l2", "h1"], Field(description="The interpolation error to minimise: that of u, or of its gradient.")
]
_NO_U = {"u": "the norm is that of the error of interpolating u: give u, an expression or samples"}


class AutoSpec(Strict):
    """The monitor with the smallest measured interpolation error among candidates, compared on a coarse grid."""

    REFUSED: ClassVar[Mapping[str, str]] = FOREIGN_TO_AUTO
    MISSING: ClassVar[Mapping[str, str]] = _NO_U
    kind: Literal["auto"] = "auto"
    u: Source
    norm: _Norm = "l2"
    purpose: Literal["finite_volume"] | None = Field(
        None,
        alias="for",
        description="finite_volume chooses by the error of a code with cell-centred unknowns; null by the error of "
        "interpolating u.",
    )
    orthogonality: _Orthogonality = None


class LeastErrorSpec(Strict):
    """The mesh of least interpolation error of u, measured on the cells of the file."""

    REFUSED: ClassVar[Mapping[str, str]] = {"smoothing": NO_SMOOTHING}
    MISSING: ClassVar[Mapping[str, str]] = _NO_U
    kind: Literal["least_error"]
    u: Source
    norm: _Norm = "l2"
    distortion: FiniteFloat = Field(
        0.5, description="Weight of the deformation of cells, positive; less for a smaller error."
    )
    smoothness: FiniteFloat = Field(1.0, description="Weight of uneven neighbours, positive; less for a smaller error.")
    rectilinear: bool = Field(False, description="Keep lines straight: x depends on xi alone, y on eta alone.")
    orthogonality: _Orthogonality = None


class NodalSolutionSpec(Strict):
    """The next mesh of a solver whose solution on a mesh is given: one round of adapting, without the exact u."""

    REFUSED: ClassVar[Mapping[str, str]] = {"smoothing": NO_SMOOTHING}
    MISSING: ClassVar[Mapping[str, str]] = {"u": "a round follows from values at the nodes of a mesh: give u"}
    kind: Literal["nodal_solution"]
    u: Source = Field(description="Values of a solver at the nodes of a mesh: nodal, or samples with x and y of 2-D.")
    norm: _Norm = "l2"
    orthogonality: _Orthogonality = None


class ArcLengthSpec(Strict):
    """The scaled arc length of Haynes and Howse: M = k grad u grad u^T + I."""

    kind: Literal["arc_length"]
    u: Source
    a: FiniteFloat = Field(0.7, description="Strength of the adaptation, in [0, 1]; 0 gives the uniform mesh.")
    b: FiniteFloat = Field(0.05, description="Damping where u is steep, not negative.")
    scaled: bool = Field(
        True,
        description="Take u in units of its range on the domain, and lengths in units of the domain's size (the root "
        "of its area): the mesh does not depend on units. false is the formula of the paper for u as it is given.",
    )
    smoothing: _Smoothing = 0.0
    orthogonality: _Orthogonality = None


class ArcLengthMember(ArcLengthSpec):
    """The arc length as a member of an intersection, where it is the kind that is not named."""

    kind: Literal["arc_length"] = "arc_length"


class CurvatureSpec(Strict):
    """Huang's optimal metric tensors for the interpolation of u, made of its second derivatives."""

    kind: Literal["curvature"]
    u: Source
    norm: Literal["l2", "h1"] = Field("l2", description="The error to minimise: that of u, or of its gradient.")
    isotropic: bool = Field(False, description="Small cells only, without a preferred direction.")
    smoothing: _Smoothing = 0.0
    orthogonality: _Orthogonality = None


class WeightSpec(Strict):
    """The metric rho I."""

    kind: Literal["weight"]
    rho: Source = Field(description="Positive on the whole domain.")
    u: Source | None = Field(None, description="The function whose interpolation is measured.")
    map: Literal["lines", "gradient"] = Field(
        "lines",
        description="lines: equal metric lengths along each mesh line. gradient: equal rho times area of the cells, by "
        "a map that is a gradient; smoother meshes, also where rho is steep, and no subdomains.",
    )
    smoothing: _Smoothing = 0.0
    orthogonality: _Orthogonality = None


class TensorSpec(Strict):
    """The metric m11 dx^2 + 2 m12 dx dy + m22 dy^2."""

    kind: Literal["tensor"]
    m11: Source
    m12: Source
    m22: Source
    u: Source | None = Field(None, description="The function whose interpolation is measured.")
    smoothing: _Smoothing = 0.0
    orthogonality: _Orthogonality = None


PlainMonitor = Annotated[
    Annotated[ArcLengthMember, Tag(TAG + "arc_length")]
    | Annotated[CurvatureSpec, Tag(TAG + "curvature")]
    | Annotated[WeightSpec, Tag(TAG + "weight")]
    | Annotated[TensorSpec, Tag(TAG + "tensor")],
    by_kind("arc_length", "curvature", "weight", "tensor", default="arc_length"),
]


class IntersectionSpec(Strict):
    """Several monitors: each length is at least that of every monitor. Interpolation is measured for the first u."""

    kind: Literal["intersection"]
    monitors: list[PlainMonitor] = Field(
        max_length=MAX_MONITORS, description="2 to 8, none of them an intersection.", json_schema_extra={"minItems": 2}
    )
    smoothing: _Smoothing = 0.0
    orthogonality: _Orthogonality = None


AnyMonitor: TypeAlias = (
    AutoSpec
    | LeastErrorSpec
    | NodalSolutionSpec
    | ArcLengthSpec
    | CurvatureSpec
    | WeightSpec
    | TensorSpec
    | IntersectionSpec
)
Monitor = Annotated[
    Annotated[AutoSpec, Tag(TAG + "auto")]
    | Annotated[LeastErrorSpec, Tag(TAG + "least_error")]
    | Annotated[NodalSolutionSpec, Tag(TAG + "nodal_solution")]
    | Annotated[ArcLengthSpec, Tag(TAG + "arc_length")]
    | Annotated[CurvatureSpec, Tag(TAG + "curvature")]
    | Annotated[WeightSpec, Tag(TAG + "weight")]
    | Annotated[TensorSpec, Tag(TAG + "tensor")]
    | Annotated[IntersectionSpec, Tag(TAG + "intersection")],
    by_kind(*USES, default="auto"),
]

_FUNCTIONS = ("u", "rho", "m11", "m12", "m22")


def sources_of(monitor: AnyMonitor, pointer: str = "/monitor") -> Iterator[tuple[str, AnySource]]:
    """Every function of a monitor, with its JSON pointer."""
    if isinstance(monitor, IntersectionSpec):
        for number, member in enumerate(monitor.monitors):
            yield from sources_of(member, f"{pointer}/monitors/{number}")
        return
    for name in _FUNCTIONS:
        source = getattr(monitor, name, None)
        if source is not None:
            yield f"{pointer}/{name}", source


def with_samples(monitor: Mapping[str, Any], old: str, new: str) -> dict[str, Any]:
    """The JSON of a monitor that names the samples ``new`` wherever ``monitor`` names ``old``."""
    changed: dict[str, Any] = {name: {"samples": new} for name in _FUNCTIONS if monitor.get(name) == {"samples": old}}
    if "monitors" in monitor:
        changed["monitors"] = [with_samples(member, old, new) for member in monitor["monitors"]]
    return {**monitor, **changed}
