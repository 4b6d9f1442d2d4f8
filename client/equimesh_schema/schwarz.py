"""The Schwarz iteration: subdomains, what they exchange, what speeds it up, and when to use which."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, ClassVar, Literal, TypeAlias

from equimesh_schema.document import LATER, Document, Either, InJson, Limits, Words, by_kind

ORDERINGS = Words(
    parallel="Subdomains on cores or machines of their own: all at the same time. The default.",
    alternating="One machine, or the paper's numbers: one after the other, each with the newest data.",
    symmetric="Many strips without line corrections, on one machine: alternating there and back, twice the work.",
    coloured="A few cores: every other strip at a time, or four turns of blocks, nearly as good as alternating.",
)
ACCELERATIONS = Words(
    auto="anderson for the optimized condition and wherever lines are corrected, otherwise none. The default.",
    none="Studies of an iteration's own rate.",
    anderson="For every mesh: a combination of the last iterations, which costs nothing. Auto, for optimized.",
    newton="Studies: four or five iterations without line corrections, at many times the work of each.",
)
LOCAL_SOLVERS = Words(
    sweeps="For every mesh: line corrections, where the condition knows any, and Newton's method where they fail.",
    newton="The reference: every subdomain to rounding in every iteration, by sparse factorisations.",
)
INTERFACE_DATA = Words(
    line_sums="Always, unless subdomains may talk to their neighbours only: one number for every grid line and cut.",
    local="Subdomains that know nothing but their neighbours: more iterations, the more the subdomains.",
)


@dataclass(frozen=True, kw_only=True)
class Condition(Document):
    """What all transmission conditions have."""

    USE: ClassVar[str]
    """When to take it, in a sentence."""
    NEEDED = ("kind",)
    kind: str


@dataclass(frozen=True, kw_only=True)
class Optimized(Condition):
    """Interfaces that yield as the rest of their grid line does: few iterations for any number of subdomains."""

    USE = "For every mesh: a handful of iterations, however many subdomains. The default."
    kind: Literal["optimized"] = "optimized"
    data: Annotated[str, INTERFACE_DATA] = field(default="line_sums", kw_only=False)
    """The data of an interface about the lines beyond it: the whole rest, or the first edge."""


@dataclass(frozen=True, kw_only=True)
class Classical(Condition):
    """Positions of the neighbours on the interfaces, as in the paper. It converges slowly."""

    USE = (
        "Studies of rates that theory predicts, and, with line_correction 3 or more, neighbours that can send "
        "positions only."
    )
    kind: Literal["classical"] = "classical"


Strength: TypeAlias = Annotated[float | Literal["auto"], Either("a positive number, or 'auto'")]


@dataclass(frozen=True, kw_only=True)
class LinearRobin(Condition):
    """The linear Robin condition of the paper."""

    USE = "Studies of the paper's condition on two strips and a mild u; on a steep u it stalls."
    kind: Literal["linear_robin"] = "linear_robin"
    p: Strength = field(default="auto", kw_only=False)
    """A positive number, or 'auto'."""


@dataclass(frozen=True, kw_only=True)
class NonlinearRobin(Condition):
    """The nonlinear Robin condition of the paper."""

    USE = "The paper's condition of the fewest iterations where u is mild; on a steep u it stalls."
    kind: Literal["nonlinear_robin"] = "nonlinear_robin"
    p: Strength = field(default="auto", kw_only=False)
    """A positive number, or 'auto'."""


Transmission: TypeAlias = Optimized | Classical | LinearRobin | NonlinearRobin
TRANSMISSIONS = by_kind(Optimized, Classical, LinearRobin, NonlinearRobin)
Division: TypeAlias = Annotated[
    int | Sequence[int], InJson(int | list[int]), Either("a whole number, or a list of grid lines")
]


@dataclass(frozen=True, kw_only=True)
class Schwarz(Document):
    """Domain decomposition and the Schwarz iteration, between rectangles of a grid or the blocks of a domain.

    Least error has `subdomains`, `overlap`, `local_steps` and `max_exchanges` alone, and on blocks `groups` in place of
    `subdomains`: every subdomain takes steps of descent with the others held; then they exchange their moves.
    """

    subdomains: Annotated[Sequence[Division], InJson(list[Division]), Limits(min_length=2, max_length=2)] = (2, 1)
    """Subdomains along xi and along eta: how many, or a list of the grid lines at which they meet."""
    overlap: int = 4
    """Points that neighbours share, at least 2; for least error the layers of cells of its neighbours that a subdomain
    also has, 1 to 64."""
    transmission: Annotated[Transmission, TRANSMISSIONS] = Optimized()
    """The condition on the interfaces; optimized if absent."""
    ordering: Annotated[str, ORDERINGS] = "parallel"
    """Which subdomains are solved at the same time."""
    line_correction: Annotated[int | Literal["auto"], Either("a whole number from 0 to 10, or 'auto'")] = "auto"
    """How many times all grid lines are corrected as a whole after every iteration, 0 to 10; 'auto' is 3 for the
    optimized condition, 0 for the others."""
    acceleration: Annotated[str, ACCELERATIONS] = "auto"
    """How several iterations are combined; 'auto' is anderson for the optimized condition and wherever lines are
    corrected, otherwise none."""
    local_solver: Annotated[str, LOCAL_SOLVERS] = "sweeps"
    """How a subdomain is solved."""
    fallback: bool = True
    """Whether the optimized condition takes over where another stalls, a single domain where all do."""
    tolerance: Annotated[
        float | Literal["discretization"] | None, Either("a positive number, 'discretization', or null")
    ] = 1e-10
    """The iteration ends when its estimated error in the coordinates is at most this; 'discretization' is a fifth of
    the error of the grid itself; null runs exactly max_iterations."""
    max_iterations: int = 100
    """Most iterations; the solve fails where they do not reach the tolerance."""
    compare_single_domain: bool = False
    """Also solve the single domain, and report the error against it."""
    local_steps: Annotated[int, LATER] = 8
    """For least error alone: steps of descent of a subdomain in one exchange, 1 to 1000."""
    max_exchanges: Annotated[int | None, LATER] = None
    """For least error alone: exchanges at most; null: as many as take the steps of a solve of the whole mesh."""
    groups: Annotated[
        Sequence[Sequence[str | int]] | None,
        InJson(list[Annotated[list[str | int], Limits(min_length=1)]] | None),
        Either("a list of lists of names or numbers of blocks, or null"),
        LATER,
    ] = None
    """For blocks alone: the blocks of each subdomain, each block once; null: every block is one."""

    @property
    def counts(self) -> tuple[int, int]:
        """How many subdomains there are along xi and along eta."""
        xi, eta = (part if isinstance(part, int) else len(part) + 1 for part in self.subdomains)
        return xi, eta
