"""Physical domains in a spec."""

from typing import Annotated, Any, Literal, TypeAlias

from pydantic import FailFast, Field, Tag, model_validator

from equimesh_schema.document import TAG, Pair, Parameters
from equimesh_service.spec.blocks import BlocksSpec, MeshFileSpec
from equimesh_service.spec.strict import Strict, by_key, by_kind

USES = {
    "rectangle": "A box; the unit square unless x and y are given.",
    "annulus_sector": "A part of a ring: around a cylinder, in a bend of a pipe.",
    "quadrilateral": "Four curved sides, by formulas or through points: channels, blades, patches of a larger domain.",
    "blocks": "Holes, steps, obstacles, airfoils: blocks between named vertices. With least_error or auto.",
    "mesh": "A mesh of quadrilaterals that you have, from Gmsh or a solver. With least_error or auto.",
}


class RectangleSpec(Strict):
    """The rectangle between two values of x and two of y; left and right are the sides of constant x."""

    kind: Literal["rectangle"] = "rectangle"
    x: Pair = Field(default_factory=lambda: [0.0, 1.0], description="[x0, x1], increasing.")
    y: Pair = Field(default_factory=lambda: [0.0, 1.0], description="[y0, y1], increasing.")
    periodic: Literal["x", "y", "both"] | None = Field(
        default=None, description="Directions in which the rectangle repeats itself: its sides there are one seam."
    )


class AnnulusSectorSpec(Strict):
    """A part of a ring: left is the inner arc, right the outer one, bottom the first angle, top the last."""

    kind: Literal["annulus_sector"]
    center: Pair = Field(default_factory=lambda: [0.0, 0.0])
    radii: Pair = Field(default_factory=lambda: [1.0, 2.0], description="Inner and outer, positive.")
    angles: Pair = Field(
        default_factory=lambda: [0.0, 90.0],
        description="In degrees, increasing, at most 360 apart; [0, 360] unless given if the ring is closed.",
    )
    closed: bool = Field(
        default=False, description="Whether the lines around the ring are closed: then bottom and top are one seam."
    )

    @model_validator(mode="before")
    @classmethod
    def _one_turn(cls, value: Any) -> Any:
        """A closed ring that gives no angles has those of one turn."""
        if isinstance(value, dict) and value.get("closed") is True and "angles" not in value:
            return {**value, "angles": [0.0, 360.0]}
        return value


class FormulaCurve(Strict):
    """The curve of the points (x(t), y(t)) for t from 0 to 1."""

    x: str = Field(description="An expression in t.", examples=["cos(pi*t/2)"])
    y: str = Field(description="An expression in t.", examples=["sin(pi*t/2)"])
    parameters: Parameters = Field(default_factory=dict, description="Values of further names in x and y.")


class PointCurve(Strict):
    """The cubic spline through points in their order; two points are a straight line."""

    points: Annotated[list[Pair], FailFast()] = Field(description="[[x, y], …], 2 to 10000.")


AnyCurve: TypeAlias = FormulaCurve | PointCurve
Curve = Annotated[
    Annotated[FormulaCurve, Tag(TAG + "x")] | Annotated[PointCurve, Tag(TAG + "points")], by_key("x", "points")
]


class QuadrilateralSpec(Strict):
    """The domain between four curves that meet at the corners, filled by linear blending (a Coons patch).

    A closed one is an O-grid, whose lines go on across its seam.
    """

    kind: Literal["quadrilateral"]
    bottom: Curve = Field(description="From left to right.")
    right: Curve = Field(description="From bottom to top.")
    top: Curve = Field(description="From left to right.")
    left: Curve = Field(description="From bottom to top.")
    closed: bool = Field(
        default=False,
        description="Whether two opposite sides are one curve, the seam: lines go on across it, along the other two.",
    )


AnyDomain: TypeAlias = RectangleSpec | AnnulusSectorSpec | QuadrilateralSpec | BlocksSpec | MeshFileSpec
Domain = Annotated[
    Annotated[RectangleSpec, Tag(TAG + "rectangle")]
    | Annotated[AnnulusSectorSpec, Tag(TAG + "annulus_sector")]
    | Annotated[QuadrilateralSpec, Tag(TAG + "quadrilateral")]
    | Annotated[BlocksSpec, Tag(TAG + "blocks")]
    | Annotated[MeshFileSpec, Tag(TAG + "mesh")],
    by_kind(*USES, default="rectangle"),
]
