"""Steps of sequences: the checks of what a time-stepper sends, and the spec of the next mesh."""

import re
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from equimesh.errors import InputError, SamplesError
from equimesh.fields.nodal_field import nodal_values
from equimesh.io.npz import NPZ_ARRAYS, load_npz
from equimesh.meshes.mesh import Mesh
from equimesh.upload.samples import read_npz
from equimesh_service.admission.admit import Admission, Admitted
from equimesh_service.admission.callers import Caller
from equimesh_service.assembly.long_spec import MAX_SHORT_BYTES
from equimesh_service.assembly.long_step import shorten_step
from equimesh_service.files.port import Files, Removed, StoredFile
from equimesh_service.problems.problem import Complaint, Problem, complaint_of, input_problem, problem_at, repointed
from equimesh_service.settings import Settings
from equimesh_service.spec.document import escape_token, parse, sent_pointer
from equimesh_service.spec.mesh import read_spec
from equimesh_service.spec.sources import ExpressionSource
from equimesh_service.spec.step import MAX_FIELDS, NodesSource, StepSpec
from equimesh_service.spec.strict import validate
from equimesh_service.store.rows import NODAL, Artifact, SamplesRow
from equimesh_service.store.store import Store

Array: TypeAlias = npt.NDArray[np.float64]

FIELDS = "fields"  # the name of the artifact
# Names of other arrays in mesh files, and of arguments of numpy.savez.
RESERVED = NPZ_ARRAYS | {"xi", "eta", "Q_eq", "step", "u"} | {"file", "allow_pickle"}
KINDS = ("auto", "least_error", "arc_length", "curvature")
# Bytes of an npz file in addition to its values.
_NPZ_BYTES = 64 * 1024
# The most values of a step in JSON beside u and its fields.
_OTHER_VALUES = 1000
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,31}", re.ASCII)
_U = "/monitor/u"


@dataclass(frozen=True, kw_only=True)
class Move:
    """A step as it was sent, not yet compared with the mesh: ``u`` at the nodes or as an expression, and the fields.

    ``sent`` is its JSON.
    """

    step: int
    u: Any
    fields: Mapping[str, Any]
    sent: Any = None

    def check(self, mesh: Mesh) -> tuple[Array | None, dict[str, Array]]:
        """u (None for an expression) and the fields at the nodes of ``mesh``; raises a 422 problem."""
        complaints: list[Complaint] = []

        def read(values: Any, name: str, pointer: str) -> Array | None:
            try:
                return nodal_values(values, mesh, name)
            except InputError as error:
                complaints.append(complaint_of(error, pointer))
                return None

        u = None if isinstance(self.u, ExpressionSource) else read(self.u, "u", "/u/nodes")
        fields = {}
        for name, values in self.fields.items():
            pointer = f"/fields{escape_token(name)}"
            if not _NAME.fullmatch(name) or name in RESERVED:
                reserved = ", ".join(sorted(RESERVED))
                message = f"a field has a name of at most 32 letters, digits and underscores, none of {reserved}"
                complaints.append(Complaint(pointer=pointer, message=message))
            elif (found := read(values, name, pointer)) is not None:
                fields[name] = found
        if complaints:
            raise input_problem(complaints)
        return u, fields


def read_json(data: bytes) -> Move:
    """A step in JSON; raises 400 and 422 problems."""
    sent = parse(data)
    spec = validate(StepSpec, sent)
    u = spec.u.nodes if isinstance(spec.u, NodesSource) else spec.u
    return Move(step=spec.step, u=u, fields=spec.fields, sent=sent)


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
    u = arrays["u"] if short.u is None else short.u
    return Move(step=short.step, u=u, fields=short.fields(arrays), sent=short.sent)


def max_bytes(settings: Settings, points: int) -> int:
    """The most bytes of an npz step when it is unpacked: twice those of u and all fields on a mesh of ``points``."""
    return min(4 * settings.max_body, _NPZ_BYTES + 16 * (1 + MAX_FIELDS) * points)


