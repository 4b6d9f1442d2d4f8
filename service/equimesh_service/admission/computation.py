"""What a worker makes of the body of a request: a mesh that is kept, or the bytes of an answer of which nothing is."""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import partial
from hashlib import sha256
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import equimesh
from equimesh.io.write import mesh_bytes
from equimesh.specs.spec import BuiltSpec
from equimesh_service.admission.admit import Admission
from equimesh_service.admission.callers import Caller
from equimesh_service.admission.formats import check_format
from equimesh_service.admission.steps import StepAdmission, max_bytes, read_arrays, read_json
from equimesh_service.admission.tasks import AdmittedSpec, Computation, ComputationResult, Request
from equimesh_service.assembly import samples as intake
from equimesh_service.assembly.bodies import MAX_SHORT_BYTES, ShortSpec
from equimesh_service.assembly.problem import check, translate_errors
from equimesh_service.assembly.upload import Upload
from equimesh_service.errors import (
    AttemptLostError,
    KeyReusedError,
    KeyTakenError,
    QuotaError,
    SamplesGoneError,
    StepTakenError,
    TimeLimitError,
)
from equimesh_service.files.port import StoredFile, publish_nothing
from equimesh_service.problems.problem import Problem, problem_at, repointed
from equimesh_service.problems.storage import storage_faults
from equimesh_service.spec.document import parse, sent_pointer
from equimesh_service.spec.mesh import CheckedSpec
from equimesh_service.store.blobs import BlobFiles
from equimesh_service.store.rows import (
    FAILED,
    Ending,
    FinishedMesh,
    MeshInput,
    NewEntry,
    NoMesh,
    Outcome,
    SamplesRow,
)
from equimesh_service.store.store import Store
from equimesh_service.telemetry import log_context
from equimesh_service.telemetry.stopwatch import Stopwatch
from equimesh_service.wire.body import NPZ, take_apart
from equimesh_service.worker.drawing import Frames, document_of_solution, draw_solution
from equimesh_service.worker.job import DRAWING, attempt, log_context_of
from equimesh_service.worker.solve import Attempt, Work, build_work, solve_work
from equimesh_service.worker.summary import problem_of

if TYPE_CHECKING:
    from equimesh_service.worker.summary import AnySolution

_log = logging.getLogger(__name__)


def compute(task: Computation) -> ComputationResult:
    """The answer to a request; nothing is stored.

    Raises a problem where the request is refused, where the solve fails and its file was requested, and, with status
    409, where its samples are gone. Raises :class:`~equimesh_service.errors.TimeLimitError`.
    """
    with log_context.enter(log_context.LogContext(request_id=task.request_id, key_id=task.caller.key_id)):
        try:
            with storage_faults():
                return _compute(task)
        except (Problem, TimeLimitError):
            raise
        except Exception as error:
            _log.error("the computation of a mesh broke", exc_info=error)  # only the worker knows where
            raise


def _compute(task: Computation) -> ComputationResult:
    began, stopwatch = time.perf_counter(), Stopwatch()
    document, upload, mesh = take_apart(task.content_type, task.body)
    admission = _Admission.of(task)
    admitted = admission.receive(document, upload, task.caller, mesh)
    if task.format not in (None, DRAWING):
        check_format(task.format, admitted.spec)
    spec = admitted.problem
    stopwatch.lap("check")
    frames = None
    if task.frames and spec.grid_schwarz is not None:
        frames = Frames(spec.problem.grid.points)
    observe = _Limit(until=began + task.seconds, frames=frames)
    solving = time.perf_counter()
    try:
        with translate_errors():
            solution = spec.solve(threads=task.settings.worker_threads, observe=observe, check=False)
    except Problem as problem:
        if not problem.errors or len(document) > MAX_SHORT_BYTES:
            raise
        raise repointed(problem, partial(sent_pointer, parse(document))) from None
    seconds = time.perf_counter() - solving
    stopwatch.lap("solve")
    certificate = solution.certificate.summary()
    if task.format in (None, DRAWING):
        said = document_of_solution(admitted.spec, solution, seconds)
        content = _text(said) if task.format is None else draw_solution(said, solution, frames)
    else:
        content = _file(task.format, admitted, solution)
    stopwatch.lap("answer")
    failure = None if solution.status.succeeded else problem_of(solution, is_kept=False)
    _log.info("a mesh that is not kept %s, solved in %.3f s", "failed" if failure else "succeeded", seconds)
    return ComputationResult(
        content=content,
        certificate=_text(certificate).decode(),
        ending=Ending(
            status="succeeded" if failure is None else "failed",
            reason="" if failure is None else failure.name,
            points=solution.mesh.x.size,
            solve_seconds=seconds,
            laps=stopwatch.laps,
            uploads=(upload is not None) + (mesh is not None),
        ),
    )


