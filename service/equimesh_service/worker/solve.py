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
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

import equimesh
from equimesh.errors import InputError
from equimesh.io.formats import Cells
from equimesh.io.npz import load_mesh
from equimesh.io.write import mesh_bytes, write_mesh
from equimesh.solving.status import SolveArguments
from equimesh.specs import build_field
from equimesh.specs.spec import BuiltSpec
from equimesh_service.assembly.bodies import StepField, read_fields
from equimesh_service.assembly.problem import SamplesOf, build, translate_errors
from equimesh_service.assembly.samples import field_of
from equimesh_service.errors import AttemptLostError, KeyTakenError
from equimesh_service.files.port import Files, Removed, StoredFile, publish_nothing
from equimesh_service.problems.problem import Problem
from equimesh_service.problems.storage import storage_faults
from equimesh_service.store.blobs import MAX_ROW_BYTES, BlobFiles, insert_blob
from equimesh_service.store.keys import Quota
from equimesh_service.store.rows import (
    SUCCEEDED,
    Artifact,
    Claim,
    Ending,
    FinishedMesh,
    Lease,
    MeshInput,
    NewEntry,
    NewStep,
    Outcome,
)
from equimesh_service.store.store import Store
from equimesh_service.store.writer import with_contents
from equimesh_service.telemetry import log_context, tracing
from equimesh_service.telemetry.stopwatch import Stopwatch
from equimesh_service.worker.in_parts import solve_in_parts
from equimesh_service.worker.job import CONVERGENCE, MESH, Job, attempt, file_name, log_context_of
from equimesh_service.worker.recent import FUNCTIONS, MESHES, KnownStep, as_read
from equimesh_service.worker.reporter import Reporter
from equimesh_service.worker.summary import problem_of, summary_of

if TYPE_CHECKING:
    from equimesh_service.worker.summary import AnySolution


class Output:
    """Files that are made but not yet published: in memory, or with ``in_threads`` on disk, each in a thread."""

    def __init__(self, files: BlobFiles, stack: ExitStack, *, in_threads: bool) -> None:
        self._files = files
        self._stack = stack
        self._in_threads = in_threads
        self._names: list[str] = []
        self._sealed: list[Callable[[], _Sealed]] = []

    def json(self, name: str, value: Any) -> None:
        """Add a JSON document."""
        self._add(name, partial(self._keep, ".json", json.dumps(value, allow_nan=False).encode()))

    def mesh(self, name: str, data: equimesh.MeshData, *, format: str, cells: Cells = "quad") -> None:
        """Add the file of a mesh."""
        suffix = f".{format}"
        if not self._in_threads:
            self._add(name, partial(self._keep, suffix, mesh_bytes(data, format=format, cells=cells)))
            return
        path = self._stack.enter_context(self._files.unfinished(suffix))

        def seal() -> _Sealed:
            write_mesh(path, data, format=format, cells=cells)
            return _Sealed(self._files.seal(path), path)

        self._add(name, self._begin(seal))

    def _add(self, name: str, sealed: Callable[[], _Sealed]) -> None:
        self._names.append(name)
        self._sealed.append(sealed if self._in_threads else _run_now(sealed))

    def _keep(self, suffix: str, content: bytes) -> _Sealed:
        """A small file as its bytes, a larger one on disk."""
        if len(content) <= MAX_ROW_BYTES:
            return _Sealed(StoredFile(sha256(content).hexdigest(), len(content)), content)
        path = self._stack.enter_context(self._files.unfinished(suffix))
        path.write_bytes(content)
        return _Sealed(self._files.seal(path), path)

    def _begin(self, seal: Callable[[], _Sealed]) -> Callable[[], _Sealed]:
        # The thread is joined before its file is removed, also on failure.
        thread = self._stack.enter_context(ThreadPoolExecutor(1))
        try:
            return thread.submit(contextvars.copy_context().run, seal).result
        except RuntimeError:  # there is no memory for a thread; there may be enough without one
            return _run_now(seal)

    def artifacts(self) -> list[Artifact]:
        """All files, once they are made."""
        files = [sealed().file for sealed in self._sealed]
        return [Artifact(name, file.sha256, file.size) for name, file in zip(self._names, files, strict=True)]

    def small_contents(self) -> dict[str, bytes]:
        """The bytes of all small files, by their SHA-256."""
        made = [sealed() for sealed in self._sealed]
        return {one.file.sha256: one.content for one in made if one.file.size <= MAX_ROW_BYTES}

    def publish(self, removed: Removed) -> None:
        """Publish all files."""
        for sealed in self._sealed:
            made = sealed()
            if isinstance(made.place, bytes):
                insert_blob(self._files.database, made.file.sha256, made.place)
            else:
                self._files.publish(made.place, made.file, removed)


