"""Physical domains: images of the unit square, blocks of quadrilaterals, and meshes of files."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, TypeAlias

from equimesh_schema.document import LATER, Document, InJson, Limits, Pair, Parameters, by_key, by_kind

QUARTER_TURN = (0.0, 90.0)
"""The angles of a sector that gives none."""
ONE_TURN = (0.0, 360.0)
"""The angles of a closed ring that gives none."""


@dataclass(frozen=True, kw_only=True)
class DomainDocument(Document):
    """What all domains have."""

    USE: ClassVar[str]
    """When to take it, in a sentence."""
    HAS_BLOCKS: ClassVar[bool] = False
    """Whether its mesh is one of blocks, which have their own points, in place of a grid."""
    NEEDED: ClassVar[tuple[str, ...]] = ("kind",)
    kind: str


@dataclass(frozen=True, kw_only=True)
class Rectangle(DomainDocument):
    """The rectangle between two values of x and two of y; left and right are the sides of constant x."""

    USE = "A box; the unit square unless x and y are given."
    NEEDED = ()
    REFUSED: ClassVar = dict.fromkeys(("vertices", "blocks"), 'a rectangle has none: add "kind": "blocks"')
    kind: Literal["rectangle"] = "rectangle"
    x: Pair = (0.0, 1.0)
    """[x0, x1], increasing."""
    y: Pair = (0.0, 1.0)
    """[y0, y1], increasing."""
    periodic: Literal["x", "y", "both"] | None = None
    """Directions in which the rectangle repeats itself: its sides there are one seam."""


@dataclass(frozen=True, kw_only=True)
class AnnulusSector(DomainDocument):
    """A part of a ring: left is the inner arc, right the outer one, bottom the first angle, top the last."""

    USE = "A part of a ring: around a cylinder, in a bend of a pipe."
    kind: Literal["annulus_sector"] = "annulus_sector"
    center: Pair = (0.0, 0.0)
    radii: Pair = (1.0, 2.0)
    """Inner and outer, positive."""
    angles: Pair = QUARTER_TURN
    """In degrees, increasing, at most 360 apart; [0, 360] unless given if the ring is closed."""
    closed: bool = False
    """Whether the lines around the ring are closed: then bottom and top are one seam."""

    def __post_init__(self) -> None:
        if self.closed is True and self.angles is QUARTER_TURN:
            object.__setattr__(self, "angles", ONE_TURN)

    @classmethod
    def completed(cls, given: Mapping[str, Any]) -> Mapping[str, Any]:
        """A closed ring that gives no angles has those of one turn."""
        return {**given, "angles": [*ONE_TURN]} if given.get("closed") is True and "angles" not in given else given


@dataclass(frozen=True, kw_only=True)
class FormulaCurve(Document):
    """The curve of the points (x(t), y(t)) for t from 0 to 1."""

    x: Annotated[str, Limits(json={"examples": ["cos(pi*t/2)"]})]
    """An expression in t."""
    y: Annotated[str, Limits(json={"examples": ["sin(pi*t/2)"]})]
    """An expression in t."""
    parameters: Parameters = field(default_factory=dict)
    """Values of further names in x and y."""


@dataclass(frozen=True, kw_only=True)
class PointCurve(Document):
    """The cubic spline through points in their order; two points are a straight line."""

    points: Annotated[list[Pair], Limits(fail_fast=True)]
    """[[x, y], …], 2 to 10000."""


CURVES = by_key(FormulaCurve, PointCurve)
Curve: TypeAlias = Annotated[Any, CURVES]
"""One of the curves.