@dataclass(frozen=True, kw_only=True)
class _Limit:
    """Ends a solve at a time of `time.perf_counter`. Without ``frames`` the solver makes no records before."""

    until: float
    frames: Frames | None

    def is_due(self) -> bool:
        """Whether the solver is to call this."""
        return self.frames is not None or time.perf_counter() > self.until

    def __call__(self, event: equimesh.Event) -> None:
        """Take a record; raises :class:`~equimesh_service.errors.TimeLimitError`."""
        if time.perf_counter() > self.until:
            raise TimeLimitError("the time limit was reached")
        if self.frames is not None:
            self.frames(event)


def answer(request: Request) -> FinishedMesh | Ending | NoMesh | None:
    """Admit a request and compute its mesh; None when the attempt was lost meanwhile.

    :class:`~equimesh_service.store.rows.NoMesh` has the reason of a refusal. It has the admitted spec where an earlier
    mesh may be the answer, where a cluster computes the mesh in parts, and where there may be no room for it: the
    service knows which meshes are still in flight. It has neither where the service is to check a step.
    """
    claim = request.claim
    with log_context.enter(log_context_of(claim)), attempt(claim):
        try:
            with storage_faults():
                return _answer(request)
        except AttemptLostError:
            return None
        except KeyTakenError as error:
            return NoMesh(earlier=error.mesh_id)
        except (KeyReusedError, QuotaError, SamplesGoneError, StepTakenError) as error:
            return NoMesh(error=error)
        except Problem:
            raise
        except Exception as error:
            _log.error("mesh %s: the solve broke", claim.mesh_id, exc_info=error)  # only the worker knows where
            raise


def _answer(request: Request) -> FinishedMesh | Ending | NoMesh | None:
    began, stopwatch = time.perf_counter(), Stopwatch()
    store, files = request.storage.store(), request.storage.files()
    begin, claim = _begin_mesh if request.place is None else _begin_step, request.claim
    try:
        begun = begin(request, store, files)
    except Problem as problem:
        if problem.name == "unavailable":
            raise
        return NoMesh(error=problem)
    if isinstance(begun, NoMesh):
        return begun
    stopwatch.lap("check")
    work, entry, uploads = begun
    _log.info("mesh %s starts, attempt %d", claim.mesh_id, claim.attempt)
    at_work = Attempt(store, claim, entry, request.lease, request.quota, files, began)
    at_work.enter_if_late()
    threads = request.settings.worker_threads
    try:
        end = solve_work(work, at_work, files, stopwatch, threads=threads, hands_over=True)
    except Problem as problem:
        if problem.name == "unavailable":
            raise
        end = _failed(problem, at_work, time.perf_counter() - began)
    return _with_uploads(end, uploads)


def _begin_mesh(request: Request, store: Store, files: BlobFiles) -> tuple[Work, NewEntry, int] | NoMesh:
    """The work of a request for a mesh, and its files that came with it; raises its problems."""
    admitted = admit(request.content_type, request.body, request.caller, Admission(request.settings, store, files))
    if request.format is not None:
        check_format(request.format, admitted.spec)
    caller, new = request.caller, admitted.new_mesh(request.claim, request.format)
    may_reuse = request.reuse and request.settings.reuse and store.meshes.has_equal(new)
    if may_reuse or admitted.is_in_parts or store.meshes.has_key(caller.key_id, request.key):
        return NoMesh(admitted=replace(admitted, built=None))
    if request.quota is not None and not store.quotas.fits(caller.key_id, new.points, request.quota):
        return NoMesh(admitted=replace(admitted, built=None))
    fingerprint = admitted.fingerprint(request.format)
    entry = NewEntry(new=new, samples=admitted.upload, key=request.key, fingerprint=fingerprint)
    mesh_input = MeshInput(spec=new.spec, samples=admitted.samples, format=request.format)
    return Work(mesh_input=mesh_input, spec=admitted.problem), entry, admitted.uploads


