"""A step of a sequence: the next function, values to carry along, and how the mesh moves."""

from collections.abc import Callable
from dataclasses import dataclass, field, fields
from typing import Annotated, Any, Literal, TypeAlias, get_args

from equimesh_schema.document import CoreSchema, Document, Limits, Numbers, OneOf, Pair, before, by_key, described
from equimesh_schema.sources import ExpressionSource, OrText

MAX_FIELDS = 32
"""The most fields of a step."""
MAX_COMPONENTS = 64
"""The most components of all fields together: a scalar has one."""
ANSWER = "step_json"
"""The array of an answer that has the JSON of its step. It may come back with the fields, and is not read."""
Transfer: TypeAlias = Literal["spline", "conservative"]
Location: TypeAlias = Literal["nodes", "cells"]
Outrun: TypeAlias = Literal["substeps", "refuse"]
OUTRUNS: tuple[Outrun, ...] = get_args(Outrun)
TRANSFERS: tuple[Transfer, ...] = get_args(Transfer)
LOCATIONS: tuple[Location, ...] = get_args(Location)
Rows = Annotated[list[Numbers], Limits(fail_fast=True)]
Vectors = Annotated[list[Rows], Limits(fail_fast=True)]


@dataclass(frozen=True, kw_only=True)
class NodesSource(Document):
    """A function by its values at the nodes of the current mesh."""

    nodes: Rows
    """nodes[i][j] is the value at the node (i, j): n_xi rows of n_eta values."""


@dataclass(frozen=True, kw_only=True)
class FieldSource(Document):
    """A function that is one of the fields of the step."""

    field: Annotated[str, Limits(max_length=32)]
    """The name of a field with one number at each node."""


@dataclass(frozen=True, kw_only=True)
class FieldSettings(Document):
    """How a field is carried to the next mesh."""

    transfer: Transfer | None = None
    """spline: smooth, of fourth order. conservative: keeps the integral, and the bounds of the values. Absent or null:
    spline at nodes, conservative in cells."""
    location: Location = "nodes"
    """nodes: n_xi x n_eta values. cells: averages of (n_xi - 1) x (n_eta - 1) cells."""
    bounds: Pair | None = None
    """The least and the largest value that the conservative transfer keeps; absent or null: those that the values
    have."""

    @property
    def used_transfer(self) -> Transfer:
        """The transfer that is used."""
        return self.transfer or ("spline" if self.location == "nodes" else "conservative")


def _kind_of_values(value: Any) -> str:
    """Whether values are numbers or vectors, by the first of them."""
    first = value[0] if isinstance(value, list) and value else None
    return "vectors" if isinstance(first, list) and first and isinstance(first[0], list) else "rows"


def _kind_of_field(value: Any) -> str:
    return "field" if isinstance(value, dict | FieldSpec) else _kind_of_values(value)


@dataclass(frozen=True, kw_only=True)
class FieldSpec(FieldSettings):
    """A field with the way it is carried."""

    values: Annotated[Any, OneOf({"rows": Rows, "vectors": Vectors}, _kind_of_values)]
    """values[i][j] is a number, or the list of the components of a vector."""


class WithoutAnswer:
    """Marks fields of a step: the JSON of an earlier answer, which a client may take for one, is left out."""

    def __get_pydantic_core_schema__(self, source: Any, handler: Callable[[Any], CoreSchema]) -> CoreSchema:
        return before(_without_answer, handler(source))


def _without_answer(fields: Any) -> Any:
    return {name: values for name, values in fields.items() if name != ANSWER} if isinstance(fields, dict) else fields


NewMonitor: TypeAlias = Annotated[
    dict[str, Any] | None,
    described(
        "A monitor, as in a spec, in place of the present one. Its functions may also be "
        '{"nodes": [[…], …]}, or {"field": "name"} for one of `fields`. Functions that are not given are `u`, or stay '
        "those of the step before; all other settings are those given here."
    ),
]


@dataclass(frozen=True, kw_only=True)
class MotionSettings(Document):
    """How the mesh moves, from a step on; what is absent or null stays as it was."""

    smoothing: Annotated[float, Limits(ge=0.0, le=0.9)] | None = None
    """The share of the mesh before in each new mesh, 0 to 0.9: meshes jitter less, and follow later. 0 at first."""
    max_move: Annotated[float, Limits(gt=0.0)] | None = None
    """How far nodes may move in a step, in cells of the mesh before. 1 at first."""
    outrun: Outrun | None = None
    """What happens where nodes would move farther. substeps, at first: other starts and meshes in between are tried
    where the error has risen. refuse: the step fails, and says why."""

    @property
    def given(self) -> dict[str, Any]:
        """The settings that are given, by their names."""
        every = {one.name: getattr(self, one.name) for one in fields(MotionSettings)}
        return {name: value for name, value in every.items() if value is not None}


@dataclass(frozen=True, kw_only=True)
class StepSpec(MotionSettings):
    """The next step of a sequence."""

    step: int
    """The step that this one follows: u and the fields are at the nodes of its mesh."""
    u: (
        Annotated[
            NodesSource | ExpressionSource | FieldSource, by_key(NodesSource, ExpressionSource, FieldSource), OrText()
        ]
        | None
    ) = None
    """The function that the next mesh adapts to; required without `monitor`."""
    monitor: NewMonitor = None
    fields: Annotated[
        dict[str, Annotated[Any, OneOf({"rows": Rows, "vectors": Vectors, "field": FieldSpec}, _kind_of_field)]],
        Limits(max_length=MAX_FIELDS),
        WithoutAnswer(),
    ] = field(default_factory=dict)
    """Further values to carry to the next mesh, by names of letters, digits and underscores: a list of values at the
    nodes, as u.nodes, or an object that says how they are carried."""


@dataclass(frozen=True, kw_only=True)
class StepSettings(MotionSettings):
    """What the text `settings` of a step in npz says; the values are arrays of the file."""

    u: Annotated[ExpressionSource | FieldSource, by_key(ExpressionSource, FieldSource), OrText()] | None = None
    monitor: NewMonitor = None
    fields: Annotated[dict[str, FieldSettings], Limits(max_length=MAX_FIELDS)] = field(default_factory=dict)
