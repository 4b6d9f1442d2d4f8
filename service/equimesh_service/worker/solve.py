"""The solve of one mesh in a worker process, from its spec in the store to its files."""

from __future__ import annotations

import contextvars
import json
import logging
import math
import pickle
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

import equimesh
from equimesh.errors import InputError
from equimesh.io.npz import load_npz
from equimesh.io.write import write_mesh
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.solving.status import SolveArguments
from equimesh.specs import build_field
from equimesh.specs.spec import BuiltSpec
from equimesh_service.assembly.bodies import StepField, read_fields
from equimesh_service.assembly.problem import SamplesOf, build, translate_errors
from equimesh_service.assembly.samples import field_of
from equimesh_service.errors import AttemptLostError, KeyReusedError, SamplesGoneError
from equimesh_service.files.port import Files, Publish, Removed, StoredFile, publish_nothing
from equimesh_service.problems.problem import Problem
from equimesh_service.problems.storage import storage_faults
from equimesh_service.store.blobs import MAX_ROW_BYTES
from equimesh_service.store.rows import (
    SUCCEEDED,
    Artifact,
    Claim,
    Ending,
    FinishedMesh,
    MeshInput,
    NewSamples,
    Outcome,
    RefusedDraft,
    RepeatedDraft,
)
from equimesh_service.store.store import Store
from equimesh_service.telemetry import log_context, tracing
from equimesh_service.telemetry.stopwatch import Stopwatch
from equimesh_service.worker.in_parts import solve_in_parts
from equimesh_service.worker.job import CONVERGENCE, MESH, Job, attempt, file_name, log_context_of
from equimesh_service.worker.reporter import Reporter
from equimesh_service.worker.summary import AnySolution, problem_of, summary_of


class Output:
    """Files that are written but not yet published; with ``in_threads`` each in a thread of its own."""

    def __init__(self, files: Files, stack: ExitStack, *, in_threads: bool) -> None:
        self._files = files
        self._stack = stack
        self._in_threads = in_threads
        self._names: list[str] = []
        self._sealed: list[tuple[Path, Callable[[], StoredFile]]] = []

    def json(self, name: str, value: Any) -> None:
        """Write a JSON document."""
        self.write(name, ".json", lambda path: path.write_text(json.dumps(value, allow_nan=False)))

    def write(self, name: str, suffix: str, write: Callable[[Path], object]) -> None:
        """Write a file by ``write``."""
        path = self._stack.enter_context(self._files.unfinished(suffix))

        def seal() -> StoredFile:
            write(path)
            return self._files.seal(path)

        self._names.append(name)
        self._sealed.append((path, self._begin(seal) if self._in_threads else _run_now(seal)))

    def _begin(self, seal: Callable[[], StoredFile]) -> Callable[[], StoredFile]:
        # The thread is joined before its file is removed, also on failure.
        thread = self._stack.enter_context(ThreadPoolExecutor(1))
        try:
            return thread.submit(contextvars.copy_context().run, seal).result
        except RuntimeError:  # there is no memory for a thread; there may be enough without one
            return _run_now(seal)

    def artifacts(self) -> list[Artifact]:
        """All files, once they are written."""
        files = [sealed() for _, sealed in self._sealed]
        return [Artifact(name, file.sha256, file.size) for name, file in zip(self._names, files, strict=True)]

    def small_contents(self) -> dict[str, bytes]:
        """The bytes of all small files, by their SHA-256."""
        files = [(path, sealed()) for path, sealed in self._sealed]
        return {file.sha256: path.read_bytes() for path, file in files if file.size <= MAX_ROW_BYTES}

    def publish(self, removed: Removed) -> None:
        """Publish all files."""
        for path, sealed in self._sealed:
            self._files.publish(path, sealed(), removed)


def _run_now(seal: Callable[[], StoredFile]) -> Callable[[], StoredFile]:
    file = seal()
    return lambda: file


# The names of the displacement in files: the first that is not the name of a field.
VELOCITIES = ("velocity", "mesh_velocity")
# The settings of a step that a sequence takes.
MOTION = ("smoothing", "max_move", "outrun")
AnySequenceStep: TypeAlias = equimesh.SequenceStep[Any]
"""A step on a grid, or on blocks."""