def _begin_step(request: Request, store: Store, files: BlobFiles) -> tuple[Work, NewEntry, int] | NoMesh:
    """The work of a step that follows the mesh at its place; of others the service finds out what they follow.

    Raises its problems.
    """
    place, caller, admission = request.place, request.caller, Admission(request.settings, store, files)
    assert place is not None
    if request.content_type == NPZ:
        move = read_arrays(request.body, max_bytes(request.settings, place.points))
    else:
        move = read_json(request.body)
    if move.step != place.number:
        return NoMesh()
    with ExitStack() as stack:
        made = StepAdmission(admission, store, files).prepare(move, place.mesh_id, caller, stack)
    if request.format is not None:
        check_format(request.format, made.admitted.spec)
    new = replace(made.admitted.new_mesh(request.claim, request.format), fingerprint=None)
    fits = request.quota is None or store.quotas.fits(caller.key_id, new.points, request.quota)
    if not fits or not made.files <= made.contents.keys():
        return NoMesh()
    functions = [(row, publish_nothing) for row, _ in made.functions]
    step = replace(
        made.new_step(place, caller.key_id), publish=publish_nothing, functions=functions, contents=made.contents
    )
    mesh_input = MeshInput(
        spec=new.spec,
        samples=made.admitted.samples,
        format=request.format,
        start=made.start,
        fields=None if made.fields is None else made.fields.sha256,
        settings=made.settings,
    )
    work = build_work(mesh_input, replace(files, not_stored=made.contents), known=made.known)
    return work, NewEntry(new=new, key=request.key, fingerprint=place.fingerprint, step=step), 0


def admit(content_type: str, body: bytes, caller: Caller, admission: Admission) -> AdmittedSpec:
    """The admitted spec of a request, with its problem; raises its problems."""
    document, upload, mesh = take_apart(content_type, body)
    admitted = admission.receive(document, upload, caller, mesh)
    return replace(admitted, uploads=(upload is not None) + (mesh is not None))


def _failed(problem: Problem, at_work: Attempt, seconds: float) -> FinishedMesh:
    """The end of a mesh whose solve the solver has refused."""
    ending = Ending(status=FAILED, reason=problem.name)
    outcome = Outcome(error=problem.body())
    return FinishedMesh(outcome=outcome, contents={}, ending=ending, seconds=seconds, entry=at_work.entry)


def _with_uploads(end: FinishedMesh | Ending | None, uploads: int) -> FinishedMesh | Ending | None:
    if isinstance(end, FinishedMesh):
        return replace(end, ending=replace(end.ending, uploads=uploads))
    return None if end is None else replace(end, uploads=uploads)


def _text(document: Mapping[str, Any]) -> bytes:
    return json.dumps(document, allow_nan=False).encode()


def _file(format: str, admitted: AdmittedSpec, solution: AnySolution) -> bytes:
    """The file of a mesh; raises the problem of a solve that failed."""
    if not solution.status.succeeded:
        raise problem_of(solution, is_kept=False)
    return mesh_bytes(solution.data(), format=format, cells=admitted.spec["cells"])


@dataclass(frozen=True, kw_only=True)
class _Admission(Admission):
    """Checks a request in the worker that solves it. ``sent`` gets what came with it, as npz files by their ids."""

    is_preview: bool
    sent: dict[str, bytes] = field(default_factory=dict)

    @classmethod
    def of(cls, task: Computation) -> _Admission:
        """The checks with the limits of previews, or of other meshes that one machine computes."""
        settings, is_preview = task.settings, task.format == DRAWING
        most = min(settings.max_points, settings.max_preview_points) if is_preview else settings.max_points
        return cls(
            settings=settings.model_copy(update={"max_points": most, "max_cluster_points": 0}),
            store=task.storage.store(),
            files=task.storage.files(),
            is_preview=is_preview,
        )

    @property
    def _product(self) -> str:
        return "a preview" if self.is_preview else super()._product

    @property
    def _way_to_more(self) -> str:
        return "; request the mesh itself (POST /v1/meshes), which may have more" if self.is_preview else ""

    def _admit(
        self, short: ShortSpec, upload: Upload | None, caller: Caller, mesh: Upload | None = None
    ) -> AdmittedSpec:
        if short.spec.spec.parts is not None and not self.is_preview:
            message = "a mesh in parts is files that a cluster keeps: leave parts out, or leave out store=false"
            raise problem_at("/parts", message)
        return super()._admit(replace(short, spec=short.spec.whole()), upload, caller, mesh)

    def _check(self, spec: CheckedSpec, rows: Mapping[str, SamplesRow], sent: Mapping[str, Path]) -> BuiltSpec:
        own = {name: _arrays(content) for name, content in self.sent.items()}
        with self._found({name: row for name, row in rows.items() if name not in own}) as stored:
            return check(spec.canonical, {**stored, **own, **sent})

    def _keep(self, path: Path, summary: dict[str, Any], caller: Caller, *, durable: bool) -> tuple[SamplesRow, bool]:  # noqa: ARG002
        content = path.read_bytes()
        row = intake.row_of(StoredFile(sha256(content).hexdigest(), len(content)), summary, self.store.clock())
        self.sent[row.id] = content
        return row, True


def _arrays(content: bytes) -> Mapping[str, Any]:
    with np.load(BytesIO(content), allow_pickle=False) as arrays:
        return dict(arrays)