@dataclass(frozen=True)
class _Sealed:
    """A file that is made, in memory or on disk."""

    file: StoredFile
    place: bytes | Path

    @property
    def content(self) -> bytes:
        return self.place if isinstance(self.place, bytes) else self.place.read_bytes()


def _run_now(seal: Callable[[], _Sealed]) -> Callable[[], _Sealed]:
    made = seal()
    return lambda: made


# The names of the displacement in files: the first that is not the name of a field.
VELOCITIES = ("velocity", "mesh_velocity")
# The settings of a step that a sequence takes.
MOTION = ("smoothing", "max_move", "outrun")
AnySequenceStep: TypeAlias = equimesh.SequenceStep
"""A step on a grid, or on blocks."""


@dataclass(frozen=True, kw_only=True)
class StepStart:
    """The mesh of the step before, the fields on it, what else is known of it, and how the mesh is to move."""

    mesh: equimesh.Mesh
    fields: Mapping[str, StepField]
    earlier: equimesh.Earlier | None
    motion: Mapping[str, Any]

    @classmethod
    def of(
        cls, mesh_input: MeshInput, spec: BuiltSpec, files: BlobFiles, known: KnownStep | None = None
    ) -> StepStart | None:
        """The start of a step; None for the first step, and for a mesh that is no step."""
        if mesh_input.start is None:
            return None
        if known is None:
            mesh, fields = _read_mesh(files, mesh_input.start), _read_fields(files, mesh_input.fields)
        else:
            mesh, fields = known.mesh, known.own_fields()
        settings = mesh_input.settings or {}
        motion = {name: settings[name] for name in MOTION if name in settings}
        return cls(mesh=mesh, fields=fields, earlier=_earlier(settings.get("before"), spec, files), motion=motion)

    def take(self, spec: BuiltSpec, options: SolveArguments) -> AnySequenceStep:
        """The step to the problem of ``spec``; raises :class:`~equimesh.errors.InputError` where it is refused."""
        fields = {name: field.mesh_values() for name, field in self.fields.items()}
        settings: SolveArguments = {**spec.ending, **options}
        sequence = equimesh.Sequence(
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


def _read_mesh(files: BlobFiles, sha256: str) -> equimesh.Mesh:
    def read() -> equimesh.Mesh:
        with files.opened(sha256) as stream:
            return load_mesh(stream)

    try:
        found: equimesh.Mesh = MESHES.get(sha256, read, partial(files.require, sha256))
    except FileNotFoundError:
        raise Problem("conflict", "The mesh that this step starts from was deleted.") from None
    return found


def _read_fields(files: BlobFiles, sha256: str | None) -> Mapping[str, StepField]:
    if sha256 is None:
        return {}
    with files.opened(sha256) as stream:
        return read_fields(stream)


def _read_function(files: BlobFiles, sha256: str, box: Any) -> equimesh.Field:
    with files.opened(sha256) as stream, np.load(stream, allow_pickle=False) as arrays:
        return field_of(dict(arrays), box)


def _earlier(before: Mapping[str, Any] | None, spec: BuiltSpec, files: BlobFiles) -> equimesh.Earlier | None:
    """The source and the gains of the mesh before; None for steps of earlier releases."""
    if before is None:
        return None
    norm = getattr(spec.problem.monitor, "norm", "l2")
    gain = before["gains"].get(norm)
    return equimesh.Earlier(u=_u_of(before, spec, files), gain=math.nan if gain is None else float(gain))


def _u_of(before: Mapping[str, Any], spec: BuiltSpec, files: BlobFiles) -> equimesh.Field | None:
    """The u of the mesh before; None where it has none, or where its samples are gone."""
    source = before["u"]
    if source is None:
        return None

    def find(_name: str, box: Any) -> equimesh.Field:
        name = before["samples"]
        read, require = partial(_read_function, files, name, box), partial(files.require, name)
        found: equimesh.Field = FUNCTIONS.get((name, box), read, require)
        return found

    try:
        return build_field(source, spec.problem.domain, find, "u")
    except (FileNotFoundError, InputError):
        return None


_log = logging.getLogger(__name__)
_NO_SAMPLES = "The samples of this mesh were deleted."
# The least number of points for which files are written in threads.
MIN_POINTS_FOR_THREADS = 100_000
# A mesh that takes longer is entered into the store, where it can be listed, canceled and retried.
MAX_SHORT_SECONDS = 0.2


def solve_mesh(job: Job) -> FinishedMesh | Ending | None:
    """Compute the mesh of ``job``; returns its end, or None when the attempt was lost meanwhile.

    A :class:`FinishedMesh` is not in the store yet: the service stores it.
    """
    with log_context.enter(log_context_of(job.claim)), attempt(job.claim):
        try:
            with storage_faults():
                return _solve(job)
        except AttemptLostError:
            return None
        except Problem:
            raise
        except Exception as error:
            _log.error("mesh %s: the solve broke", job.claim.mesh_id, exc_info=error)  # only the worker knows where
            raise


def samples_of(mesh_input: MeshInput, files: Files, stack: ExitStack) -> SamplesOf:
    """The function that finds the files of samples, which last until ``stack`` closes."""

    def path(samples_id: str) -> Path:
        if samples_id not in mesh_input.samples:
            raise Problem("conflict", _NO_SAMPLES)
        return stack.enter_context(files.local(mesh_input.samples[samples_id]))

    return path


@dataclass(frozen=True, kw_only=True)
class Work:
    """The work of an attempt: the problem of a spec, the settings of its solve, and the start of a step."""

    mesh_input: MeshInput
    spec: BuiltSpec
    start: StepStart | None = None


@dataclass
class Attempt:
    """The mesh of an attempt in the store.

    One with an ``entry`` is not there. It is entered, as claimed by the ``lease``, at the first report of progress
    :data:`MAX_SHORT_SECONDS` after it ``began``: so a small mesh enters the store once, finished.
    """

    store: Store
    claim: Claim
    entry: NewEntry | None = None
    lease: Lease | None = None
    quota: Quota | None = None
    files: BlobFiles | None = None
    began: float = float("-inf")  # by `time.perf_counter`

    def enter_if_late(self) -> None:
        """:meth:`enter` the mesh, unless it may still be finished soon."""
        if time.perf_counter() - self.began > MAX_SHORT_SECONDS:
            self.enter()

    def enter(self) -> None:
        """Put the mesh into the store, as running.

        Raises :class:`KeyTakenError` where its idempotency key belongs to another mesh, and as
        :meth:`~equimesh_service.store.meshes.MeshesStore.add`.
        """
        if self.entry is None:
            return
        entry, new = self.entry, self.entry.new
        if entry.samples is not None:
            self.store.samples.keep(entry.samples, new.key_id)
        mesh_id = self.store.meshes.add(
            new,
            key=entry.key,
            fingerprint=entry.fingerprint,
            quota=self.quota,
            lease=self.lease,
            step=self._step_of(entry),
        )
        if mesh_id != new.id:
            raise KeyTakenError(mesh_id)
        self.entry = None

    def report(self, progress: Mapping[str, Any]) -> bool:
        """Store the progress; False when the attempt is lost."""
        self.enter_if_late()
        return self.entry is not None or self.store.queue.progress(self.claim, progress)

    def keep(self, outcome: Outcome, seconds: float) -> bool:
        """Put the outcome into the store with its files; False when the attempt was lost meanwhile."""
        if self.entry is None:
            return self.store.queue.finish(self.claim, outcome)
        sent = self.entry.samples
        if sent is not None:
            self.store.samples.keep(sent, self.entry.new.key_id)
        # Nothing was promised for a new mesh before, so its only commit waits for the disk.
        entry = replace(self.entry, samples=None, step=self._step_of(self.entry))
        mesh_id = self.store.meshes.add_finished(entry, outcome, seconds=seconds)
        if mesh_id != self.claim.mesh_id:
            raise KeyTakenError(mesh_id)
        return True

    def _step_of(self, entry: NewEntry) -> NewStep | None:
        """The step of a mesh, whose files are published from their bytes."""
        if entry.step is None or self.files is None:
            return None
        return with_contents(entry.step, self.store, self.files.discard)


def _solve(job: Job) -> FinishedMesh | Ending | None:
    stopwatch = Stopwatch()
    store, files = job.storage.store(), job.storage.files()
    work = _build(job, store, files)
    stopwatch.lap("build")
    if work.spec.parts is not None:
        return solve_in_parts(job, work.spec, store, work.mesh_input.format)
    return solve_work(work, Attempt(store, job.claim), files, stopwatch, threads=job.threads, hands_over=job.hands_over)


def solve_work(
    work: Work, attempt: Attempt, files: BlobFiles, stopwatch: Stopwatch, *, threads: int, hands_over: bool
) -> FinishedMesh | Ending | None:
    """Solve, measure and make the files; the end of the mesh, None when the attempt was lost meanwhile.

    Where it ``hands_over``, small files go back to the service, which puts the mesh into the store.
    """
    reporter, began = Reporter(work.spec.grid_schwarz, attempt.report), time.perf_counter()
    with tracing.span("solve"):
        solution, step = _compute(work, threads, reporter)
    solved = time.perf_counter()
    stopwatch.lap("solve")
    reporter.writing()
    with tracing.span("write"), ExitStack() as stack:
        output = Output(files, stack, in_threads=solution.mesh.x.size >= MIN_POINTS_FOR_THREADS)
        result = _write(work, (solution, step), output, (reporter, stopwatch))
        artifacts, contents = output.artifacts(), output.small_contents()
        result["timings"] = {"solve": solved - began, "write": time.perf_counter() - solved}
        failure = None if solution.status.succeeded else problem_of(solution)
        outcome = Outcome(
            error=None if failure is None else failure.body(),
            result=result,
            files=artifacts,
            partial=failure is not None and not solution.mesh.is_folded,
            publish=output.publish,
        )
        if step is not None:
            made = next(file for file in artifacts if file.name == MESH)
            MESHES.keep(made.sha256, as_read(solution.mesh))
        requested = _requested(work, outcome)
        ending = Ending(
            status=outcome.status,
            reason="" if failure is None else failure.name,
            points=solution.mesh.x.size,
            solve_seconds=solved - began,
            requested=requested,
            content=None if requested is None else contents.get(requested.sha256),
            laps=stopwatch.laps,
        )
        stopwatch.lap("file")
        mesh_id, seconds = attempt.claim.mesh_id, time.perf_counter() - began
        _log.info("mesh %s %s, solved in %.3f s", mesh_id, outcome.status, solved - began)
        if hands_over and len(contents) == len({file.sha256 for file in artifacts}):
            handed = replace(outcome, publish=publish_nothing)
            return FinishedMesh(outcome=handed, contents=contents, ending=ending, seconds=seconds, entry=attempt.entry)
        is_kept = attempt.keep(outcome, seconds)
        stopwatch.lap("commit")
    return ending if is_kept else None


def _requested(work: Work, outcome: Outcome) -> Artifact | None:
    """The file that a request for a successful mesh waits for."""
    if work.mesh_input.format is None or outcome.status != SUCCEEDED:
        return None
    name = file_name(work.mesh_input.format, work.spec.cells)
    return next((file for file in outcome.files if file.name == name), None)


def _build(job: Job, store: Store, files: BlobFiles) -> Work:
    """Read the input of a mesh and build its problem; raises :class:`AttemptLostError` for a mesh that is gone."""
    mesh_input = job.mesh_input or store.meshes.get_input(job.claim.mesh_id)
    if mesh_input is None:
        raise AttemptLostError
    return build_work(mesh_input, files, job.packed)


def build_work(
    mesh_input: MeshInput, files: BlobFiles, packed: bytes | None = None, known: KnownStep | None = None
) -> Work:
    """The problem of a mesh, and the start of a step.

    ``packed`` is the problem where it was built before, and ``known`` what is known of the step.
    """
    if packed is not None:
        spec: BuiltSpec = pickle.loads(packed)
    else:
        with ExitStack() as samples:
            find = samples_of(mesh_input, files, samples)

            def kept(name: str, box: Any) -> equimesh.Field:
                sha256 = mesh_input.samples.get(name)
                if sha256 is None:
                    raise Problem("conflict", _NO_SAMPLES)
                made = None if known is None else known.function(sha256)
                if made is not None:
                    FUNCTIONS.keep((sha256, box), made)
                    return made
                read, require = partial(_read_function, files, sha256, box), partial(files.require, sha256)
                try:
                    found: equimesh.Field = FUNCTIONS.get((sha256, box), read, require)
                except FileNotFoundError:
                    raise Problem("conflict", _NO_SAMPLES) from None
                return found

            spec = build(mesh_input.spec, find, None if mesh_input.start is None else kept)
    return Work(mesh_input=mesh_input, spec=spec, start=StepStart.of(mesh_input, spec, files, known))


def _compute(work: Work, threads: int, reporter: Reporter) -> tuple[AnySolution, AnySequenceStep | None]:
    """The solution, and the step that it is; None for a mesh that is no step, and for one that failed."""
    spec = work.spec
    with translate_errors():
        if work.start is None:
            return spec.solve(threads=threads, observe=reporter, check=False), None
        step = work.start.take(spec, {"threads": threads, "observe": reporter, "check": False})
    return step.solution, step if step.status.succeeded else None


def _write(
    work: Work,
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
        output.mesh(MESH, data, format="npz")
        cells = work.spec.cells
        if requested is not None and (requested, cells) != ("npz", "quad"):
            output.mesh(file_name(requested, cells), data, format=requested, cells=cells)
        stopwatch.lap("file")
        reporter.measuring()
        quality = solution.quality.summary()
    certificate = solution.certificate.summary() if step is None else certificate_of(step)
    result = {"solution": summary_of(solution), "quality": quality, "certificate": certificate}
    if step is not None:
        result["step"] = moves_of(step)
    stopwatch.lap("quality")
    is_round = not solution.mesh.is_grid and isinstance(solution.problem.monitor, equimesh.NodalSolution)
    return {**result, **_chosen(solution)} if is_round or work.spec.target is not None else result


def _chosen(solution: AnySolution) -> dict[str, Any]:
    """The points of a mesh whose document does not tell them; of blocks in one row, with the cells of each block."""
    mesh = solution.mesh
    if mesh.is_grid:
        return {"grid": [*mesh.grid.shape]}
    return {"grid": [mesh.x.size, 1], "blocks": [[n - 1 for n in block.shape] for block in mesh.blocks]}