@dataclass(frozen=True, kw_only=True)
class StepStart:
    """The mesh of the step before, the fields on it, what else is known of it, and how the mesh is to move."""

    mesh: equimesh.Mesh | QuadMesh
    fields: Mapping[str, StepField]
    earlier: equimesh.Earlier | None
    motion: Mapping[str, Any]

    @classmethod
    def of(cls, mesh_input: MeshInput, spec: BuiltSpec, files: Files) -> StepStart | None:
        """The start of a step; None for the first step, and for a mesh that is no step."""
        if mesh_input.start is None:
            return None
        try:
            with files.local(mesh_input.start) as path:
                mesh = load_npz(path).mesh
        except FileNotFoundError:
            raise Problem("conflict", "The mesh that this step starts from was deleted.") from None
        fields: Mapping[str, StepField] = {}
        if mesh_input.fields is not None:
            with files.local(mesh_input.fields) as path:
                fields = read_fields(path)
        settings = mesh_input.settings or {}
        motion = {name: settings[name] for name in MOTION if name in settings}
        return cls(mesh=mesh, fields=fields, earlier=_earlier(settings.get("before"), spec, files), motion=motion)

    def take(self, spec: BuiltSpec, options: SolveArguments) -> AnySequenceStep:
        """The step to the problem of ``spec``; raises :class:`~equimesh.errors.InputError` where it is refused."""
        fields = {name: field.mesh_values() for name, field in self.fields.items()}
        settings: SolveArguments = {**spec.ending, **options}
        sequence = equimesh.Sequence[Any](
            spec.problem,
            spec.schwarz,
            mesh=self.mesh,
            solution=self.earlier,
            **self.motion,
            **settings,
        )
        return sequence.step(spec.problem.monitor, fields)

    def arrived(self, data: equimesh.MeshData, step: AnySequenceStep) -> equimesh.MeshData:
        """The data of the new mesh with its displacement, the fields carried to it, and the JSON of the step."""
        name = next((name for name in VELOCITIES if name not in self.fields), None)
        at_nodes = {key: values for key, values in step.fields.items() if self.fields[key].location == "nodes"}
        in_cells = {key: values for key, values in step.fields.items() if key not in at_nodes}
        moved = {} if name is None or step.velocity is None else {name: step.velocity}
        return replace(
            data,
            fields={**at_nodes, **moved},
            cell_fields=in_cells,
            step=json.dumps(self._answer(step, name if moved else None), allow_nan=False),
        )

    def _answer(self, step: AnySequenceStep, velocity: str | None) -> dict[str, Any]:
        """The record of the step, with the name of its displacement, and with the transfer of each field."""
        certificate = certificate_of(step)
        fields = {
            name: {"transfer": field.transfer, "location": field.location, "bounds": field.bounds}
            for name, field in self.fields.items()
        }
        said = {"status": SUCCEEDED, "certificate": certificate, "warnings": certificate["warnings"]}
        return {**said, **moves_of(step), "velocity": velocity, "fields": fields}


def certificate_of(step: AnySequenceStep) -> dict[str, Any]:
    """The certificate of the mesh of a step, with the warnings of the step."""
    return {**step.certificate.summary(), "warnings": list(step.warnings)}


def moves_of(step: AnySequenceStep) -> dict[str, Any]:
    """The number of substeps, and how far the nodes moved, in cells."""
    return {"substeps": step.substeps, "moved": step.moved}


def _earlier(before: Mapping[str, Any] | None, spec: BuiltSpec, files: Files) -> equimesh.Earlier | None:
    """The source and the gains of the mesh before; None for steps of earlier releases."""
    if before is None:
        return None
    norm = getattr(spec.problem.monitor, "norm", "l2")
    gain = before["gains"].get(norm)
    return equimesh.Earlier(u=_u_of(before, spec, files), gain=math.nan if gain is None else float(gain))


def _u_of(before: Mapping[str, Any], spec: BuiltSpec, files: Files) -> equimesh.Field | None:
    """The u of the mesh before; None where it has none, or where its samples are gone."""
    source = before["u"]
    if source is None:
        return None

    def find(_name: str, box: Any) -> equimesh.Field:
        with files.local(before["samples"]) as path:
            return field_of(path, box)

    try:
        return build_field(source, spec.problem.domain, find, "u")
    except (FileNotFoundError, InputError):
        return None


_log = logging.getLogger(__name__)
# The least number of points for which files are written in threads.
MIN_POINTS_FOR_THREADS = 100_000


