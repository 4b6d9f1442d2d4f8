"""The Schwarz iteration in a spec: subdomains, what they exchange, what speeds it up, and when to use which."""

from typing import Annotated, Any, Literal, TypeAlias

from pydantic import Discriminator, Field, FiniteFloat, GetJsonSchemaHandler, Tag

from equimesh_schema.document import TAG
from equimesh_service.spec.strict import Strict, by_kind, either

TRANSMISSION_USES = {
    "optimized": "For every mesh: a handful of iterations, however many subdomains. The default.",
    "classical": "Studies of rates that theory predicts, and, with line_correction 3 or more, neighbours that can send "
    "positions only.",
    "linear_robin": "Studies of the paper's condition on two strips and a mild u; on a steep u it stalls.",
    "nonlinear_robin": "The paper's condition of the fewest iterations where u is mild; on a steep u it stalls.",
}
INTERFACE_DATA_USES = {
    "line_sums": "Always, unless subdomains may talk to their neighbours only: one number for every grid line and cut.",
    "local": "Subdomains that know nothing but their neighbours: more iterations, the more the subdomains.",
}
ORDERING_USES = {
    "parallel": "Subdomains on cores or machines of their own: all at the same time. The default.",
    "alternating": "One machine, or the paper's numbers: one after the other, each with the newest data.",
    "symmetric": "Many strips without line corrections, on one machine: alternating there and back, twice the work.",
    "coloured": "A few cores: every other strip at a time, or four turns of blocks, nearly as good as alternating.",
}
ACCELERATION_USES = {
    "none": "Studies of an iteration's own rate.",
    "anderson": "For every mesh: a combination of the last iterations, which costs nothing. Auto, for optimized.",
    "newton": "Studies: four or five iterations without line corrections, at many times the work of each.",
}
LOCAL_SOLVER_USES = {
    "sweeps": "For every mesh: line corrections, where the condition knows any, and Newton's method where they fail.",
    "newton": "The reference: every subdomain to rounding in every iteration, by sparse factorisations.",
}


class OptimizedSpec(Strict):
    """Interfaces that yield as the rest of their grid line does."""

    kind: Literal["optimized"]
    data: Literal["line_sums", "local"] = Field(
        default="line_sums",
        description="The data of an interface about the lines beyond it: the whole rest, or the first edge.",
    )


class ClassicalSpec(Strict):
    """Positions of the neighbours on the interfaces, as in the paper."""

    kind: Literal["classical"]


_Strength: TypeAlias = Annotated[
    Literal["auto"] | FiniteFloat,
    either("a positive number, or 'auto'"),
    Field(description="A positive number, or 'auto'."),
]


class LinearRobinSpec(Strict):
    """The linear Robin condition of the paper."""

    kind: Literal["linear_robin"]
    p: _Strength = "auto"


class NonlinearRobinSpec(Strict):
    """The nonlinear Robin condition of the paper."""

    kind: Literal["nonlinear_robin"]
    p: _Strength = "auto"


AnyTransmission: TypeAlias = OptimizedSpec | ClassicalSpec | LinearRobinSpec | NonlinearRobinSpec
Transmission = Annotated[
    Annotated[OptimizedSpec, Tag(TAG + "optimized")]
    | Annotated[ClassicalSpec, Tag(TAG + "classical")]
    | Annotated[LinearRobinSpec, Tag(TAG + "linear_robin")]
    | Annotated[NonlinearRobinSpec, Tag(TAG + "nonlinear_robin")],
    by_kind(*TRANSMISSION_USES),
]


Division: TypeAlias = Annotated[int | list[int], either("a whole number, or a list of grid lines")]


class SchwarzSpec(Strict):
    """Domain decomposition and the Schwarz iteration."""

    subdomains: Annotated[list[Division], Field(min_length=2, max_length=2)] = Field(
        default_factory=lambda: list[int | list[int]]([2, 1]),
        description="Subdomains along xi and along eta: how many, or a list of the grid lines at which they meet.",
    )
    overlap: int = Field(4, description="Points that neighbours share, at least 2.")
    transmission: Transmission = Field(
        default_factory=lambda: OptimizedSpec(kind="optimized"),
        description="The condition on the interfaces; optimized if absent.",
    )
    ordering: Literal["parallel", "alternating", "symmetric", "coloured"] = Field(
        "parallel", description="Which subdomains are solved at the same time."
    )
    line_correction: Annotated[Literal["auto"] | int, either("a whole number from 0 to 10, or 'auto'")] = Field(
        "auto",
        description="How many times all grid lines are corrected as a whole after every iteration, 0 to 10; 'auto' is "
        "3 for the optimized condition, 0 for the others.",
    )
    acceleration: Literal["auto", "none", "anderson", "newton"] = Field(
        "auto",
        description="How several iterations are combined; 'auto' is anderson for the optimized condition and wherever "
        "lines are corrected, otherwise none.",
    )
    local_solver: Literal["sweeps", "newton"] = Field("sweeps", description="How a subdomain is solved.")
    fallback: bool = Field(
        True,
        description="Whether the optimized condition takes over where another stalls, a single domain where all do.",
    )
    tolerance: Annotated[
        FiniteFloat | Literal["discretization"] | None, either("a positive number, 'discretization', or null")
    ] = Field(
        1e-10,
        description="The iteration ends when its estimated error in the coordinates is at most this; 'discretization' "
        "is a fifth of the error of the grid itself; null runs exactly max_iterations.",
    )
    max_iterations: int = Field(100, description="It fails where this many do not reach the tolerance.")
    compare_single_domain: bool = Field(
        False, description="Also solve the single domain, and report the error against it."
    )

    @property
    def counts(self) -> tuple[int, int]:
        """How many subdomains there are along xi and along eta."""
        xi, eta = (len(part) + 1 if isinstance(part, list) else part for part in self.subdomains)
        return xi, eta


class BlockSchwarzSpec(Strict):
    """The Schwarz iteration between the blocks of a domain, for the mesh of least error."""

    overlap: int = Field(4, description="Layers of cells of its neighbours that a subdomain also has, 1 to 64.")
    local_steps: int = Field(8, description="Steps of descent of a subdomain in one exchange, 1 to 1000.")
    max_exchanges: int | None = Field(
        None, description="Exchanges at most; null: as many as take the steps of a solve of the whole mesh."
    )
    groups: Annotated[
        list[Annotated[list[str | int], Field(min_length=1)]] | None,
        either("a list of lists of names or numbers of blocks, or null"),
    ] = Field(None, description="The blocks of each subdomain, each block once; null: every block is one.")


class OnBlocks(dict[str, Any]):
    """The settings of an iteration as they were sent, with a domain that has blocks."""


class _AnyOf:
    """The schema of a union, of which a document may fit several members, as one without keys does."""

    def __get_pydantic_json_schema__(self, core_schema: Any, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        schema = handler(core_schema)
        return {"anyOf" if key == "oneOf" else key: part for key, part in schema.items()}


def _kind_of(value: Any) -> str:
    return TAG + ("blocks" if isinstance(value, OnBlocks | BlockSchwarzSpec) else "grid")


AnySchwarz = Annotated[
    Annotated[SchwarzSpec, Tag(TAG + "grid")] | Annotated[BlockSchwarzSpec, Tag(TAG + "blocks")],
    Discriminator(_kind_of),
    _AnyOf(),
]
"""The settings of an iteration; the domain of the spec says of which one."""
