"""Functions of x and y: expressions and samples."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, TypeAlias

from equimesh_schema.document import (
    LATER,
    CoreSchema,
    Document,
    InJson,
    Limits,
    Numbers,
    Pair,
    Parameters,
    before,
    by_key,
    keys_of,
    one_of,
    types_of,
)

UPLOAD = "upload"
"""The name of samples that come with the request."""


@dataclass(frozen=True, kw_only=True)
class ExpressionSource(Document):
    """A function as an expression in x and y."""

    expression: Annotated[str, Limits(json={"examples": ["(1-exp(15*(x-1)))*sin(pi*y)"]})]
    """u(x, y); names, functions and limits are listed in /v1/capabilities."""
    parameters: Parameters = field(default_factory=dict)
    """Values of further names used in the expression."""
    t: float = 0.0
    """Value of the name t."""


Table: TypeAlias = Annotated[list[Numbers], Limits(fail_fast=True)]


class SamplesSource(Document):
    """A function as samples: its only key has them."""

    COUNTED: ClassVar[str] = "values"
    """The key of the samples whose rows are counted; of values all numbers are."""

    @property
    def key(self) -> str:
        """The only key."""
        return keys_of(type(self))[0]

    @property
    def samples(self) -> Any:
        """The samples."""
        return getattr(self, self.key)

    @property
    def count(self) -> int:
        """How many samples there are."""
        rows = getattr(self.samples, self.COUNTED)
        return sum(map(len, rows)) if self.COUNTED == "values" else len(rows)


@dataclass(frozen=True, kw_only=True)
class GridValues(Document):
    """Samples on a rectilinear grid that covers the box of the domain."""

    x: Numbers
    """Increasing, from one side of the domain's box to the other."""
    y: Numbers
    """Increasing, from one side of the domain's box to the other."""
    values: Table
    """values[i][j] is u at (x[i], y[j])."""


@dataclass(frozen=True, kw_only=True)
class GridSource(SamplesSource):
    """A function as samples on a grid."""

    grid: GridValues


@dataclass(frozen=True, kw_only=True)
class NodalValues(Document):
    """u at the nodes of a mesh of the domain; the first index runs along xi."""

    x: Table
    """x[i][j] of the node (i, j)."""
    y: Table
    """y[i][j] of the node (i, j)."""
    values: Table
    """values[i][j] is u at the node (i, j)."""


@dataclass(frozen=True, kw_only=True)
class NodalSource(SamplesSource):
    """A function as values at the nodes of a mesh."""

    nodal: NodalValues


@dataclass(frozen=True, kw_only=True)
class ScatteredValues(Document):
    """Samples at points in any order whose hull covers the box of the domain."""

    points: Annotated[list[Pair], Limits(fail_fast=True)]
    """[[x, y], …]"""
    values: Numbers
    """u at each point."""


@dataclass(frozen=True, kw_only=True)
class ScatteredSource(SamplesSource):
    """A function as samples at scattered points."""

    COUNTED = "points"
    scattered: ScatteredValues


Counts: TypeAlias = Annotated[Sequence[int], InJson(list[int]), Limits(min_length=2, max_length=2)]
"""Two whole numbers."""


@dataclass(frozen=True, kw_only=True)
class BlockNodes(Document):
    """u at the nodes of a mesh of the domain, which has blocks; in the order of the nodes of its meshes."""

    nodes: Annotated[list[Pair], Limits(fail_fast=True)]
    """[[x, y], …] of every node."""
    values: Numbers
    """u at each node."""
    block_cells: Annotated[list[Counts] | None, LATER] = None
    """Cells along i and j of each block, where that mesh has others than the domain; the next mesh of a solver keeps
    them."""


@dataclass(frozen=True, kw_only=True)
class BlockNodesSource(SamplesSource):
    """A function as values at the nodes of a mesh of blocks."""

    COUNTED = "nodes"
    block_nodes: BlockNodes


@dataclass(frozen=True, kw_only=True)
class StoredSource(Document):
    """A function as samples that were uploaded."""

    samples: Annotated[str, Limits(max_length=100)]
    """The id from POST /v1/samples, or 'upload' for the part `samples` of this request."""


AnySource: TypeAlias = ExpressionSource | GridSource | NodalSource | ScatteredSource | BlockNodesSource | StoredSource
SOURCES = by_key(ExpressionSource, GridSource, NodalSource, ScatteredSource, BlockNodesSource, StoredSource)


class OrText:
    """Marks a function that may also be sent as a bare text, which is then its expression."""

    def __get_pydantic_core_schema__(self, source: Any, handler: Callable[[Any], CoreSchema]) -> CoreSchema:
        return before(_as_object, handler(source))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: Callable[[Any], CoreSchema]) -> CoreSchema:
        text = {"type": "string", "description": "An expression in x and y."}
        objects = handler(schema)
        return {"oneOf": [*objects.get("oneOf", [objects]), text]}


def _as_object(value: Any) -> Any:
    return {"expression": value} if isinstance(value, str) else value


Function: TypeAlias = Annotated[Any, SOURCES, OrText()]
"""One of the sources, or a text; in Python whatever the client or the solver can take as a function."""


def functions_of(document: type[Any]) -> tuple[str, ...]:
    """The names of the fields that hold functions."""
    return tuple(name for name, kind in types_of(document).items() if one_of(kind) is SOURCES)