def solve_mesh(job: Job) -> FinishedMesh | Ending | RepeatedDraft | RefusedDraft | None:
    """Compute the mesh of ``job``; returns its end, or None when the attempt was lost meanwhile.

    A :class:`FinishedMesh` is not in the store yet: the service stores it. A draft may belong to an earlier mesh of the
    same idempotency key, or be refused by the store.
    """
    with log_context.enter(log_context_of(job.claim)), attempt(job.claim):
        try:
            with storage_faults():
                return _solve(job)
        except AttemptLostError:
            return None
        except (KeyReusedError, SamplesGoneError) as error:
            return RefusedDraft(error)
        except Problem:
            raise
        except Exception as error:
            _log.error("mesh %s: the solve broke", job.claim.mesh_id, exc_info=error)  # only the worker knows where
            raise


def samples_of(mesh_input: MeshInput, files: Files, stack: ExitStack) -> SamplesOf:
    """The function that finds the files of samples, which last until ``stack`` closes."""

    def path(samples_id: str) -> Path:
        if samples_id not in mesh_input.samples:
            raise Problem("conflict", "The samples of this mesh were deleted.")
        return stack.enter_context(files.local(mesh_input.samples[samples_id]))

    return path


@dataclass(frozen=True, kw_only=True)
class _Work:
    """The work of an attempt: the problem of a spec, the settings of its solve, and the start of a step."""

    mesh_input: MeshInput
    spec: BuiltSpec
    start: StepStart | None


def _solve(job: Job) -> FinishedMesh | Ending | RepeatedDraft | None:
    began, stopwatch = time.perf_counter(), Stopwatch()
    store, files = job.storage.store(), job.storage.files()
    work = _build(job, store, files)
    stopwatch.lap("build")
    if work.spec.parts is not None:
        return solve_in_parts(job, work.spec, store, work.mesh_input.format)
    presence = _Presence(store, job.claim, work.mesh_input.draft is None)
    reporter = Reporter(work.spec.grid_schwarz, presence.report)
    with tracing.span("solve"):
        solution, step = _compute(work, job.threads, reporter)
    solved = time.perf_counter()
    stopwatch.lap("solve")
    reporter.writing()
    with tracing.span("write"), ExitStack() as stack:
        output = Output(files, stack, in_threads=solution.mesh.x.size >= MIN_POINTS_FOR_THREADS)
        result = _write(work, (solution, step), output, (reporter, stopwatch))
        artifacts = output.artifacts()
        result["timings"] = {"solve": solved - began, "write": time.perf_counter() - solved}
        failure = None if solution.status.succeeded else problem_of(solution)
        outcome = Outcome(
            error=None if failure is None else failure.body(),
            result=result,
            files=artifacts,
            partial=failure is not None and not solution.mesh.is_folded,
            publish=output.publish,
        )
        contents = output.small_contents()
        ending = Ending(
            status=outcome.status,
            reason="" if failure is None else failure.name,
            points=solution.mesh.x.size,
            solve_seconds=solved - began,
            files=tuple(artifacts),
            content=_requested(job, artifacts, contents, work.spec.cells),
            laps=stopwatch.laps,
        )
        stopwatch.lap("file")
        _log.info("mesh %s %s, solved in %.3f s", job.claim.mesh_id, outcome.status, solved - began)
        if job.hands_over and len(contents) == len({file.sha256 for file in artifacts}) and _brings_little(job):
            return FinishedMesh(
                outcome=replace(outcome, publish=publish_nothing),
                contents=contents,
                ending=ending,
                seconds=time.perf_counter() - began,
                entered=presence.known,
            )
        kept = _keep(job, outcome, files, seconds=time.perf_counter() - began, entered=presence.known)
        stopwatch.lap("commit")
    if kept is None:
        return None
    if kept != job.claim.mesh_id:
        return RepeatedDraft(kept)
    return ending


def _requested(job: Job, artifacts: list[Artifact], contents: Mapping[str, bytes], cells: str) -> bytes | None:
    """The bytes of the file that a request waits for; None for a large one, which it reads piece by piece."""
    requested = None if job.mesh_input is None else job.mesh_input.format
    if requested is None:
        return None
    name = file_name(requested, cells)
    return next((contents.get(file.sha256) for file in artifacts if file.name == name), None)


def _brings_little(job: Job) -> bool:
    """Whether the samples that came with a draft are a small file, too."""
    draft = None if job.mesh_input is None else job.mesh_input.draft
    return draft is None or draft.samples is None or len(draft.samples.archive) <= MAX_ROW_BYTES


