"""The spec of a mesh: strict models of the JSON that a client posts, with every default in one place."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field, FiniteFloat

from equimesh_service.spec.domains import Domain, RectangleSpec
from equimesh_service.spec.monitors import Monitor
from equimesh_service.spec.schwarz import SchwarzSpec
from equimesh_service.spec.strict import WITHOUT_NUL, Parameters, Strict, validated

MODE_USES = {
    "discretization": "Meshes to compute on: iterates until the error of the solution on the grid is small beside that "
    "of the grid itself.",
    "tight": "Studies that compare meshes digit by digit: solves the equations to rounding.",
}


class GridSpec(Strict):
    """Points of the mesh in each direction; 12 points make 11 cells."""

    n_xi: int = Field(default=64, description="Points along xi, at least 4.")
    n_eta: int = Field(default=64, description="Points along eta, at least 4.")


class MeshSpec(Strict):
    """Everything that defines a mesh; all but `monitor` has a default."""

    monitor: Monitor
    domain: Domain = Field(default_factory=RectangleSpec)
    grid: GridSpec = Field(default_factory=GridSpec)
    boundary: Literal["trace", "equidistributed_1d", "orthogonal"] = Field(
        "trace", description="How points move along the sides; equidistributed_1d is the paper's."
    )
    initial: Literal["nested", "uniform"] = Field(
        "nested", description="The initial mesh: from coarser grids, or uniform as in the paper."
    )
    schwarz: SchwarzSpec | None = Field(None, description="Absent or null: solved as a single domain.")
    mode: Literal["discretization", "tight"] = Field(
        "discretization", description="How exactly the discrete equations are solved; see /v1/capabilities."
    )
    allow_relaxed: bool = Field(
        True,
        description="Whether the mesh may be for a weaker monitor than asked where that cannot be solved; its "
        "certificate then says so.",
    )
    cells: Literal["quad", "triangle"] = Field("quad", description="Cells of the mesh file.")
    label: str | None = Field(
        None, max_length=200, pattern=WITHOUT_NUL, description="Free text, for the list of meshes."
    )

    def canonical(self) -> dict[str, Any]:
        """The same spec as plain JSON with every default filled in; posting it gives the same mesh."""
        return self.model_dump(mode="json")


class ExpressionCheck(Strict):
    """An expression to be checked."""

    expression: str
    parameters: Parameters = Field(default_factory=dict)
    t: FiniteFloat = 0.0
    domain: Domain = Field(default_factory=RectangleSpec, description="Where it is evaluated.")


def read_spec(document: Any) -> MeshSpec:
    """The spec in a parsed JSON document; raises a 422 problem that lists what is wrong, with pointers."""
    return validated(MeshSpec, document)


def read_expression_check(document: Any) -> ExpressionCheck:
    """The body of an expression check; raises as :func:`read_spec`."""
    return validated(ExpressionCheck, document)
