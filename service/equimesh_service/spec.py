"""The spec of a mesh: strict models of the JSON that a client posts, with every default in one place."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Discriminator, FailFast, Field, FiniteFloat, Tag, ValidationError

from equimesh_service.document import escaped
from equimesh_service.problems import Complaint, refused

# Tags of unions start with this character, so that they can be taken out of a pointer again.
_TAG = "\x00"
_MOST_COMPLAINTS = 20
_Model = TypeVar("_Model", bound=BaseModel)


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class ExpressionSource(_Strict):
    """u as an expression in x and y."""

    expression: str = Field(
        description="u(x, y); names, functions and limits are listed in /v1/capabilities.",
        examples=["(1-exp(15*(x-1)))*sin(pi*y)"],
    )
    parameters: dict[str, FiniteFloat] = Field(
        default_factory=dict, max_length=64, description="Values of further names used in the expression."
    )
    t: FiniteFloat = Field(0.0, description="Value of the name t.")


_Numbers = Annotated[list[FiniteFloat], FailFast()]
_Pair = Annotated[list[FiniteFloat], Field(min_length=2, max_length=2)]


class GridValues(_Strict):
    """Samples on a rectilinear grid that covers the unit square."""

    x: _Numbers = Field(description="Increasing, from 0 to 1.")
    y: _Numbers = Field(description="Increasing, from 0 to 1.")
    values: Annotated[list[_Numbers], FailFast()] = Field(description="values[i][j] is u at (x[i], y[j]).")


class GridSource(_Strict):
    """u as samples on a grid."""

    grid: GridValues


class ScatteredValues(_Strict):
    """Samples at points in any order whose hull covers the unit square."""

    points: Annotated[list[_Pair], FailFast()] = Field(description="[[x, y], …]")
    values: _Numbers = Field(description="u at each point.")


class ScatteredSource(_Strict):
    """u as samples at scattered points."""

    scattered: ScatteredValues


class StoredSource(_Strict):
    """u as samples that were uploaded."""

    samples: str = Field(
        description="The id that POST /v1/samples gave, or 'upload' for the part `samples` of this request.",
        max_length=100,
    )


_SOURCES = {"expression": "expression", "grid": "grid", "scattered": "scattered", "samples": "samples"}


def _source(value: Any) -> str | None:
    if isinstance(value, Mapping):
        return next((_TAG + key for key in _SOURCES if key in value), None)
    return next((_TAG + key for key in _SOURCES if hasattr(value, key)), None)


Source = Annotated[
    Annotated[ExpressionSource, Tag(_TAG + "expression")]
    | Annotated[GridSource, Tag(_TAG + "grid")]
    | Annotated[ScatteredSource, Tag(_TAG + "scattered")]
    | Annotated[StoredSource, Tag(_TAG + "samples")],
    Discriminator(
        _source,
        custom_error_type="source",
        custom_error_message="u is an object with one of the keys expression, grid, scattered, samples",
    ),
]


class MonitorSpec(_Strict):
    """The monitor function: what the mesh is to equidistribute."""

    kind: Literal["arc_length"] = Field(
        "arc_length", description="The scaled arc length of Haynes and Howse: M = k grad u grad u^T + I."
    )
    u: Source
    a: FiniteFloat = Field(0.7, description="Strength of the adaptation, in [0, 1]; 0 gives the uniform mesh.")
    b: FiniteFloat = Field(0.05, description="Damping where u is steep, not negative.")


class DomainSpec(_Strict):
    """The physical domain: the unit square."""

    kind: Literal["rectangle"] = "rectangle"
    x: _Pair = Field(default_factory=lambda: [0.0, 1.0], description="[0, 1]")
    y: _Pair = Field(default_factory=lambda: [0.0, 1.0], description="[0, 1]")


class GridSpec(_Strict):
    """Points of the mesh in each direction; 12 points make 11 cells."""

    n_xi: int = Field(default=64, description="Points along xi, at least 4.")
    n_eta: int = Field(default=64, description="Points along eta, at least 4.")


class ClassicalSpec(_Strict):
    """Dirichlet data on the interfaces."""

    kind: Literal["classical"]


class LinearRobinSpec(_Strict):
    """The linear Robin condition of the paper."""

    kind: Literal["linear_robin"]
    p: Literal["auto"] | FiniteFloat = Field(default="auto", description="A positive number, or 'auto'.")


class NonlinearRobinSpec(_Strict):
    """The nonlinear Robin condition of the paper."""

    kind: Literal["nonlinear_robin"]
    p: Literal["auto"] | FiniteFloat = Field(default="auto", description="A positive number, or 'auto'.")


_TRANSMISSIONS = ("classical", "linear_robin", "nonlinear_robin")


def _transmission(value: Any) -> str | None:
    kind = value.get("kind") if isinstance(value, Mapping) else getattr(value, "kind", None)
    return _TAG + kind if isinstance(kind, str) and kind in _TRANSMISSIONS else None


Transmission = Annotated[
    Annotated[ClassicalSpec, Tag(_TAG + "classical")]
    | Annotated[LinearRobinSpec, Tag(_TAG + "linear_robin")]
    | Annotated[NonlinearRobinSpec, Tag(_TAG + "nonlinear_robin")],
    Discriminator(
        _transmission,
        custom_error_type="transmission",
        custom_error_message="an object whose kind is one of classical, linear_robin, nonlinear_robin",
    ),
]


class SchwarzSpec(_Strict):
    """Domain decomposition and the Schwarz iteration."""

    subdomains: Annotated[list[int], Field(min_length=2, max_length=2)] = Field(
        default_factory=lambda: [2, 1], description="Subdomains along xi and along eta."
    )
    overlap: int = Field(4, description="Points that neighbours share, at least 2.")
    transmission: Transmission = Field(default_factory=lambda: LinearRobinSpec(kind="linear_robin"))
    ordering: Literal["parallel", "alternating"] = "alternating"
    tolerance: FiniteFloat | None = Field(
        1e-10,
        description="The iteration ends when its estimated error in the coordinates is at most this; null runs "
        "exactly max_iterations.",
    )
    max_iterations: int = 100
    compare_single_domain: bool = Field(
        False, description="Also solve the single domain, and report the error against it."
    )


class MeshSpec(_Strict):
    """Everything that defines a mesh; all but `monitor` has a default."""

    monitor: MonitorSpec
    domain: DomainSpec = Field(default_factory=DomainSpec)
    grid: GridSpec = Field(default_factory=GridSpec)
    boundary: Literal["trace", "equidistributed_1d", "orthogonal"] = Field(
        "trace", description="How points move along the sides; equidistributed_1d is the paper's."
    )
    initial: Literal["nested", "uniform"] = Field(
        "nested", description="The initial mesh: from coarser grids, or uniform as in the paper."
    )
    schwarz: SchwarzSpec | None = Field(None, description="Absent or null: solved as a single domain.")
    cells: Literal["quad", "triangle"] = Field("quad", description="Cells of the mesh file.")
    label: str | None = Field(None, max_length=200, description="Free text, for the list of meshes.")

    def canonical(self) -> dict[str, Any]:
        """The same spec as plain JSON with every default filled in; posting it gives the same mesh."""
        return self.model_dump(mode="json")


class ExpressionCheck(_Strict):
    """An expression to be checked."""

    expression: str
    parameters: dict[str, FiniteFloat] = Field(default_factory=dict, max_length=64)
    t: FiniteFloat = 0.0


def read_spec(document: Any) -> MeshSpec:
    """The spec in a parsed JSON document; raises a 422 problem that lists what is wrong, with pointers."""
    return _validated(MeshSpec, document)


def read_expression_check(document: Any) -> ExpressionCheck:
    """The body of an expression check; raises as :func:`read_spec`."""
    return _validated(ExpressionCheck, document)


def _validated(model: type[_Model], document: Any) -> _Model:
    if not isinstance(document, Mapping):
        raise refused([Complaint(pointer="", message="the body must be one JSON object")])
    try:
        return model.model_validate(document)
    except ValidationError as error:
        entries = error.errors(include_url=False, include_input=False, include_context=True)
        raise refused([_complaint(model, entry) for entry in entries[:_MOST_COMPLAINTS]]) from None


def _complaint(model: type[BaseModel], entry: Any) -> Complaint:
    place = [part for part in entry["loc"] if not (isinstance(part, str) and part.startswith(_TAG))]
    if place and place[-1] in ("literal['auto']", "finite-float", "constrained-float", "float"):
        place.pop()  # a branch of a plain union, not a key
    return Complaint(pointer="".join(map(escaped, place)), message=_sentence(model, entry, place))


def _sentence(model: type[BaseModel], entry: Any, place: Iterable[object]) -> str:
    match entry["type"]:
        case "missing":
            return "this key is required"
        case "extra_forbidden":
            return f"there is no such key here{_known_keys(model, list(place)[:-1])}"
        case "finite_number":
            return "this must be a finite number, not NaN or infinity"
        case "model_type" | "model_attributes_type" | "dict_type":
            return "this must be a JSON object"
        case "too_short" | "too_long" if entry["ctx"]["field_type"] == "List":
            return f"this must be a list of {entry['ctx'].get('min_length', entry['ctx'].get('max_length'))} items"
        case "literal_error":
            return f"this must be {entry['ctx']['expected']}"
        case _:
            message = str(entry["msg"]).removeprefix("Input ")
            return f"this {message}" if message.startswith("should") else message


def _known_keys(model: type[BaseModel], place: list[object]) -> str:
    if not place:
        return "; known are " + ", ".join(model.model_fields)
    found: Any = model
    for key in place:
        field = found.model_fields.get(key)
        candidates = [field.annotation] if field is not None else []
        found = next((c for c in candidates if isinstance(c, type) and issubclass(c, BaseModel)), None)
        if found is None:
            return ""
    return "; known are " + ", ".join(found.model_fields)
