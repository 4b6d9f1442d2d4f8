"""Steps of sequences: what a time-stepper sends, and the spec of the next mesh."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from hashlib import sha256
from typing import Any

import numpy as np

from equimesh.errors import InputError, SamplesError
from equimesh.io.npz import NPZ_ARRAYS, load_mesh, npz_bytes
from equimesh.meshes.mesh import Mesh
from equimesh.upload.samples import read_npz
from equimesh_schema.sequences import (
    ANSWER,
    MAX_COMPONENTS,
    MAX_FIELDS,
    FieldSettings,
    FieldSource,
    NodesSource,
    StepSettings,
    StepSpec,
)
from equimesh_schema.sources import ExpressionSource
from equimesh_service.admission.admit import Admission
from equimesh_service.admission.callers import Caller
from equimesh_service.admission.tasks import AdmittedSpec, StepPlace
from equimesh_service.assembly.bodies import (
    MAX_SHORT_BYTES,
    Array,
    StepField,
    checked_values,
    field_arrays,
    pointer_of,
    settings_of,
    shorten_step,
    values_of,
)
from equimesh_service.files.port import Publish, StoredFile, publish_nothing
from equimesh_service.problems.problem import Complaint, Problem, complaint_of, input_problem, problem_at, repointed
from equimesh_service.settings import Settings
from equimesh_service.spec.document import escape_token, parse, sent_pointer
from equimesh_service.spec.mesh import read_spec
from equimesh_service.spec.monitors import completed, functions_of, with_functions, with_u
from equimesh_service.spec.strict import validate
from equimesh_service.store.blobs import MAX_ROW_BYTES, BlobFiles, insert_blob
from equimesh_service.store.rows import NODAL, Artifact, Followed, NewStep, SamplesRow
from equimesh_service.store.store import Store
from equimesh_service.worker.recent import MESHES, KnownStep

# Names of other arrays in mesh files, and of arguments of numpy.savez.
RESERVED = NPZ_ARRAYS | {"xi", "eta", "Q_eq", "step", "u"} | {"file", "allow_pickle"}
# The array of a step in npz that is the text of its settings.
SETTINGS = "settings"
# Bytes of an npz file in addition to its values.
_NPZ_BYTES = 64 * 1024
# The most values of a step in JSON beside u and its fields.
_OTHER_VALUES = 1000
# The most bytes of the settings of a step in npz.
_MAX_SETTINGS_BYTES = 256 * 1024
# The most characters of the name of a field.
MAX_NAME = 32


@dataclass(frozen=True, kw_only=True)
class CheckedMove:
    """A step whose values belong to the mesh that it follows.

    ``u`` is an array of values at its nodes, the JSON of an expression, or None. The functions of the ``monitor`` are
    arrays of values at the nodes, or JSON of a spec. Both are None where they were not sent.
    """

    u: Any
    fields: Mapping[str, StepField]
    monitor: Mapping[str, Any] | None


@dataclass(frozen=True, kw_only=True)
class Move:
    """A step as it was sent, not yet compared with the mesh: ``u``, the ``fields`` and the ``monitor``.

    Functions of the monitor are values at the nodes in ``{"nodes": …}``, names of fields in ``{"field": …}``, or those
    of a spec. ``sent`` is the JSON of the step, and ``pointers`` are the JSON pointers to the values of its fields.
    ``motion`` has the settings of the move of the mesh.
    """

    step: int
    u: Any
    fields: Mapping[str, StepField]
    monitor: Mapping[str, Any] | None = None
    sent: Any = None
    pointers: Mapping[str, str] = field(default_factory=dict)
    motion: Mapping[str, Any] = field(default_factory=dict)

    def check(self, mesh: Mesh) -> CheckedMove:
        """The move with its values checked on the nodes and cells of ``mesh``; raises a 422 problem."""
        if self.u is None and self.monitor is None:
            raise problem_at("/u", "this key is required, unless the step has a monitor")
        complaints: list[Complaint] = []

        def read(check: Callable[[], Any], pointer: str) -> Any:
            try:
                return check()
            except InputError as error:
                complaints.append(complaint_of(error, pointer))
                return None

        def nodal(values: Any, name: str, pointer: str) -> Array | None:
            found: Array | None = read(lambda: checked_values(values, mesh, name, vectors=False), pointer)
            return found

        fields: dict[str, StepField] = {}
        for name, sent in self.fields.items():
            pointer = self.pointers.get(name, f"/fields{escape_token(name)}")
            if not _is_name(name):
                reserved = ", ".join(sorted(RESERVED))
                message = f"a field has a name of at most 32 letters, digits and underscores, none of {reserved}"
                complaints.append(Complaint(pointer=pointer, message=message))
            elif (found := read(partial(sent.checked, mesh, name), pointer)) is not None:
                fields[name] = found

        def function(pointer: str, source: Any) -> Any:
            if not isinstance(source, Mapping) or len(source) != 1:
                return source
            if "nodes" in source:
                return nodal(source["nodes"], pointer.rpartition("/")[2], f"{pointer}/nodes")
            if "field" not in source:
                return source
            return read(lambda: self._scalar(source["field"], fields, len(mesh.node_shape)), f"{pointer}/field")

        u = self.u
        if isinstance(u, FieldSource):
            u = function("/u", {"field": u.field})
        elif isinstance(u, ExpressionSource):
            u = asdict(u)
        elif u is not None:
            u = nodal(u, "u", "/u/nodes")
        monitor = None if self.monitor is None else with_functions(self.monitor, function)
        _count(fields, len(mesh.node_shape), complaints)
        if complaints:
            raise input_problem(complaints)
        return CheckedMove(u=u, fields=fields, monitor=monitor)

    def _scalar(self, name: Any, fields: Mapping[str, StepField], ndim: int) -> Array:
        """The values of a field that a monitor can follow: ``ndim`` dimensions, one number at each node."""
        found = fields.get(name) if isinstance(name, str) else None
        if found is None:
            shown = ", ".join(self.fields) or "none"
            raise SamplesError(f"the step has no usable field {str(name)[:40]!r}; its fields are: {shown}")
        if found.location == "cells":
            raise SamplesError(f"{name} has averages of cells: a monitor needs a field with a value at each node")
        if found.values.ndim > ndim:
            raise SamplesError(f"{name} has vectors: a monitor needs a field with one number at each node")
        values: Array = found.values
        return values


def read_json(data: bytes) -> Move:
    """A step in JSON; raises 400 and 422 problems."""
    sent = parse(data)
    spec = validate(StepSpec, sent)
    return Move(
        step=spec.step,
        u=spec.u.nodes if isinstance(spec.u, NodesSource) else spec.u,
        fields={name: StepField.of(values_of(given), settings_of(given)) for name, given in spec.fields.items()},
        monitor=spec.monitor,
        sent=sent,
        pointers={name: pointer_of(name, given) for name, given in spec.fields.items()},
        motion=spec.given,
    )


def read_long_json(admission: Admission, data: bytes, points: int) -> Move:
    """A step in JSON of any length, which a side worker reads where it is long; raises 400, 413 and 422 problems."""
    if len(data) <= MAX_SHORT_BYTES:
        return read_json(data)
    most = 2 * (1 + MAX_FIELDS) * points + _OTHER_VALUES
    with admission.files.unfinished(".json") as text, admission.files.unfinished(".npz") as target:
        text.write_bytes(data)
        short = admission.work("", shorten_step, text, target, most)
        with np.load(target, allow_pickle=False) as file:
            arrays = dict(file)
    named = short.fields(arrays).items()
    return Move(
        step=short.step,
        u=arrays.get("u") if short.u is None else short.u,
        fields={name: StepField.of(values, settings) for name, (values, settings) in named},
        monitor=None if short.monitor is None else with_functions(short.monitor, _arrays_in(arrays, set())),
        sent=short.sent,
        pointers=short.pointers,
        motion=short.motion,
    )


def max_bytes(settings: Settings, points: int) -> int:
    """The largest number of bytes of an unpacked npz step: twice the size of u and all fields on ``points`` points."""
    return min(4 * settings.max_body, _NPZ_BYTES + 16 * (1 + MAX_FIELDS) * points)


def read_arrays(data: bytes, max_bytes: int) -> Move:
    """A step in npz; raises 422 problems.

    ``step`` is a single number, ``u`` an array, ``settings`` a text in JSON. All others are fields, unless the settings
    name them as functions of a monitor.
    """
    try:
        arrays = read_npz(data, max_bytes=max_bytes, text=SETTINGS)
    except SamplesError as error:
        raise input_problem([complaint_of(error, escape_token(error.field) if error.field else "")]) from None
    arrays.pop(ANSWER, None)
    settings, sent = _settings(arrays)
    number = _number(arrays)
    u = arrays.pop("u", None)
    if u is not None and settings.u is not None:
        raise problem_at("/u", "there is an array u: leave this out, or the array")
    if u is None and settings.u is None and settings.monitor is None:
        raise problem_at("/u", "the npz file needs an array u, or settings with u or with a monitor")
    used: set[str] = set()
    monitor = None if settings.monitor is None else with_functions(settings.monitor, _arrays_in(arrays, used))
    values = {name: array for name, array in arrays.items() if name not in used}
    for name in settings.fields:
        if name not in values:
            raise problem_at(f"/fields{escape_token(name)}", "the npz file has no array of this name")
    if len(values) > MAX_FIELDS:
        raise problem_at("/fields", f"{len(values)} fields; a step carries at most {MAX_FIELDS}")
    fields = {name: StepField.of(array, settings.fields.get(name, FieldSettings())) for name, array in values.items()}
    function: Any = settings.u if u is None else u
    return Move(step=number, u=function, fields=fields, monitor=monitor, sent=sent, motion=settings.given)


def _settings(arrays: dict[str, Any]) -> tuple[StepSettings, Any]:
    """The settings of a step in npz, taken out of its arrays, and their JSON."""
    if SETTINGS not in arrays or arrays[SETTINGS].dtype.kind not in "US":
        return StepSettings(), {}
    try:
        text = arrays.pop(SETTINGS).item()
        data = text if isinstance(text, bytes) else text.encode()
    except (ValueError, UnicodeError):
        raise problem_at("/settings", "this text has characters that are none") from None
    if len(data) > _MAX_SETTINGS_BYTES:
        raise problem_at("/settings", f"a text of {len(data)} bytes; at most {_MAX_SETTINGS_BYTES} are read")
    try:
        sent = parse(data)
    except Problem as problem:
        raise problem_at("/settings", problem.detail) from None
    return validate(StepSettings, sent), sent


def _number(arrays: dict[str, Any]) -> int:
    """The number of the step that a step in npz follows, taken out of its arrays."""
    if "step" not in arrays:
        message = "the npz file needs an array step: step is the number of the step that follows"
        raise problem_at("/step", message)
    step = arrays.pop("step")
    if step.size != 1 or step.dtype.kind not in "iu":
        raise problem_at("/step", "this must be a single whole number: the step that this one follows")
    return int(step.reshape(-1)[0])


def _arrays_in(arrays: Mapping[str, Any], used: set[str]) -> Callable[[str, Any], Any]:
    """Puts arrays in place of their names in ``{"nodes": name}``, and notes in ``used`` which they are."""

    def function(pointer: str, source: Any) -> Any:
        name = source.get("nodes") if isinstance(source, Mapping) else None
        if not isinstance(name, str):
            return source
        if name not in arrays:
            raise problem_at(f"{pointer}/nodes", f"the npz file has no array {name[:40]!r}")
        used.add(name)
        return {"nodes": arrays[name]}

    return function


def _is_name(name: str) -> bool:
    """Whether a field can have this name: an identifier in ASCII that files do not use for anything else."""
    return name.isascii() and name.isidentifier() and name[0] != "_" and len(name) <= MAX_NAME and name not in RESERVED


def _count(fields: Mapping[str, StepField], ndim: int, complaints: list[Complaint]) -> None:
    """Complain of more components than a step carries."""
    number = sum(found.values.shape[-1] if found.values.ndim > ndim else 1 for found in fields.values())
    if number > MAX_COMPONENTS:
        message = f"the fields have {number} components in all; a step carries at most {MAX_COMPONENTS}"
        complaints.append(Complaint(pointer="/fields", message=message))


FIELDS = "fields"  # the name of the artifact
_U = "/monitor/u"


def check_first_spec(admitted: AdmittedSpec) -> AdmittedSpec:
    """The spec of a sequence's first mesh, with interpolation in place of a solver as what its mesh is for.

    Raises a 422 problem for a target, and for a mesh in parts.
    """
    if admitted.spec["target"] is not None:
        message = "the meshes of a sequence keep their points: give n_xi and n_eta, or cells of blocks, and no target"
        raise problem_at(admitted.target_pointer, message)
    if admitted.nodes is not None and admitted.spec["schwarz"] is not None:
        raise problem_at("/schwarz", "the steps of a sequence on blocks are solved whole: leave schwarz out")
    if admitted.is_in_parts:
        message = "the meshes of a sequence are computed on one machine: request fewer points, and leave parts out"
        raise problem_at("/parts", message)
    monitor = admitted.spec["monitor"]
    if monitor["kind"] != "auto" or monitor["for"] != "finite_element":
        return admitted
    # Steps follow interpolation, and would have to move far from a first mesh for a solver.
    spec = {**admitted.spec, "monitor": {**monitor, "for": "interpolation"}}
    digest = sha256(f"{admitted.digest} followed".encode()).hexdigest()
    return replace(admitted, spec=spec, digest=digest, built=None, packed=None)


@dataclass(frozen=True, kw_only=True)
class PreparedStep:
    """A step that can be requested, with the file of its fields, and its functions at nodes as samples.

    ``start`` is the file of the mesh that it follows. ``settings`` are for the worker: those of the move, and the
    record of the mesh ``before``. ``publish`` gives the file of the fields its name, as those of the ``functions``.
    ``contents`` are the bytes of those files by their SHA-256; large ones are on disk. ``known`` is what its worker
    need not read.
    """

    admitted: AdmittedSpec
    start: str
    settings: Mapping[str, Any]
    fields: Artifact | None = None
    publish: Publish = publish_nothing
    functions: Sequence[tuple[SamplesRow, Publish]] = ()
    contents: Mapping[str, bytes] = field(default_factory=dict)
    known: KnownStep | None = None

    @property
    def files(self) -> set[str]:
        """The SHA-256 of all files that are not stored yet."""
        return {row.sha256 for row, _ in self.functions} | (set() if self.fields is None else {self.fields.sha256})

    def new_step(self, place: StepPlace, key_id: str) -> NewStep:
        """The step after that of ``place``, to be inserted."""
        return NewStep(
            sequence_id=place.sequence_id,
            number=place.number + 1,
            keep=place.keep,
            fingerprint=place.fingerprint,
            key_id=key_id,
            start=self.start,
            fields=self.fields,
            settings=self.settings,
            publish=self.publish,
            functions=self.functions,
        )


@dataclass(frozen=True)
class StepAdmission:
    """Checks the steps of a sequence, and makes their specs and the files of their functions and fields."""

    admission: Admission
    store: Store
    files: BlobFiles
    contents: dict[str, bytes] = field(default_factory=dict)
    values: dict[str, Array] = field(default_factory=dict)

    def prepare(self, move: Move, mesh_id: str, caller: Caller, stack: ExitStack) -> PreparedStep:
        """The spec of the mesh after ``mesh_id``; raises 409 and 422 problems. Files last until ``stack`` closes."""
        followed = self.store.sequences.followed(mesh_id)
        if followed is None:
            raise _gone()
        mesh = self._mesh(followed.file)
        checked = move.check(mesh)
        admitted, functions = self._admitted(followed.spec, mesh, move, checked, (caller, stack))
        settings = {**followed.settings, **move.motion, "before": _before(followed)}
        prepared = PreparedStep(
            admitted=admitted,
            start=followed.file,
            settings=settings,
            functions=functions,
            contents=self.contents,
            known=KnownStep(mesh=mesh, fields=checked.fields, values=self.values),
        )
        if not checked.fields:
            return prepared
        file, publish = self._seal(field_arrays(checked.fields), stack)
        return replace(prepared, fields=Artifact(FIELDS, file.sha256, file.size), publish=publish)

    def _seal(self, arrays: Mapping[str, Any], stack: ExitStack) -> tuple[StoredFile, Publish]:
        """A file of ``arrays``, in memory where it is small, and what gives it its name."""
        if sum(np.asarray(values).nbytes for values in arrays.values()) < MAX_ROW_BYTES - _NPZ_BYTES:
            content = npz_bytes(arrays)
            small = StoredFile(sha256(content).hexdigest(), len(content))
            self.contents[small.sha256] = content
            return small, lambda _: insert_blob(self.files.database, small.sha256, content)
        path = stack.enter_context(self.files.unfinished(".npz"))
        np.savez(path, **arrays)
        file = self.files.seal(path)
        return file, partial(self.files.publish, path, file)

    def _admitted(
        self, spec: Mapping[str, Any], mesh: Mesh, move: Move, checked: CheckedMove, by: tuple[Caller, ExitStack]
    ) -> tuple[AdmittedSpec, Sequence[tuple[SamplesRow, Publish]]]:
        """The checked spec of the next mesh, and its functions at nodes as samples that are not stored yet."""
        (caller, stack), rows = by, dict[str, tuple[SamplesRow, Publish]]()

        def function(_pointer: str, source: Any) -> Any:
            if not isinstance(source, np.ndarray):
                return source
            row, publish = self._samples_of(mesh, source, stack)
            rows[row.id] = row, publish
            return {"samples": row.id}

        before = spec["monitor"]
        from_u: tuple[str, ...] = (_U,)
        if checked.monitor is None:
            monitor = with_u(before, checked.u)
        else:
            monitor, from_u = completed(checked.monitor, checked.u, before)
        monitor = with_functions(monitor, function)
        document = {**spec, "monitor": monitor}
        sources = [source for _, source in functions_of(monitor)]
        has_file = "file" in (spec.get("domain") or {})
        if checked.monitor is None and not has_file and all(source.get("samples") in rows for source in sources):
            # The settings have been checked, and functions of finite values fit every domain.
            nodes = None if mesh.is_grid else len(mesh.points)
            hashes = {row.id: row.sha256 for row, _ in rows.values()}
            return AdmittedSpec(read_spec(document).canonical, hashes, "", nodes=nodes), [*rows.values()]
        for row, publish in rows.values():  # the check reads them; the mesh that needs them is durable
            self.store.samples.add(row, publish, key_id=caller.key_id, durable=False)
        try:
            return self.admission.admit(document, None, caller), ()
        except Problem as problem:
            if not problem.errors:
                raise
            raise repointed(problem, lambda pointer: sent_pointer(move.sent, _pointer_of(pointer, from_u))) from None

    def _mesh(self, sha256: str) -> Mesh:
        def read() -> Mesh:
            with self.files.opened(sha256) as stream:
                return load_mesh(stream)

        try:
            found: Mesh = MESHES.get(sha256, read, partial(self.files.require, sha256))
        except FileNotFoundError:
            raise _gone() from None
        return found

    def _samples_of(self, mesh: Mesh, u: Array, stack: ExitStack) -> tuple[SamplesRow, Publish]:
        """u as samples, which a monitor can name."""
        nodes: dict[str, Any] = {"x": mesh.x, "y": mesh.y} if mesh.is_grid else {"nodes": mesh.points}
        file, publish = self._seal({"values": u, **nodes}, stack)
        self.values[file.sha256] = u
        kind = "nodal" if mesh.is_grid else "block_nodes"
        summary = {"kind": kind, "shape": list(u.shape), "min": float(u.min()), "max": float(u.max())}
        return SamplesRow(f"{NODAL}{file.sha256[:32]}", file.sha256, file.size, summary, self.store.clock()), publish


def _before(followed: Followed) -> dict[str, Any]:
    """The mesh before: its u as a source, the file of its samples, and its gains."""
    u = followed.spec["monitor"].get("u")
    if u is not None and not u.keys() & {"expression", "samples"}:
        u = None  # long values, which are not stored twice
    samples = None if u is None else followed.samples.get(u.get("samples"))
    return {"u": u, "samples": samples, "gains": followed.gains}


def _gone() -> Problem:
    return Problem("conflict", "The mesh that this step follows was deleted.")


def _pointer_of(pointer: str, from_u: tuple[str, ...]) -> str:
    """A pointer into the spec of the mesh as one into the step, whose u is the function at ``from_u``."""
    for place in from_u:
        if pointer == place or pointer.startswith(f"{place}/"):
            return "/u" + pointer.removeprefix(place)
    return pointer