def _keep(job: Job, outcome: Outcome, files: Files, *, seconds: float, entered: bool) -> str | None:
    """Put the outcome into the store; the id of the mesh there, None when the attempt was lost meanwhile."""
    draft = None if job.mesh_input is None else job.mesh_input.draft
    if draft is None:
        return job.claim.mesh_id if job.storage.store().queue.finish(job.claim, outcome) else None
    with ExitStack() as stack:
        publish = publish_nothing if draft.samples is None else _seal_samples(draft.samples, files, stack)
        # Nothing was promised for a draft before, so its only commit waits for the disk.
        drafts = job.storage.store().drafts
        return drafts.finish(draft, job.claim, outcome, seconds=seconds, publish_samples=publish, entered=entered)


def _seal_samples(samples: NewSamples, files: Files, stack: ExitStack) -> Publish:
    """Write the file of samples; returns the function that publishes it."""
    path = stack.enter_context(files.unfinished(".npz"))
    path.write_bytes(samples.archive)
    return partial(files.publish, path, files.seal(path))


def _build(job: Job, store: Store, files: Files) -> _Work:
    """Read the input of a mesh and build its problem; raises :class:`AttemptLostError` for a mesh that is gone."""
    mesh_input = job.mesh_input or store.meshes.get_input(job.claim.mesh_id)
    if mesh_input is None:
        raise AttemptLostError
    if mesh_input.draft is not None:
        return _Work(mesh_input=mesh_input, spec=mesh_input.draft.built, start=None)
    if job.packed is not None:
        spec: BuiltSpec = pickle.loads(job.packed)
    else:
        with ExitStack() as samples:
            spec = build(mesh_input.spec, samples_of(mesh_input, files, samples))
    return _Work(mesh_input=mesh_input, spec=spec, start=StepStart.of(mesh_input, spec, files))


@dataclass
class _Presence:
    """Whether the mesh of an attempt is ``known`` to be in the store, which a draft is only after a while."""

    store: Store
    claim: Claim
    known: bool

    def report(self, progress: Mapping[str, Any]) -> bool:
        """Store the progress; False when the attempt is lost. A draft that was never in the store is not lost."""
        # Looked at before the progress is stored: a draft may be entered at any moment.
        self.known = self.known or self.store.drafts.exists(self.claim.mesh_id)
        return self.store.queue.progress(self.claim, progress) if self.known else True


def _compute(work: _Work, threads: int, reporter: Reporter) -> tuple[AnySolution, AnySequenceStep | None]:
    """The solution, and the step that it is; None for a mesh that is no step, and for one that failed."""
    spec = work.spec
    with translate_errors():
        if work.start is None:
            return spec.solve(threads=threads, observe=reporter, check=False), None
        step = work.start.take(spec, {"threads": threads, "observe": reporter, "check": False})
    return step.solution, step if step.status.succeeded else None


def _write(
    work: _Work,
    computed: tuple[AnySolution, AnySequenceStep | None],
    output: Output,
    watching: tuple[Reporter, Stopwatch],
) -> dict[str, Any]:
    """Begin to write all files; returns the summary of the solution, measured meanwhile."""
    (solution, step), (reporter, stopwatch) = computed, watching
    if work.spec.schwarz is not None or solution.descent:
        output.json(CONVERGENCE, solution.convergence())
    quality = None
    if not solution.mesh.is_folded:
        data, requested = solution.data(), work.mesh_input.format
        if work.start is not None and step is not None:
            data = work.start.arrived(data, step)
        stopwatch.lap("quality")
        output.write(MESH, ".npz", lambda path: write_mesh(path, data, format="npz"))
        cells = work.spec.cells
        if requested is not None and (requested, cells) != ("npz", "quad"):
            write = partial(write_mesh, data=data, format=requested, cells=cells)
            output.write(file_name(requested, cells), f".{requested}", write)
        stopwatch.lap("file")
        reporter.measuring()
        quality = solution.quality.summary()
    certificate = solution.certificate.summary() if step is None else certificate_of(step)
    result = {"solution": summary_of(solution), "quality": quality, "certificate": certificate}
    if step is not None:
        result["step"] = moves_of(step)
    stopwatch.lap("quality")
    if work.spec.target is None or solution.problem.grid is None:
        return result
    return {**result, "grid": [*solution.problem.grid.shape]}