def read_arrays(data: bytes, max_bytes: int) -> Move:
    """A step in npz: ``step`` is a single number, ``u`` an array, all others are fields; raises 422 problems."""
    try:
        arrays = read_npz(data, max_bytes=max_bytes)
    except SamplesError as error:
        raise input_problem([complaint_of(error, escape_token(error.field) if error.field else "")]) from None
    for name in ("step", "u"):
        if name not in arrays:
            raise problem_at(
                f"/{name}", f"the npz file needs an array {name}: step is the number of the step that follows"
            )
    step = arrays.pop("step")
    if step.size != 1 or step.dtype.kind not in "iu":
        raise problem_at("/step", "this must be a single whole number: the step that this one follows")
    u = arrays.pop("u")
    if len(arrays) > MAX_FIELDS:
        raise problem_at("/fields", f"{len(arrays)} fields; a step carries at most {MAX_FIELDS}")
    return Move(step=int(step.reshape(-1)[0]), u=u, fields=arrays)


def check_first_spec(admitted: Admitted) -> Admitted:
    """The spec of a sequence's first mesh; raises a 422 problem for a monitor that has no single u."""
    kind = admitted.spec["monitor"]["kind"]
    if admitted.spec["target"] is not None:
        raise problem_at("/target", "the meshes of a sequence have one grid: give it in place of the target")
    if kind not in KINDS:
        message = f"a sequence follows one function u: its monitor is one of {', '.join(KINDS)}, not {kind}"
        raise problem_at("/monitor/kind", message)
    return admitted


@dataclass(frozen=True, kw_only=True)
class PreparedStep:
    """A step that can be requested, and the file of its fields, which is sealed but not published."""

    admitted: Admitted
    fields: Artifact | None
    path: Path | None

    def publish(self, files: Files, removed: Removed) -> None:
        """Give the file of the fields its name."""
        if self.fields is not None and self.path is not None:
            files.publish(self.path, StoredFile(self.fields.sha256, self.fields.size), removed)


@dataclass(frozen=True)
class Stepping:
    """Makes the specs of steps, and stores their u and fields."""

    admission: Admission
    store: Store
    files: Files

    def prepare(self, move: Move, mesh_id: str, caller: Caller, stack: ExitStack) -> PreparedStep:
        """The spec of the mesh after ``mesh_id``; raises 409 and 422 problems. Files last until ``stack`` closes."""
        spec, mesh = self.store.meshes.spec(mesh_id), self._mesh(mesh_id)
        if spec is None:
            raise _gone()
        u, fields = move.check(mesh)
        if u is None:
            admitted = self._of_expression(spec, move, caller)
        else:
            row = self._keep(mesh, u, caller)
            monitor = {**spec["monitor"], "u": {"samples": row.id}}
            admitted = Admitted(read_spec({**spec, "monitor": monitor}).canonical, {row.id: row.sha256}, "")
        if not fields:
            return PreparedStep(admitted=admitted, fields=None, path=None)
        path = stack.enter_context(self.files.unfinished(".npz"))
        np.savez(path, **fields)  # type: ignore[arg-type]
        file = self.files.seal(path)
        return PreparedStep(admitted=admitted, fields=Artifact(FIELDS, file.sha256, file.size), path=path)

    def _of_expression(self, spec: Mapping[str, Any], move: Move, caller: Caller) -> Admitted:
        document = {**spec, "monitor": {**spec["monitor"], "u": move.u.model_dump(mode="json")}}
        try:
            return self.admission.admit(document, None, caller)
        except Problem as problem:
            if not problem.errors:
                raise
            raise repointed(problem, lambda pointer: sent_pointer(move.sent, _pointer_of_step(pointer))) from None

    def _mesh(self, mesh_id: str) -> Mesh:
        artifact = self.store.meshes.artifact(mesh_id, "mesh")
        if artifact is None:
            raise _gone()
        try:
            with self.files.local(artifact.sha256) as path:
                return load_npz(path).mesh
        except FileNotFoundError:
            raise _gone() from None

    def _keep(self, mesh: Mesh, u: Array, caller: Caller) -> SamplesRow:
        """Store u as samples, which a monitor can name."""
        with self.files.unfinished(".npz") as path:
            np.savez(path, x=mesh.x, y=mesh.y, values=u)
            file = self.files.seal(path)
            summary = {"kind": "nodal", "shape": list(u.shape), "min": float(u.min()), "max": float(u.max())}
            row = SamplesRow(f"{NODAL}{file.sha256[:32]}", file.sha256, file.size, summary, self.store.clock())
            self.store.samples.add(row, partial(self.files.publish, path, file), key_id=caller.key_id)
        return row


def _gone() -> Problem:
    return Problem("conflict", "The mesh that this step follows was deleted.")


def _pointer_of_step(pointer: str) -> str:
    """A pointer into the spec of the mesh as one into the step."""
    return "/u" + pointer.removeprefix(_U) if pointer.startswith(_U) else pointer
