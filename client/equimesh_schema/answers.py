"""What a service answers about its meshes: times, a summary of the convergence, and the files of parts."""

from collections.abc import Iterator
from dataclasses import dataclass

from equimesh_schema.document import Answer


@dataclass(frozen=True, kw_only=True)
class ConvergenceSummary(Answer):
    """How the solve went, in one line."""

    status: str
    """converged, completed, relaxed, not_converged, newton_failed, folded."""
    message: str
    iterations: int
    """Schwarz iterations; 0 for a single domain."""
    newton_steps: int
    """In all."""
    transmission: str | None = None
    """The Schwarz condition in use at the end; after a fallback, not the requested one."""
    work: int | None = None
    """Nodes corrected in all Schwarz iterations, counted each time."""
    traffic: int | None = None
    """Bytes that subdomains on machines of their own would have sent."""
    residual: float | None
    """Of the equations, relative."""
    change: float | None
    """Largest move of a node in the last iteration."""
    error: float | None
    max_q_eq: float | None
    """Largest share of the metric of a cell; 1 where all are equal."""
    rate: float | None
    """Observed factor of the error from one iteration to the next."""
    predicted_rate: float | None
    """Factor that the theory predicts; null where it predicts none."""


@dataclass(frozen=True, kw_only=True)
class Timings(Answer):
    """The time of each part, in seconds."""

    queued: float | None = None
    solve: float | None = None
    write: float | None = None
    total: float | None = None
    """From the request to the end."""


@dataclass(frozen=True, kw_only=True)
class GridSize(Answer):
    """Points in each direction."""

    n_xi: int
    n_eta: int

    def __iter__(self) -> Iterator[int]:
        return iter((self.n_xi, self.n_eta))


@dataclass(frozen=True, kw_only=True)
class PartsSummary(Answer):
    """A mesh in parts: how many there are, and what they have sent each other."""

    count: int
    """Number of parts; GET …/parts lists them."""
    bytes: int
    """Bytes that the parts have sent each other."""
    messages: int
    """Messages of the part that has sent most."""
    attempts: int
    """How often the parts have begun, as workers were lost."""


@dataclass(frozen=True, kw_only=True)
class FileOfParts(Answer):
    """A file of a mesh in parts."""

    name: str
    """The path next to the head, which looks for the files of parts under their names."""
    media_type: str
    """The type of its bytes, as the header of its answer says it."""
    size: int | None
    """Bytes; null until the file is made, which its first request does."""
    sha256: str | None
    """Of its bytes, as its ETag; null until it is made."""
    href: str
    """The address of the file."""


@dataclass(frozen=True, kw_only=True)
class PartRecord(Answer):
    """One part of a mesh: consecutive rows of its grid, along xi."""

    number: int
    """0, 1, 2, …"""
    first: int
    """The first own row of the part."""
    last: int
    """The first own row of the next part."""
    rows: int
    """Rows in its file: its own, and the first one of the next part, which closes cells."""
    file: FileOfParts


@dataclass(frozen=True, kw_only=True)
class Parts(Answer):
    """All files of a mesh in parts, in one format."""

    id: str
    format: str
    """The format of these files."""
    formats: tuple[str, ...]
    """All formats of parts."""
    grid: GridSize
    count: int
    """How many parts there are."""
    size: int | None
    """Bytes of all these files; null while one of them is not made."""
    head: FileOfParts | None
    """The file to open, which names the others; null for npz."""
    parts: tuple[PartRecord, ...]
