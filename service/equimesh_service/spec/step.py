"""A step of a sequence in a request."""

from typing import Annotated, Any, Literal, get_args

from pydantic import BeforeValidator, Discriminator, Field, FiniteFloat, Tag

from equimesh_schema.document import TAG, Limits, Numbers, Pair
from equimesh_schema.sources import ExpressionSource, OrText
from equimesh_service.spec.strict import Strict, by_key

# The most fields of a step.
MAX_FIELDS = 32
# The most components of all fields together: a scalar has one.
MAX_COMPONENTS = 64
# The array of an answer that has the JSON of its step. It may come back with the fields, and is not read.
ANSWER = "step_json"
Transfer = Literal["spline", "conservative"]
Location = Literal["nodes", "cells"]
Outrun = Literal["substeps", "refuse"]
OUTRUNS: tuple[Outrun, ...] = get_args(Outrun)
TRANSFERS: tuple[Transfer, ...] = get_args(Transfer)
LOCATIONS: tuple[Location, ...] = get_args(Location)
_Rows = Annotated[list[Numbers], Limits(fail_fast=True)]
_Vectors = Annotated[list[_Rows], Limits(fail_fast=True)]


def _kind_of_values(value: Any) -> str:
    """Whether values are numbers or vectors, by the first of them."""
    first = value[0] if isinstance(value, list) and value else None
    is_vector = isinstance(first, list) and bool(first) and isinstance(first[0], list)
    return TAG + ("vectors" if is_vector else "rows")


def _kind_of_field(value: Any) -> str:
    return TAG + "field" if isinstance(value, dict | FieldSpec) else _kind_of_values(value)


class NodesSource(Strict):
    """A function by its values at the nodes of the current mesh."""

    nodes: _Rows = Field(description="nodes[i][j] is the value at the node (i, j): n_xi rows of n_eta values.")


class FieldSource(Strict):
    """A function that is one of the fields of the step."""

    field: str = Field(description="The name of a field with one number at each node.", max_length=32)


class FieldSettings(Strict):
    """How a field is carried to the next mesh."""

    transfer: Transfer | None = Field(
        default=None,
        description="spline: smooth, of fourth order. conservative: keeps the integral, and the bounds of the values. "
        "Absent or null: spline at nodes, conservative in cells.",
    )
    location: Location = Field(
        default="nodes", description="nodes: n_xi x n_eta values. cells: averages of (n_xi - 1) x (n_eta - 1) cells."
    )
    bounds: Pair | None = Field(
        default=None,
        description="The least and the largest value that the conservative transfer keeps; absent or null: those that "
        "the values have.",
    )

    @property
    def used_transfer(self) -> Transfer:
        """The transfer that is used."""
        return self.transfer or ("spline" if self.location == "nodes" else "conservative")


class FieldSpec(FieldSettings):
    """A field with the way it is carried."""

    values: Annotated[
        Annotated[_Rows, Tag(TAG + "rows")] | Annotated[_Vectors, Tag(TAG + "vectors")],
        Discriminator(_kind_of_values),
    ] = Field(description="values[i][j] is a number, or the list of the components of a vector.")


_FieldValues = Annotated[
    Annotated[_Rows, Tag(TAG + "rows")]
    | Annotated[_Vectors, Tag(TAG + "vectors")]
    | Annotated[FieldSpec, Tag(TAG + "field")],
    Discriminator(_kind_of_field),
]


def _without_answer(fields: Any) -> Any:
    """The fields without the JSON of an earlier answer, which a client may take for one."""
    return {name: values for name, values in fields.items() if name != ANSWER} if isinstance(fields, dict) else fields


_Monitor = Annotated[
    dict[str, Any] | None,
    Field(
        description="A monitor, as in a spec, in place of the present one. Its functions may also be "
        '{"nodes": [[…], …]}, or {"field": "name"} for one of `fields`. Functions that are not given are `u`, or stay '
        "those of the step before; all other settings are those given here."
    ),
]


class MotionSettings(Strict):
    """How the mesh moves, from a step on; what is absent or null stays as it was."""

    smoothing: Annotated[FiniteFloat, Field(ge=0.0, le=0.9)] | None = Field(
        default=None,
        description="The share of the mesh before in each new mesh, 0 to 0.9: meshes jitter less, and follow later. 0 "
        "at first.",
    )
    max_move: Annotated[FiniteFloat, Field(gt=0.0)] | None = Field(
        default=None, description="How far nodes may move in a step, in cells of the mesh before. 1 at first."
    )
    outrun: Outrun | None = Field(
        default=None,
        description="What happens where nodes would move farther. substeps, at first: other starts and meshes in "
        "between are tried where the error has risen. refuse: the step fails, and says why.",
    )

    @property
    def given(self) -> dict[str, Any]:
        """The settings that are given, by their names."""
        every = {name: getattr(self, name) for name in MotionSettings.model_fields}
        return {name: value for name, value in every.items() if value is not None}


class StepSpec(MotionSettings):
    """The next step of a sequence."""

    step: int = Field(description="The step that this one follows: u and the fields are at the nodes of its mesh.")
    u: (
        Annotated[
            Annotated[NodesSource, Tag(TAG + "nodes")]
            | Annotated[ExpressionSource, Tag(TAG + "expression")]
            | Annotated[FieldSource, Tag(TAG + "field")],
            by_key("nodes", "expression", "field"),
            OrText(),
        ]
        | None
    ) = Field(None, description="The function that the next mesh adapts to; required without `monitor`.")
    monitor: _Monitor = None
    fields: Annotated[dict[str, _FieldValues], BeforeValidator(_without_answer)] = Field(
        default_factory=dict,
        max_length=MAX_FIELDS,
        description="Further values to carry to the next mesh, by names of letters, digits and underscores: a list of "
        "values at the nodes, as u.nodes, or an object that says how they are carried.",
    )


class StepSettings(MotionSettings):
    """What the text `settings` of a step in npz says; the values are arrays of the file."""

    u: (
        Annotated[
            Annotated[ExpressionSource, Tag(TAG + "expression")] | Annotated[FieldSource, Tag(TAG + "field")],
            by_key("expression", "field"),
            OrText(),
        ]
        | None
    ) = None
    monitor: _Monitor = None
    fields: dict[str, FieldSettings] = Field(default_factory=dict, max_length=MAX_FIELDS)
