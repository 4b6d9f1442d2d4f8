"""Functions of x and y in a spec: expressions and samples."""

from typing import Annotated, Any, TypeAlias

from pydantic import FailFast, Field, FiniteFloat, GetCoreSchemaHandler, GetJsonSchemaHandler, Tag
from pydantic_core import CoreSchema, core_schema

from equimesh_service.spec.strict import TAG, Numbers, Pair, Parameters, Strict, by_key

UPLOAD = "upload"


class ExpressionSource(Strict):
    """A function as an expression in x and y."""

    expression: str = Field(
        description="u(x, y); names, functions and limits are listed in /v1/capabilities.",
        examples=["(1-exp(15*(x-1)))*sin(pi*y)"],
    )
    parameters: Parameters = Field(default_factory=dict, description="Values of further names used in the expression.")
    t: FiniteFloat = Field(0.0, description="Value of the name t.")


class GridValues(Strict):
    """Samples on a rectilinear grid that covers the box of the domain."""

    x: Numbers = Field(description="Increasing, from one side of the domain's box to the other.")
    y: Numbers = Field(description="Increasing, from one side of the domain's box to the other.")
    values: Annotated[list[Numbers], FailFast()] = Field(description="values[i][j] is u at (x[i], y[j]).")


class GridSource(Strict):
    """A function as samples on a grid."""

    grid: GridValues


class NodalValues(Strict):
    """u at the nodes of a mesh of the domain; the first index runs along xi."""

    x: Annotated[list[Numbers], FailFast()] = Field(description="x[i][j] of the node (i, j).")
    y: Annotated[list[Numbers], FailFast()] = Field(description="y[i][j] of the node (i, j).")
    values: Annotated[list[Numbers], FailFast()] = Field(description="values[i][j] is u at the node (i, j).")


class NodalSource(Strict):
    """A function as values at the nodes of a mesh."""

    nodal: NodalValues


class ScatteredValues(Strict):
    """Samples at points in any order whose hull covers the box of the domain."""

    points: Annotated[list[Pair], FailFast()] = Field(description="[[x, y], …]")
    values: Numbers = Field(description="u at each point.")


class ScatteredSource(Strict):
    """A function as samples at scattered points."""

    scattered: ScatteredValues


class BlockNodes(Strict):
    """u at the nodes of a mesh of the domain, which has blocks; in the order of the nodes of its meshes."""

    nodes: Annotated[list[Pair], FailFast()] = Field(description="[[x, y], …] of every node.")
    values: Numbers = Field(description="u at each node.")


class BlockNodesSource(Strict):
    """A function as values at the nodes of a mesh of blocks."""

    block_nodes: BlockNodes


class StoredSource(Strict):
    """A function as samples that were uploaded."""

    samples: str = Field(
        description="The id from POST /v1/samples, or 'upload' for the part `samples` of this request.",
        max_length=100,
    )


AnySource: TypeAlias = ExpressionSource | GridSource | NodalSource | ScatteredSource | BlockNodesSource | StoredSource


class OrText:
    """Marks a function that may also be sent as a bare text, which is then its expression."""

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """The schema of the function, with texts replaced before it applies."""
        return core_schema.no_info_before_validator_function(_as_object, handler(source))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """The JSON schema, to which the text is added."""
        text = {"type": "string", "description": "An expression in x and y."}
        objects = handler(schema)
        return {"oneOf": [*objects.get("oneOf", [objects]), text]}


def _as_object(value: Any) -> Any:
    return {"expression": value} if isinstance(value, str) else value


Source = Annotated[
    Annotated[ExpressionSource, Tag(TAG + "expression")]
    | Annotated[GridSource, Tag(TAG + "grid")]
    | Annotated[NodalSource, Tag(TAG + "nodal")]
    | Annotated[ScatteredSource, Tag(TAG + "scattered")]
    | Annotated[BlockNodesSource, Tag(TAG + "block_nodes")]
    | Annotated[StoredSource, Tag(TAG + "samples")],
    by_key("expression", "grid", "nodal", "scattered", "block_nodes", "samples"),
    OrText(),
]
