"""Domains that are meshes of blocks in a spec: a description, or a mesh that was uploaded."""

from typing import Annotated, Any, Literal, TypeAlias

from pydantic import Field, FiniteFloat, WithJsonSchema

from equimesh_schema.document import Pair
from equimesh_service.spec.strict import Strict

_NAME = {"type": "string"}
_PAIR = {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 2}
_ENDS = {"type": "array", "items": _NAME, "minItems": 2, "maxItems": 2}
_COUNT = {"type": "integer", "minimum": 1}


def _object(properties: dict[str, Any], required: tuple[str, ...] = ()) -> dict[str, Any]:
    return {
        "type": "object",
        "properties": properties,
        "required": list(required),
        "additionalProperties": False,
    }


# The solver checks the entries, since it names edges and places. Here they have a schema alone.
_CURVE = {
    "anyOf": [
        _object({"circle": _object({"center": _PAIR, "radius": {"type": "number"}})}, ("circle",)),
        _object(
            {
                "points": {"type": "array", "items": _PAIR},
                "closed": {"type": "boolean"},
                "corners": {"type": "array", "items": {"type": "integer"}},
            },
            ("points",),
        ),
        _object({"polyline": {"type": "array", "items": _PAIR}, "closed": {"type": "boolean"}}, ("polyline",)),
        _object(
            {
                "naca": {"type": "string", "description": "Four digits."},
                "chord": {"type": "number"},
                "leading_edge": _PAIR,
                "angle": {"type": "number", "description": "In degrees."},
            },
            ("naca",),
        ),
        _object({"x": _NAME, "y": _NAME, "parameters": {"type": "object"}, "closed": {"type": "boolean"}}, ("x", "y")),
    ]
}
_GRADING = {"description": "The last cell over the first one, or a list of [share of length, share of cells, ratio]."}
_EDGE = _object(
    {
        "from": _NAME,
        "to": _NAME,
        "on": {**_NAME, "description": "The name of a curve."},
        "via": {**_PAIR, "description": "A point of an arc."},
        "cells": _COUNT,
        "grading": _GRADING,
    },
    ("from", "to"),
)
_BLOCK = _object(
    {
        "name": _NAME,
        "corners": {"type": "array", "items": _NAME, "minItems": 4, "maxItems": 4},
        "cells": {"type": "array", "items": {"anyOf": [_COUNT, {"type": "null"}]}, "minItems": 2, "maxItems": 2},
        "grading": {"type": "array", "description": "Two, along i and j, or four."},
    },
    ("corners",),
)
_JOIN = _object({"from": _ENDS, "to": _ENDS}, ("from", "to"))

Curve: TypeAlias = Annotated[dict[str, Any], WithJsonSchema(_CURVE)]
Edge: TypeAlias = Annotated[dict[str, Any], WithJsonSchema(_EDGE)]
Block: TypeAlias = Annotated[dict[str, Any], WithJsonSchema(_BLOCK)]
Join: TypeAlias = Annotated[dict[str, Any], WithJsonSchema(_JOIN)]


class BlocksSpec(Strict):
    """Blocks of quadrilaterals between named vertices, on straight lines and curves."""

    kind: Literal["blocks"]
    vertices: dict[str, Pair] = Field(description="The places of the vertices, by their names.")
    curves: dict[str, Curve] = Field(
        default_factory=dict, description="Circles, points, profiles of airfoils and formulas, by their names."
    )
    edges: list[Edge] = Field(
        default_factory=list, description="Edges that are not straight, or have cells of their own."
    )
    blocks: list[Block] = Field(description="Four corners each, counter-clockwise, cells and grading.")
    joins: list[Join] = Field(default_factory=list, description="Edges that are one by a translation: periodic.")
    sides: dict[str, list[list[str]]] = Field(default_factory=dict, description="The edges of each side, by its name.")
    corners: list[str] = Field(default_factory=list, description="Vertices that stay where they are.")
    refine: FiniteFloat = Field(1.0, description="Multiplies the cells of all edges.")


class MeshFileSpec(Strict):
    """A mesh of quadrilaterals that was uploaded, whose blocks are found."""

    kind: Literal["mesh"]
    file: str = Field(
        description='The id from POST /v1/samples?kind=mesh, or "upload": the part `mesh` of this request.',
        max_length=100,
    )
    corners: list[str | int | Pair] = Field(
        default_factory=list, description="Nodes that stay where they are: names, numbers, or places."
    )
    corner_angle: FiniteFloat | None = Field(
        None, description="Degrees by which the boundary turns at a corner, where these are not given."
    )
