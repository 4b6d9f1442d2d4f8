"""The models of JSON answers, and how they are made from the rows of the store."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from equimesh_schema import Certificate
from equimesh_schema.answers import ConvergenceSummary, GridSize, PartsSummary, Timings
from equimesh_service.store.rows import SUCCEEDED, EventRow, MeshRow, SamplesRow, SequenceRow

Status = Literal["queued", "running", "succeeded", "failed", "canceled"]


class Position(BaseModel):
    """A place inside an expression."""

    offset: int = Field(description="0-based, in characters.")
    line: int
    column: int = Field(description="1-based.")


class InputComplaint(BaseModel):
    """One thing wrong with the input."""

    pointer: str = Field(description="JSON pointer into the body.")
    message: str = Field(description="What is wrong, and what would be right.")
    position: Position | None = None
    parameter: str | None = Field(None, description="The query parameter or header, when it is one.")
    columns: list[str] | None = Field(
        None, description="The columns of a file, one of which is u: the request names it as column."
    )


class ProblemDetails(BaseModel):
    """A problem, after RFC 9457."""

    type: str = Field(description="Stable; GET it for an explanation.", examples=["/problems/invalid-input"])
    title: str
    detail: str
    remedy: str = Field(description="What to try.")
    status: int | None = Field(None, description="HTTP status; absent in the error of a mesh.")
    request_id: str | None = Field(None, description="Of a 5xx: the id of this request in the service's log.")
    errors: list[InputComplaint] | None = None


class Progress(BaseModel):
    """How far a mesh is."""

    model_config = ConfigDict(extra="allow")

    stage: str = Field(
        description="queued, least_error, start, single_domain, schwarz, parts, writing, measuring, done."
    )
    phase: str | None = Field(None, description="What is being done, in words; null before and after the work.")
    iteration: int | None = Field(None, description="Step of descent, Newton step, or Schwarz iteration.")
    residual: float | None = Field(None, description="Relative to the mean flux; null for a descent.")
    fraction: float | None = Field(
        0.0, description="Estimated part of the work that is done, 0 to 1; null where it is not known."
    )


class MeshResource(BaseModel):
    """A mesh: its status and, when it is finished, its quality and the links to its files."""

    id: str
    status: Status
    label: str | None
    grid: GridSize | None = Field(
        description="Of a mesh with a target, before its end, the largest that it may take; null for a mesh of blocks."
    )
    points: int = Field(
        description="The number of its nodes; with a target, before its end, the most that it may have."
    )
    blocks: list[tuple[int, int]] | None = Field(
        None, description="Cells along i and j of each block, where the service has chosen them; else null."
    )
    cells: str
    created_at: datetime
    started_at: datetime | None = Field(description="When a worker began it.")
    finished_at: datetime | None = Field(description="When it succeeded, failed or was canceled.")
    attempts: int = Field(description="How many times a worker has begun it.")
    progress: Progress
    quality: dict[str, Any] | None = Field(description="As GET …/quality, without the values per cell.")
    certificate: Certificate | None = Field(
        description="How well it solves the requested equations; null before the end."
    )
    convergence: ConvergenceSummary | None
    timings: Timings
    error: ProblemDetails | None = Field(description="Why it failed.")
    partial: bool = Field(description="Whether the mesh of a failed solve downloads with ?partial=true.")
    reused_from: str | None = Field(description="The earlier mesh whose points and files these are; null if computed.")
    parts: PartsSummary | None = Field(
        None, description="Of a finished mesh that a cluster has computed in parts; null for one that is whole."
    )
    links: dict[str, str]


class UnstoredMesh(BaseModel):
    """The state of a mesh that the service does not keep, without its points."""

    model_config = ConfigDict(extra="allow")

    spec: dict[str, Any] = Field(description="The spec with every default.")
    status: Literal["succeeded", "failed"]
    points: int = Field(description="The number of its nodes.")
    certificate: Certificate = Field(description="How well it solves the requested equations.")
    quality: dict[str, Any] | None = Field(description="As of a mesh that is kept; null for a folded mesh.")
    solution: ConvergenceSummary = Field(description="How the solve went: `convergence` of a mesh that is kept.")
    convergence: dict[str, Any] | None = Field(description="The Schwarz iteration, or the descent.")
    error: ProblemDetails | None = Field(description="Why it failed.")
    sentences: list[dict[str, str]] = Field(description="What the certificate says, in words.")
    seconds: dict[str, float] = Field(description="The time of the solve, and of measuring the mesh.")


class MeshList(BaseModel):
    """A page of meshes, newest first."""

    items: list[MeshResource]
    next_cursor: str | None = Field(description="The cursor of the next page, null on the last.")


class MeshEvent(BaseModel):
    """One thing that happened to a mesh."""

    id: int = Field(description="1, 2, 3, … for each mesh.")
    time: datetime = Field(description="When it happened, UTC.")
    event: Literal["status", "progress", "done"] = Field(description="What happened; nothing follows done.")
    data: dict[str, Any]


class MeshEvents(BaseModel):
    """Events of a mesh, in order."""

    items: list[MeshEvent]
    last: int = Field(description="Number of the last event here, for ?after=.")
    done: bool = Field(description="Whether no event follows these.")


class SamplesResource(BaseModel):
    """Stored samples of a monitor function."""

    id: str
    kind: Literal["grid", "scattered", "nodal", "block_nodes", "mesh"] = Field(
        description="nodal, block_nodes: at the nodes of a mesh; mesh: no samples, but a mesh that is a domain."
    )
    shape: list[int] = Field(description="The numbers of samples; of a mesh those of its nodes and cells.")
    min: float | None = Field(None, description="The least value; null for a mesh.")
    max: float | None = Field(None, description="The largest value; null for a mesh.")
    sides: list[str] | None = Field(None, description="The names of the sides of a mesh; null for samples.")
    size: int = Field(description="Bytes of the stored npz file.")
    created_at: datetime
    links: dict[str, str]


class SequenceResource(BaseModel):
    """A mesh that follows a time-stepper: the current step and its mesh."""

    id: str
    step: int = Field(description="Number of the step that `mesh` is; 0 is the first mesh.")
    keep: int = Field(description="How many of the last meshes are kept.")
    created_at: datetime
    used_at: datetime = Field(description="When the last step was requested.")
    status: Status = Field(description="Of its mesh.")
    certificate: Certificate | None = Field(None, description="Of its mesh; null before the end.")
    warnings: list[str] = Field(default_factory=list, description="Those of the certificate.")
    substeps: int | None = Field(
        None, description="How many meshes were computed on the way to this one, itself included; null for the first."
    )
    moved: float | None = Field(
        None, description="How far 95 % of the nodes have moved at most, in cells of the mesh before."
    )
    velocity: list[list[tuple[float, float]]] | None = Field(
        None,
        description="velocity[i][j] is how far the node (i, j) has moved since the step before, in x and y. null for "
        "the first mesh, before the end, in lists, and for more than 10,000 points: the npz file has it, too.",
    )
    mesh: MeshResource
    links: dict[str, str]


class SequenceList(BaseModel):
    """A page of sequences, newest first."""

    items: list[SequenceResource]
    next_cursor: str | None = Field(description="The cursor of the next page, null on the last.")


class Range(BaseModel):
    """Extremes over the sample grid."""

    min: float
    max: float


class WarmUp(BaseModel):
    """How far workers are with the loops that they compile once in an environment."""

    compiled: int = Field(description="Compiled loops, which rise; 0 where all are compiled and are only loaded.")
    of: int = Field(description="All loops; 0 where all are compiled and are only loaded.")


class ReadinessReport(BaseModel):
    """Whether a service can work."""

    status: Literal["ok", "unavailable"]
    checks: dict[str, str] = Field(description="By part: ok, or what is wrong.")
    warnings: list[str] = Field(description="What is wrong but stops no work.")
    warm_up: WarmUp | None = Field(
        None, description="While loops are compiled in advance; absent otherwise, and with a cluster."
    )


class DomainReport(BaseModel):
    """The size of a domain."""

    box: list[list[float]] = Field(description="[[x0, x1], [y0, y1]], the smallest box around it.")
    area: float


class ExpressionReport(BaseModel):
    """The values of an expression on a domain."""

    valid: Literal[True] = True
    understood: str = Field(description="The expression in the language itself: 2*x for 2x.")
    names: list[str] = Field(description="The variables and parameters that occur.")
    u: Range
    gradient: Range = Field(description="Length of the gradient.")
    constant: bool = Field(description="Whether the mesh will be uniform.")
    domain: DomainReport


def mesh_resource(row: MeshRow, root: str) -> MeshResource:
    """The mesh as clients see it; ``root`` is the start of all addresses."""
    here = f"{root}/v1/meshes/{row.id}"
    result = row.result or {}
    parts = result.get("parts")
    places = ("events", "cancel", "file", "quality", "convergence", "plot", "spec", *(("parts",) if parts else ()))
    started = row.started_at
    n_xi, n_eta = result.get("grid") or (row.n_xi, row.n_eta)
    return MeshResource(
        id=row.id,
        status=row.status,  # type: ignore[arg-type]
        label=row.label,
        grid=GridSize(n_xi=n_xi, n_eta=n_eta) if row.has_grid else None,
        points=n_xi * n_eta,
        blocks=result.get("blocks"),
        cells=row.cells,
        created_at=_moment(row.created_at),
        started_at=None if started is None else _moment(started),
        finished_at=None if row.finished_at is None else _moment(row.finished_at),
        attempts=row.attempt,
        progress=_progress(row),
        quality=result.get("quality"),
        certificate=result.get("certificate"),
        convergence=result.get("solution"),
        timings=Timings(
            queued=None if started is None else round(max(0.0, started - row.created_at), 6),
            total=None if row.finished_at is None else round(max(0.0, row.finished_at - row.created_at), 6),
            **result.get("timings", {}),
        ),
        error=None if row.error is None else ProblemDetails(**row.error),
        partial=row.partial,
        reused_from=row.reused_from,
        parts=None if parts is None else PartsSummary(count=len(parts["rows"]), **parts["traffic"]),
        links={"self": here, **{place: f"{here}/{place}" for place in places}},
    )


def sequence_resource(row: SequenceRow, step: int, mesh: MeshRow, root: str, velocity: Any = None) -> SequenceResource:
    """The sequence at a step, as clients see it; ``root`` is the start of all addresses.

    ``velocity`` is the displacement of the nodes as lists, where it is known.
    """
    shown = mesh_resource(mesh, root)
    here, of_mesh = f"{root}/v1/sequences/{row.id}", f"{root}/v1/meshes/{mesh.id}"
    return SequenceResource(
        id=row.id,
        step=step,
        keep=row.keep,
        created_at=_moment(row.created_at),
        used_at=_moment(row.used_at),
        status=shown.status,
        certificate=shown.certificate,
        warnings=[] if shown.certificate is None else list(shown.certificate.warnings),
        velocity=velocity,
        mesh=shown,
        **(mesh.result or {}).get("step", {}),
        links={"self": here, "steps": f"{here}/steps", "mesh": of_mesh, "file": f"{of_mesh}/file?format=npz"},
    )


def event_resource(row: EventRow) -> MeshEvent:
    """An event as clients see it."""
    return MeshEvent(id=row.number, time=_moment(row.time), event=row.kind, data=row.data)  # type: ignore[arg-type]


def samples_resource(row: SamplesRow, root: str) -> SamplesResource:
    """Samples as clients see them; ``root`` is the start of all addresses."""
    here = f"{root}/v1/samples/{row.id}"
    links = {"self": here, "file": f"{here}?format=npz"}
    return SamplesResource(id=row.id, size=row.size, created_at=_moment(row.created_at), links=links, **row.summary)


def _progress(row: MeshRow) -> Progress:
    if row.status == SUCCEEDED:
        return Progress(**{**(row.progress or {}), "stage": "done", "fraction": 1.0})
    return Progress(**(row.progress or {"stage": row.status}))


def _moment(seconds: float) -> datetime:
    return datetime.fromtimestamp(seconds, UTC)
