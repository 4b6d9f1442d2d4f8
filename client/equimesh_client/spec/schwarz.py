"""Settings of the Schwarz iteration, as dataclasses and as the JSON of the HTTP interface."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

from equimesh_client.errors import BadArgument

TRANSMISSIONS = ("optimized", "classical", "linear_robin", "nonlinear_robin")

Json: TypeAlias = dict[str, Any]
Parameter: TypeAlias = float | Literal["auto"]
Division: TypeAlias = int | tuple[int, ...]
"""How many subdomains there are in one direction, or the grid lines at which they meet."""


@dataclass(frozen=True)
class Optimized:
    """Interfaces that move as the rest of every grid line requires: a few iterations for any number of subdomains.

    ``data`` is ``"line_sums"`` for all of that rest, ``"local"`` for its first edge only, with more iterations.
    """

    data: str = "line_sums"

    def json(self) -> Json:
        """The JSON of the condition."""
        return {"kind": "optimized", "data": str(self.data)}


@dataclass(frozen=True)
class Classical:
    """Exchanges positions at the interfaces. Needs no parameter and converges slowly."""

    def json(self) -> Json:
        """The JSON of the condition."""
        return {"kind": "classical"}


@dataclass(frozen=True)
class LinearRobin:
    """The paper's linear Robin condition with parameter ``p`` > 0, or ``"auto"`` for the service's choice."""

    p: Parameter = "auto"

    def json(self) -> Json:
        """The JSON of the condition."""
        return {"kind": "linear_robin", "p": self.p}


@dataclass(frozen=True)
class NonlinearRobin:
    """The paper's nonlinear Robin condition with parameter ``p`` > 0, or ``"auto"`` for the service's choice."""

    p: Parameter = "auto"

    def json(self) -> Json:
        """The JSON of the condition."""
        return {"kind": "nonlinear_robin", "p": self.p}


Transmission: TypeAlias = Optimized | Classical | LinearRobin | NonlinearRobin


@dataclass(frozen=True, kw_only=True)
class Schwarz:
    """The division of the domain, and the Schwarz iteration over its parts.

    ``subdomains`` counts them along xi and eta; in place of a number it can be the grid lines at which they meet, as in
    ``((24, 40), 1)``. ``overlap`` is in grid points, at least 2. ``ordering`` is
    ``"parallel"``, ``"alternating"``, ``"symmetric"`` or ``"coloured"``. ``line_correction`` is the number of
    corrections of all grid lines after every iteration, 0 to 10 or ``"auto"``. ``acceleration`` is ``"auto"``,
    ``"none"``, ``"anderson"`` or ``"newton"``; ``local_solver`` is ``"sweeps"`` or ``"newton"``. With ``fallback`` the
    optimized condition replaces another that stalls.

    The iteration ends when the estimated error is at most ``tolerance``; ``"discretization"`` is a fifth of the
    discretisation error, and ``None`` runs exactly ``max_iterations``. ``compare_single_domain=True`` also solves the
    single domain and records the error of every iteration against its mesh.
    """

    subdomains: tuple[Division, Division] = (2, 1)
    overlap: int = 4
    transmission: Transmission = field(default_factory=Optimized)
    ordering: str = "parallel"
    line_correction: int | Literal["auto"] = "auto"
    acceleration: str = "auto"
    local_solver: str = "sweeps"
    fallback: bool = True
    tolerance: float | Literal["discretization"] | None = 1e-10
    max_iterations: int = 100
    compare_single_domain: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.transmission, Transmission):
            raise BadArgument(
                f"transmission = {str(self.transmission)[:40]!r}: give Optimized(), Classical(), LinearRobin() or"
                " NonlinearRobin()"
            )
        if not (isinstance(self.subdomains, tuple | list) and len(self.subdomains) == 2):
            raise BadArgument(f"subdomains = {self.subdomains!r}: give a pair, (4, 1) or (2, 2) for instance")

    def json(self) -> Json:
        """The JSON of the settings."""
        return {
            "subdomains": [list(part) if isinstance(part, tuple | list) else part for part in self.subdomains],
            "overlap": self.overlap,
            "transmission": self.transmission.json(),
            "ordering": str(self.ordering),
            "line_correction": self.line_correction,
            "acceleration": str(self.acceleration),
            "local_solver": str(self.local_solver),
            "fallback": self.fallback,
            "tolerance": self.tolerance,
            "max_iterations": self.max_iterations,
            "compare_single_domain": self.compare_single_domain,
        }


@dataclass(frozen=True, kw_only=True)
class BlockSchwarz:
    """A Schwarz iteration between the blocks of a domain, for the mesh of least error.

    Every subdomain, a block or one of the ``groups`` of names or numbers of blocks, takes ``local_steps`` of descent
    with the others held; then they exchange their moves. It also has ``overlap`` layers of cells of its neighbours.
    ``max_exchanges`` is None for as many as take the steps of a solve of the whole mesh.
    """

    overlap: int = 4
    local_steps: int = 8
    max_exchanges: int | None = None
    groups: Sequence[Sequence[str | int]] | None = None

    def json(self) -> Json:
        """The JSON of the settings."""
        return {
            "overlap": self.overlap,
            "local_steps": self.local_steps,
            "max_exchanges": self.max_exchanges,
            "groups": None if self.groups is None else [list(group) for group in self.groups],
        }


def transmission(kind: str, p: Parameter | None = None, data: str | None = None) -> Transmission:
    """The transmission condition named ``kind``: with ``p`` if it is a Robin condition, with ``data`` if optimized.

    Raises :class:`BadArgument` for an unknown name, and for a parameter that the condition does not have.
    """
    if kind not in TRANSMISSIONS:
        raise BadArgument(f"unknown transmission {kind!r}; there are {', '.join(TRANSMISSIONS)}")
    if data is not None and kind != "optimized":
        raise BadArgument(f"{kind} transmission takes no interface data; that is of the optimized one")
    if p is not None and kind not in ("linear_robin", "nonlinear_robin"):
        raise BadArgument(f"{kind} transmission takes no parameter p; that is of linear_robin and nonlinear_robin")
    match kind:
        case "optimized":
            return Optimized() if data is None else Optimized(data)
        case "classical":
            return Classical()
        case "linear_robin":
            return LinearRobin() if p is None else LinearRobin(p)
        case _:
            return NonlinearRobin() if p is None else NonlinearRobin(p)