In Python a pair of formulas in t, which runs from 0 to 1, such as ``("cos(pi*t/2)", "sin(pi*t/2)")``, with the values
of further names as a third item if it has any, ``("r*t", "0", {"r": 2.0})``; or points of shape ``(n, 2)``.
"""


@dataclass(frozen=True, kw_only=True)
class Quadrilateral(DomainDocument):
    """The domain between four curves that meet at the corners, filled by linear blending (a Coons patch).

    A closed one is an O-grid, whose lines go on across its seam.
    """

    USE = "Four curved sides, by formulas or through points: channels, blades, patches of a larger domain."
    kind: Literal["quadrilateral"] = "quadrilateral"
    bottom: Curve
    """From left to right."""
    right: Curve
    """From bottom to top."""
    top: Curve
    """From left to right."""
    left: Curve
    """From bottom to top."""
    closed: bool = False
    """Whether two opposite sides are one curve, the seam: lines go on across it, along the other two."""


def _object(properties: dict[str, Any], required: tuple[str, ...] = ()) -> dict[str, Any]:
    return {"type": "object", "properties": properties, "required": list(required), "additionalProperties": False}


class Only:
    """Marks an object of which the schema alone says what it holds: the solver checks it, and names its places."""

    def __init__(self, schema: Mapping[str, Any]) -> None:
        self.schema = schema

    def __get_pydantic_json_schema__(self, schema: Any, handler: Any) -> Mapping[str, Any]:
        return {**self.schema}


_NAME = {"type": "string"}
_PAIR = {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 2}
_ENDS = {"type": "array", "items": _NAME, "minItems": 2, "maxItems": 2}
_COUNT = {"type": "integer", "minimum": 1}
_CELLS = {"type": "array", "items": _COUNT, "minItems": 2, "maxItems": 2}
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
Entries: TypeAlias = Sequence[Mapping[str, Any]]


@dataclass(frozen=True, kw_only=True)
class Blocks(DomainDocument):
    """Blocks of quadrilaterals between named vertices, on straight lines and curves."""

    USE = "Holes, steps, obstacles, airfoils: blocks between named vertices. With least_error or auto."
    HAS_BLOCKS = True
    kind: Literal["blocks"] = "blocks"
    vertices: Annotated[Mapping[str, Sequence[float]], InJson(dict[str, Pair])]
    """The places of the vertices, by their names."""
    curves: Annotated[Mapping[str, Mapping[str, Any]], InJson(dict[str, Annotated[dict[str, Any], Only(_CURVE)]])] = (
        field(default_factory=dict)
    )
    """Circles, points, profiles of airfoils and formulas, by their names."""
    edges: Annotated[Entries, InJson(list[Annotated[dict[str, Any], Only(_EDGE)]])] = ()
    """Edges that are not straight, or have cells of their own."""
    blocks: Annotated[Entries, InJson(list[Annotated[dict[str, Any], Only(_BLOCK)]])]
    """Four corners each, counter-clockwise, cells and grading."""
    joins: Annotated[Entries, InJson(list[Annotated[dict[str, Any], Only(_JOIN)]])] = ()
    """Edges that are one by a translation: periodic."""
    sides: Annotated[Mapping[str, Sequence[Sequence[str]]], InJson(dict[str, list[list[str]]])] = field(
        default_factory=dict
    )
    """The edges of each side, by its name."""
    corners: Annotated[Sequence[str], InJson(list[str])] = ()
    """Vertices that stay where they are."""
    fixed: Annotated[Sequence[Sequence[str]], InJson(list[Annotated[list[str], Only(_ENDS)]]), LATER] = ()
    """Edges between blocks whose nodes stay on the line or the curve of the edge."""
    refine: float = 1.0
    """Multiplies the cells of all edges."""


_LAYERS = _object({"first": {"type": "number"}, "growth": {"type": "number"}, "count": _COUNT}, ("first",))


@dataclass(frozen=True, kw_only=True)
class FixedRectangle(DomainDocument):
    """A rectangle inside of which nodes stay: at points, on curves from side to side, and in layers along sides."""

    USE = "Sensors, loads, interfaces of materials, and cells of given heights at walls. With least_error or auto."
    HAS_BLOCKS = True
    kind: Literal["fixed_rectangle"] = "fixed_rectangle"
    x: Pair = (0.0, 1.0)
    """[x0, x1], increasing."""
    y: Pair = (0.0, 1.0)
    """[y0, y1], increasing."""
    cells: Annotated[Sequence[int], InJson(Annotated[list[int], Only(_CELLS)])] = (32, 32)
    """Cells along x and along y."""
    points: Annotated[Sequence[Sequence[float]], InJson(list[Pair])] = ()
    """Places at each of which a node stays."""
    curves: Annotated[Mapping[str, Mapping[str, Any]], InJson(dict[str, Annotated[dict[str, Any], Only(_CURVE)]])] = (
        field(default_factory=dict)
    )
    """Curves from a side to the opposite one, by their names, as those of blocks: nodes slide on them."""
    layers: Annotated[Mapping[str, Mapping[str, Any]], InJson(dict[str, Annotated[dict[str, Any], Only(_LAYERS)]])] = (
        field(default_factory=dict)
    )
    """Layers of cells, by the side: the height of the first, the growth (1.2), and their count (5)."""


@dataclass(frozen=True, kw_only=True)
class MeshFile(DomainDocument):
    """A mesh of quadrilaterals that is the domain, whose blocks are found."""

    USE = "A mesh of quadrilaterals that you have, from Gmsh or a solver. With least_error or auto."
    HAS_BLOCKS = True
    kind: Literal["mesh"] = "mesh"
    file: Annotated[Path | str, InJson(str), Limits(max_length=100)]
    """The id from POST /v1/samples?kind=mesh, or "upload": the part `mesh` of this request."""
    corners: Annotated[Sequence[str | int | Sequence[float]], InJson(list[str | int | Pair])] = ()
    """Nodes that stay where they are: names, numbers, or places."""
    corner_angle: float | None = None
    """Degrees by which the boundary turns at a corner, where these are not given."""


AnyDomain: TypeAlias = Rectangle | AnnulusSector | Quadrilateral | Blocks | FixedRectangle | MeshFile
DOMAINS = by_kind(Rectangle, AnnulusSector, Quadrilateral, Blocks, FixedRectangle, MeshFile, default="rectangle")
Domain: TypeAlias = Annotated[AnyDomain, DOMAINS]
