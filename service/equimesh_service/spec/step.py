"""A step of a sequence in a request."""

from typing import Annotated

from pydantic import FailFast, Field, Tag

from equimesh_service.spec.sources import ExpressionSource, OrText
from equimesh_service.spec.strict import TAG, Numbers, Strict, by_key

# The most fields of a step.
MAX_FIELDS = 32
_Rows = Annotated[list[Numbers], FailFast()]


class NodesSource(Strict):
    """u at the nodes of the current mesh."""

    nodes: _Rows = Field(description="nodes[i][j] is u at the node (i, j): n_xi rows of n_eta values.")


class StepSpec(Strict):
    """The next step of a sequence."""

    step: int = Field(description="The step that this one follows: u and the fields are at the nodes of its mesh.")
    u: Annotated[
        Annotated[NodesSource, Tag(TAG + "nodes")] | Annotated[ExpressionSource, Tag(TAG + "expression")],
        by_key("nodes", "expression"),
        OrText(),
    ] = Field(description="The function that the next mesh adapts to.")
    fields: dict[str, _Rows] = Field(
        default_factory=dict,
        max_length=MAX_FIELDS,
        description="Further values at the nodes, as u.nodes, to transfer to the next mesh; by names of letters, "
        "digits and underscores.",
    )
