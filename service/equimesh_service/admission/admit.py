"""Admission: all checks of a request before its mesh enters the queue."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import CancelledError
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeVar

from equimesh import specs
from equimesh.specs.spec import BuiltSpec
from equimesh.upload.columns import Limits
from equimesh_schema.mesh import Grid
from equimesh_schema.monitors import AnyMonitor, NodalSolution
from equimesh_schema.schwarz import Schwarz
from equimesh_schema.sources import UPLOAD
from equimesh_service.admission.callers import Caller, quota_problem
from equimesh_service.admission.tasks import AdmittedSpec
from equimesh_service.assembly import samples as intake
from equimesh_service.assembly.bodies import MAX_SHORT_BYTES, ShortSpec, SpecLimits, shorten
from equimesh_service.assembly.problem import Samples, check, check_schwarz, translate_errors
from equimesh_service.assembly.samples import MESH, Arrays, convert_mesh
from equimesh_service.assembly.upload import MAX_LIGHT_BYTES, Upload
from equimesh_service.dispatch.worker_line import SideWorkers
from equimesh_service.errors import EngineError, MemoryLimitError, QuotaError, TimeLimitError
from equimesh_service.files.port import Files
from equimesh_service.problems.problem import Problem, problem_at, repointed
from equimesh_service.settings import Settings
from equimesh_service.spec.document import parse, sent_pointer
from equimesh_service.spec.mesh import MESH_PLACE, CheckedSpec, read_spec
from equimesh_service.store.rows import NewSamples, SamplesRow
from equimesh_service.store.store import Store
from equimesh_service.telemetry import log_context

_NO_MESH = "these are samples of a function: upload the file of a mesh with POST /v1/samples?kind=mesh"
_NO_SAMPLES = "this is the mesh of a domain, which has no values: upload samples with POST /v1/samples"


def require_kind(row: SamplesRow, pointer: str) -> SamplesRow:
    """The row itself: samples for a function, a mesh for a domain; raises a 422 problem for one of the other."""
    needs_mesh = pointer == MESH_PLACE
    if (row.summary["kind"] == MESH) != needs_mesh:
        raise problem_at(pointer, _NO_MESH if needs_mesh else _NO_SAMPLES)
    return row


def count_points(checked: CheckedSpec, rows: Mapping[str, SamplesRow]) -> tuple[str, int, str]:
    """The JSON pointer of what gives the points of a mesh of blocks, their number, and how to have fewer.

    Raises a 422 problem for a description that is wrong.
    """
    domain = checked.canonical["domain"]
    if "file" in domain:
        return MESH_PLACE, int(rows[domain["file"]].summary["shape"][0]), "take a coarser one"
    with translate_errors():
        return "/domain", specs.count_points(domain), "lower the cells of its blocks, or refine"


# The sentences for monitors that are measured or moved on the whole grid, by their kinds.
NO_PARTS = {
    "auto": "auto compares whole meshes, which a mesh in parts is not: name a kind with a metric, such as curvature",
    "least_error": "a least-error mesh is minimised on one machine: name a kind with a metric, such as curvature",
    "nodal_solution": "a round of adapting takes place on one machine: name a kind with a metric, such as curvature",
}
_NO_CLUSTER = "meshes in parts need a cluster, and this service has none (EQUIMESH_ENGINE=dask): leave parts out"
_NO_TARGET = "the grid of a target is found on one machine: give a grid in place of the target"
_NO_BLOCKS = "a mesh of blocks is computed on one machine: take a domain with four sides"
_NO_SCHWARZ = "a mesh in parts is solved by sweeps of its whole grid: leave schwarz out"
_NO_GRADIENT = "a gradient map is solved on one machine: take the map lines"
_NO_BOUND = "a bound of the angles is kept on one machine: leave orthogonality out"
_NO_UNIFORM = "a mesh in parts begins from coarser grids: take the initial mesh nested"
_NO_TRIANGLES = "the files of a mesh in parts hold quadrilaterals: take the cells quad"


def assign_parts(checked: CheckedSpec, settings: Settings) -> CheckedSpec:
    """The spec, which names its parts if a cluster computes it; raises a 422 problem for what no cluster takes.

    One machine computes a mesh of at most ``max_points`` points whose spec names no parts. The caller checks the limits
    of points.
    """
    if checked.spec.parts is not None:
        if not settings.has_cluster:
            raise problem_at("/parts", _NO_CLUSTER)
        _check(checked, "leave parts out")
        return checked
    grid = checked.spec.grid
    if not settings.has_cluster or grid is None or min(grid.n_xi, grid.n_eta) < 1:
        return checked
    if grid.n_xi * grid.n_eta <= settings.max_points:
        return checked
    _check(checked, f"request at most {settings.max_points} points, which one machine computes")
    return checked.in_parts()


def _check(checked: CheckedSpec, remedy: str) -> None:
    """Raise a 422 problem for what a mesh in parts cannot have; the ``remedy`` asks for no parts."""
    for pointer, message in _faults(checked):
        raise problem_at(pointer, f"{message}, or {remedy}")


def _faults(checked: CheckedSpec) -> Iterator[tuple[str, str]]:
    """The pointer and the sentence of everything that a mesh in parts cannot have."""
    spec = checked.spec
    if spec.target is not None:
        yield "/target", _NO_TARGET
    if checked.has_blocks:
        yield "/domain", _NO_BLOCKS
    if spec.schwarz is not None:
        yield "/schwarz", _NO_SCHWARZ
    if spec.monitor.kind in NO_PARTS:
        yield "/monitor/kind", NO_PARTS[spec.monitor.kind]
    yield from _faults_of_monitor(spec.monitor, "/monitor")
    for number, member in enumerate(getattr(spec.monitor, "monitors", ())):
        yield from _faults_of_monitor(member, f"/monitor/monitors/{number}")
    if spec.initial != "nested":
        yield "/initial", _NO_UNIFORM
    if spec.cells != "quad":
        yield "/cells", _NO_TRIANGLES


def _faults_of_monitor(monitor: AnyMonitor, pointer: str) -> Iterator[tuple[str, str]]:
    if getattr(monitor, "map", "lines") != "lines":
        yield f"{pointer}/map", _NO_GRADIENT
    if monitor.orthogonality is not None:
        yield f"{pointer}/orthogonality", _NO_BOUND


# The most time of a side worker for the samples of one request.
_MAX_WORK_SECONDS = 60.0
# The remedy where that is not enough.
_FEWER_SAMPLES = "send fewer samples, or send them on a grid"
# The most monitors that are remembered as valid on their domains.
_MAX_REMEMBERED = 1000
# The longest text of a spec that is remembered with what was read of it, and the number of such texts: a caller who
# steps in time sends the same one with other samples.
_MAX_AGAIN_BYTES, _MAX_AGAIN = 4096, 64
Result = TypeVar("Result")


def _read(body: bytes) -> tuple[Any, CheckedSpec]:
    """The JSON of a text, and the spec in it; raises 400 and 422 problems with pointers."""
    document = parse(body)
    with _pointing_into(document):
        return document, read_spec(document)


_read_again = lru_cache(_MAX_AGAIN)(_read)


@contextmanager
def _pointing_into(document: Any) -> Iterator[None]:
    """Let the problems that are raised point to places that a document has."""
    try:
        yield
    except Problem as problem:
        if not problem.errors:
            raise
        raise repointed(problem, partial(sent_pointer, document)) from None


@dataclass(frozen=True)
class Admission:
    """Checks requests against the settings, and stores the samples that come with them."""

    settings: Settings
    store: Store
    files: Files

    def receive(self, body: bytes, upload: Upload | None, caller: Caller, mesh: Upload | None = None) -> AdmittedSpec:
        """Read a spec, and :meth:`admit` it; raises a 400 problem where it is not JSON.

        The samples of a long one are taken out of it into files.
        """
        if len(body) <= MAX_SHORT_BYTES:
            document, spec = _read_again(body) if len(body) <= _MAX_AGAIN_BYTES else _read(body)
            with _pointing_into(document):
                return self._admit(ShortSpec(spec.with_limit(self.settings.max_points)), upload, caller, mesh)
        with self.files.unfinished(".json") as text, TemporaryDirectory(dir=text.parent) as folder:
            text.write_bytes(body)
            short = self.work("", shorten, text, Path(folder), self._limits)
            return self._admit(short, upload, caller, mesh)

    def admit(self, document: Any, upload: Upload | None, caller: Caller, mesh: Upload | None = None) -> AdmittedSpec:
        """Check a parsed spec, and store its samples and its ``mesh``; raises a 422 problem with pointers."""
        with _pointing_into(document):
            spec = read_spec(document).with_limit(self.settings.max_points)
            return self._admit(ShortSpec(spec), upload, caller, mesh)

    def _admit(
        self, short: ShortSpec, upload: Upload | None, caller: Caller, mesh: Upload | None = None
    ) -> AdmittedSpec:
        spec, files = assign_parts(short.spec, self.settings), short.files
        self._check_limits(spec)
        mesh_row = self._mesh_row(spec, mesh, caller)
        if mesh_row is not None:
            spec = spec.with_mesh(mesh_row.id)
        short = replace(short, spec=spec)
        place = _find_upload_place(spec, upload)
        check_schwarz(spec.canonical)
        rows = {
            name: self.find_stored(name, at, caller)
            for at, name in spec.stored.items()
            if name != UPLOAD and name not in files and (mesh_row is None or name != mesh_row.id)
        }
        rows |= {} if mesh_row is None else {mesh_row.id: mesh_row}
        nodes = self._count_nodes(spec, rows) if spec.has_blocks else None
        built, new = short.built, None
        if upload is not None:
            built, new, row = self._receive(short, rows, upload, place, caller)
            rows[row.id] = row
            spec = spec.with_samples(UPLOAD, row.id)
        elif built is None:
            built = self._check(spec, rows, files)
        if nodes is not None and built is not None and built.target is None:
            nodes = built.problem.points  # a round has those of its values
            self._check_nodes(nodes, "/monitor/u", "solve on a coarser mesh")
        for name, path in files.items():
            row = self._keep(path, short.summaries[name], caller, durable=False)[0]
            rows[row.id] = row
            spec = spec.with_samples(name, row.id)
        if upload is not None or files:
            self._remember(spec.monitor_digest)
        hashes = {row.id: row.sha256 for row in rows.values()}
        return AdmittedSpec(
            spec.canonical,
            hashes,
            spec.points_digest,
            built=built,
            upload=new,
            nodes=nodes,
            target_pointer=spec.target_pointer,
        )

    def _mesh_row(self, spec: CheckedSpec, mesh: Upload | None, caller: Caller) -> SamplesRow | None:
        """The row of the mesh that came with a spec, which is stored now; raises a 422 problem for one without it."""
        is_named = spec.stored.get(MESH_PLACE) == UPLOAD
        if mesh is not None and is_named:
            return self.keep_mesh(mesh, caller, MESH_PLACE)[0]
        if is_named:
            message = 'send the request as multipart, with parts "spec" and "mesh", or give the id of a stored mesh'
            raise problem_at(MESH_PLACE, message)
        if mesh is not None:
            raise problem_at("/domain", 'there is a part "mesh": refer to it with {"kind": "mesh", "file": "upload"}')
        return None

    @property
    def _limits(self) -> SpecLimits:
        limits = self.settings
        return SpecLimits(max_points=limits.max_points, max_samples=limits.max_samples, product=self._product)

    @property
    def _file_limits(self) -> Limits:
        return Limits(max_bytes=4 * self.settings.max_body, max_samples=self.settings.max_samples)

    def find_samples(self, samples_id: str, pointer: str, caller: Caller) -> SamplesRow:
        """The row of samples that the caller has uploaded; raises a 422 problem."""
        row = self.store.samples.get(samples_id, caller.only)
        if row is None:
            raise problem_at(pointer, "there are no samples with this id; POST /v1/samples gives one")
        return row

    def find_stored(self, name: str, pointer: str, caller: Caller) -> SamplesRow:
        """The row of samples for a function, or of the mesh for a domain; raises a 422 problem for one of the other."""
        return require_kind(self.find_samples(name, pointer, caller), pointer)

    def keep(self, upload: Upload, caller: Caller) -> tuple[SamplesRow, bool]:
        """Read uploaded samples and store them; the second value is whether they are new."""
        with self._convert(upload, "", alone=True) as (path, summary):
            return self._keep(path, summary, caller, durable=True)

    def keep_mesh(self, upload: Upload, caller: Caller, pointer: str = "") -> tuple[SamplesRow, bool]:
        """Read an uploaded mesh that is to be a domain, and store it as samples are.

        ``pointer`` is the place that names a mesh which came with a spec; it becomes durable with that.
        """
        with self.files.unfinished(".npz") as path, self.files.unfinished(".upload") as source:
            source.write_bytes(upload.data)
            summary = self.work(pointer, convert_mesh, source, upload.filename, path, self.settings.max_points)
            return self._keep(path, summary, caller, durable=not pointer)

    def _receive(
        self, short: ShortSpec, rows: Mapping[str, SamplesRow], upload: Upload, pointer: str, caller: Caller
    ) -> tuple[BuiltSpec | None, NewSamples | None, SamplesRow]:
        """Check a spec with its upload. Nothing is stored for a refused spec.

        Light samples of a plain spec are not stored yet; others are stored after the check. So are those of a spec that
        also names stored files, such as the mesh that is its domain.
        """
        spec, files = short.spec, short.files
        if upload.is_light and spec.is_plain and spec.spec.target is None and not files and not rows:
            arrays = self._read_light(upload, pointer, alone=False)
            if "points" not in arrays and sum(array.nbytes for array in arrays.values()) <= MAX_LIGHT_BYTES:
                built = check(spec.canonical, {UPLOAD: arrays})
                new = intake.pack(arrays, self.store.clock())
                return built, new, new.row
        with self._convert(upload, pointer, alone=False) as (path, summary):
            checked = self._check(spec, rows, {**files, UPLOAD: path})
            return checked, None, self._keep(path, summary, caller, durable=False)[0]

    def _read_light(self, upload: Upload, pointer: str, *, alone: bool) -> Arrays:
        with translate_errors(pointer):
            arrays = intake.read(upload.data, upload.filename, self._file_limits, alone=alone, column=upload.column)
        self._limits.check_number(arrays["values"].size, pointer)
        return arrays

    @contextmanager
    def _convert(self, upload: Upload, pointer: str, *, alone: bool) -> Iterator[tuple[Path, dict[str, Any]]]:
        """Write uploaded samples to an npz file; gives its path and a summary."""
        with self.files.unfinished(".npz") as path:
            if upload.is_light:
                arrays = self._read_light(upload, pointer, alone=alone)
                with path.open("wb") as file:
                    summary = intake.write(arrays, file)
            else:
                with self.files.unfinished(".upload") as source:
                    source.write_bytes(upload.data)
                    read = partial(intake.convert, alone=alone, column=upload.column)
                    summary = self.work(pointer, read, source, upload.filename, path, self._file_limits)
            self._limits.check_number(math.prod(summary["shape"]), pointer)
            yield path, summary

    def _keep(self, path: Path, summary: dict[str, Any], caller: Caller, *, durable: bool) -> tuple[SamplesRow, bool]:
        self._check_room(path.stat().st_size, caller)
        file = self.files.seal(path)
        row = intake.row_of(file, summary, self.store.clock())
        new = self.store.samples.add(
            row, partial(self.files.publish, path, file), key_id=caller.key_id, durable=durable
        )
        return (row, True) if new else (self.find_samples(row.id, "", caller), False)

    def _check_room(self, size: int, caller: Caller) -> None:
        """Raise a 429 problem where a file of this size, which may be larger than what was sent, has no room."""
        most = self.settings.key_max_bytes
        if size <= MAX_SHORT_BYTES or not caller.key_id or not most:
            return
        used = self.store.quotas.stored_bytes(caller.key_id)
        if used + size > most:
            raise quota_problem(QuotaError("key_max_bytes", used, most))

    def _check(self, spec: CheckedSpec, rows: Mapping[str, SamplesRow], sent: Mapping[str, Path]) -> BuiltSpec | None:
        """Check the monitor on the domain; the problem of the spec, None where the monitor is known to fit.

        ``sent`` are the files of samples that came with the request.
        """
        with self._found(rows) as paths:
            return check(spec.canonical, {**paths, **sent})

    @contextmanager
    def _found(self, rows: Mapping[str, SamplesRow]) -> Iterator[dict[str, Samples]]:
        """The files of stored samples by their ids; raises a 409 problem where one is gone."""
        with ExitStack() as stack:
            try:
                paths = {name: stack.enter_context(self.files.local(row.sha256)) for name, row in rows.items()}
            except FileNotFoundError:
                raise Problem("conflict", "The samples were deleted at this moment; upload them again.") from None
            yield {**paths}

    def _remember(self, monitor_digest: str) -> None:
        """Note that a monitor fits its domain."""

    def work(self, pointer: str, function: Callable[..., Result], *arguments: Any) -> Result:
        """Call ``function``, which may take long; an input error becomes a 422 problem."""
        with translate_errors(pointer):
            return function(*arguments)

    def _check_limits(self, checked: CheckedSpec) -> None:
        spec = checked.spec
        if spec.grid is not None:
            self._check_grid(spec.grid, whole=checked.canonical["parts"] is None)
        self._limits.check(checked)
        if spec.schwarz is not None and spec.grid is not None and not checked.has_blocks:
            self._check_schwarz(spec.schwarz, spec.grid)
        if spec.schwarz is not None and (spec.schwarz.max_exchanges or 0) > self._most_iterations:
            raise problem_at("/schwarz/max_exchanges", f"too many: this service runs at most {self._most_iterations}")

    def _check_grid(self, grid: Grid, *, whole: bool) -> None:
        most = self.settings.max_points if whole else self.settings.max_cluster_points
        more = self._way_to_more
        # One direction at a time first: then the message names the direction that is far too large.
        for name, points in (("n_xi", grid.n_xi), ("n_eta", grid.n_eta)):
            if points > most // 4:
                message = f"too many points: {self._product} has at most {most} in all{more}"
                raise problem_at(f"/grid/{name}", message)
        points = grid.n_xi * grid.n_eta
        if grid.n_xi > 0 and points > most:
            message = f"{points} points; {self._product} has at most {most}: lower n_xi or n_eta{more}"
            raise problem_at("/grid", message)

    def _count_nodes(self, checked: CheckedSpec, rows: Mapping[str, SamplesRow]) -> int:
        """The number of points of a mesh of blocks, at most; raises a 422 problem where there are too many."""
        place, nodes, remedy = count_points(checked, rows)
        self._check_nodes(nodes, place, remedy)
        target = checked.spec.target
        return nodes if target is None or target.max_points is None else target.max_points

    def _check_nodes(self, nodes: int, place: str, remedy: str) -> None:
        most = self.settings.max_points
        if nodes > most:
            message = f"the mesh has {nodes} points; {self._product} has at most {most}: {remedy}{self._way_to_more}"
            raise problem_at(place, message)

    @property
    def _product(self) -> str:
        """The words for what is limited, for messages."""
        return "a mesh of this service"

    @property
    def _way_to_more(self) -> str:
        return "" if self.settings.has_cluster else "; a service with a cluster (EQUIMESH_ENGINE=dask) takes more"

    @property
    def _most_iterations(self) -> int:
        return self.settings.max_iterations

    def _check_schwarz(self, schwarz: Schwarz, grid: Grid) -> None:
        most = self.settings
        along_xi, along_eta = schwarz.counts
        if max(along_xi, along_eta) > most.max_subdomains or along_xi * along_eta > most.max_subdomains:
            message = f"too many: this service takes at most {most.max_subdomains} subdomains in all"
            raise problem_at("/schwarz/subdomains", message)
        if schwarz.overlap > max(grid.n_xi, grid.n_eta):
            message = "the overlap is larger than the grid: 2 to 8 points are usual"
            raise problem_at("/schwarz/overlap", message)
        if schwarz.max_iterations > self._most_iterations:
            message = f"too many: this service runs at most {self._most_iterations} iterations"
            raise problem_at("/schwarz/max_iterations", message)


@dataclass(frozen=True, kw_only=True)
class ServiceAdmission(Admission):
    """Checks requests in the process of the service, which leaves what may take long to side workers.

    ``while_waiting`` is entered during the wait for a side worker, with the id of the API key.
    """

    side_workers: SideWorkers
    while_waiting: Callable[[str], AbstractContextManager[None]]
    known: OrderedDict[str, None] = field(default_factory=OrderedDict)  # monitors that fit their domains

    def _check(self, spec: CheckedSpec, rows: Mapping[str, SamplesRow], sent: Mapping[str, Path]) -> BuiltSpec | None:
        """As :meth:`Admission._check`; a slow check runs in a side worker, once for each monitor and domain."""
        if spec.is_quick:
            return check(spec.canonical, {})
        # The points of a round on blocks are those of its values: they are known once it is built.
        has_points = not (spec.has_blocks and isinstance(spec.spec.monitor, NodalSolution))
        if has_points and not sent and spec.monitor_digest in self.known:
            return None
        with self._found(rows) as paths:
            built = self.work("", check, spec.canonical, {**paths, **sent})
        if not sent:
            self._remember(spec.monitor_digest)
        return built

    def _remember(self, monitor_digest: str) -> None:
        self.known[monitor_digest] = None
        while len(self.known) > _MAX_REMEMBERED:
            self.known.popitem(last=False)

    def work(self, pointer: str, function: Callable[..., Result], *arguments: Any) -> Result:
        """Call ``function`` in a side worker, within a time limit; an input error becomes a 422 problem."""
        key_id = log_context.current().key_id
        try:
            with translate_errors(pointer), self.while_waiting(key_id):
                return self.side_workers.submit(key_id, function, *arguments, time_limit=_MAX_WORK_SECONDS).result()
        except (TimeLimitError, MemoryLimitError) as error:
            remedy = "send a mesh with fewer cells" if function is convert_mesh else _FEWER_SAMPLES
            raise problem_at(pointer or "/monitor", f"this takes too long to check ({error}): {remedy}") from None
        except (EngineError, CancelledError) as error:
            raise Problem("unavailable", f"The request was not checked: {error}.") from None


def _find_upload_place(spec: CheckedSpec, upload: Upload | None) -> str:
    """The pointer of the first place that names the upload, "" without an upload; raises a 422 problem."""
    places = (pointer for pointer, name in spec.stored.items() if name == UPLOAD and pointer != MESH_PLACE)
    place = next(places, "")
    if place and upload is None:
        message = 'send the request as multipart, with parts "spec" and "samples", or give the id of stored samples'
        raise problem_at(place, message)
    if upload is not None and not place:
        raise problem_at(next(iter(spec.sources)), 'there is a part "samples": refer to it with {"samples": "upload"}')
    return place
