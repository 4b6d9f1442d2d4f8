"""Steps of sequences: the spec of the next mesh, and the files that it needs."""

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from equimesh.io.npz import load_npz
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh_service.admission.admit import Admission, Admitted
from equimesh_service.admission.callers import Caller
from equimesh_service.admission.moves import CheckedMove, Move
from equimesh_service.assembly.step_fields import Array, write_fields
from equimesh_service.files.port import Files, Removed, StoredFile
from equimesh_service.problems.problem import Problem, problem_at, repointed
from equimesh_service.spec.document import sent_pointer
from equimesh_service.spec.mesh import read_spec
from equimesh_service.spec.monitors import completed, functions_of, with_functions, with_u
from equimesh_service.store.rows import NODAL, Artifact, SamplesRow
from equimesh_service.store.store import Store

FIELDS = "fields"  # the name of the artifact
_U = "/monitor/u"


def check_first_spec(admitted: Admitted) -> Admitted:
    """The spec of a sequence's first mesh; raises a 422 problem for a target, and for a mesh in parts."""
    if admitted.spec["target"] is not None:
        raise problem_at("/target", "the meshes of a sequence have one grid: give it in place of the target")
    if admitted.nodes is not None and admitted.spec["schwarz"] is not None:
        raise problem_at("/schwarz", "the steps of a sequence on blocks are solved whole: leave schwarz out")
    if admitted.is_in_parts:
        message = "the meshes of a sequence are computed on one machine: request fewer points, and leave parts out"
        raise problem_at("/parts", message)
    return admitted


@dataclass(frozen=True, kw_only=True)
class PreparedStep:
    """A step that can be requested, and the file of its fields, which is sealed but not published.

    ``settings`` are those of the worker: how the mesh moves, and what is known of the mesh ``before``.
    """

    admitted: Admitted
    settings: Mapping[str, Any]
    fields: Artifact | None
    path: Path | None

    def publish(self, files: Files, removed: Removed) -> None:
        """Give the file of the fields its name."""
        if self.fields is not None and self.path is not None:
            files.publish(self.path, StoredFile(self.fields.sha256, self.fields.size), removed)


@dataclass(frozen=True)
class Stepping:
    """Makes the specs of steps, and stores their functions and fields."""

    admission: Admission
    store: Store
    files: Files

    def prepare(self, move: Move, mesh_id: str, caller: Caller, stack: ExitStack) -> PreparedStep:
        """The spec of the mesh after ``mesh_id``; raises 409 and 422 problems. Files last until ``stack`` closes."""
        spec, mesh = self.store.meshes.spec(mesh_id), self._mesh(mesh_id)
        if spec is None:
            raise _gone()
        checked = move.check(mesh)
        admitted = self._admitted(spec, mesh, move, checked, caller)
        settings = {**self.store.sequences.settings_of(mesh_id), **move.motion, "before": self._before(mesh_id, spec)}
        if not checked.fields:
            return PreparedStep(admitted=admitted, settings=settings, fields=None, path=None)
        path = stack.enter_context(self.files.unfinished(".npz"))
        write_fields(path, checked.fields)
        file = self.files.seal(path)
        fields = Artifact(FIELDS, file.sha256, file.size)
        return PreparedStep(admitted=admitted, settings=settings, fields=fields, path=path)

    def _before(self, mesh_id: str, spec: Mapping[str, Any]) -> dict[str, Any]:
        """The mesh before: its u as a source, the file of its samples, and its gains."""
        row, mesh_input = self.store.meshes.get(mesh_id), self.store.meshes.get_input(mesh_id)
        if row is None or mesh_input is None:
            raise _gone()
        u = spec["monitor"].get("u")
        if u is not None and not u.keys() & {"expression", "samples"}:
            u = None  # long values, which are not stored twice
        samples = None if u is None else mesh_input.samples.get(u.get("samples"))
        certificate = (row.result or {}).get("certificate") or {}
        gains = certificate.get("interpolation_gain") or {}
        return {"u": u, "samples": samples, "gains": gains}

    def _admitted(
        self, spec: Mapping[str, Any], mesh: Mesh | QuadMesh, move: Move, checked: CheckedMove, caller: Caller
    ) -> Admitted:
        """The checked spec of the next mesh, whose functions at nodes are stored as samples."""
        rows: dict[str, SamplesRow] = {}

        def store(_pointer: str, source: Any) -> Any:
            if not isinstance(source, np.ndarray):
                return source
            row = self._keep(mesh, source, caller)
            rows[row.id] = row
            return {"samples": row.id}

        before = spec["monitor"]
        from_u: tuple[str, ...] = (_U,)
        if checked.monitor is None:
            monitor = with_u(before, checked.u)
        else:
            monitor, from_u = completed(checked.monitor, checked.u, before)
        monitor = with_functions(monitor, store)
        document = {**spec, "monitor": monitor}
        sources = [source for _, source in functions_of(monitor)]
        has_file = "file" in (spec.get("domain") or {})
        if checked.monitor is None and not has_file and all(source.get("samples") in rows for source in sources):
            # The settings have been checked, and functions of finite values fit every domain.
            nodes = None if isinstance(mesh, Mesh) else len(mesh.points)
            hashes = {row.id: row.sha256 for row in rows.values()}
            return Admitted(read_spec(document).canonical, hashes, "", nodes=nodes)
        try:
            return self.admission.admit(document, None, caller)
        except Problem as problem:
            if not problem.errors:
                raise
            raise repointed(problem, lambda pointer: sent_pointer(move.sent, _pointer_of(pointer, from_u))) from None

    def _mesh(self, mesh_id: str) -> Mesh | QuadMesh:
        artifact = self.store.meshes.artifact(mesh_id, "mesh")
        if artifact is None:
            raise _gone()
        try:
            with self.files.local(artifact.sha256) as path:
                return load_npz(path).mesh
        except FileNotFoundError:
            raise _gone() from None

    def _keep(self, mesh: Mesh | QuadMesh, u: Array, caller: Caller) -> SamplesRow:
        """Store u as samples, which a monitor can name."""
        with self.files.unfinished(".npz") as path:
            is_grid = isinstance(mesh, Mesh)
            nodes: dict[str, Any] = {"x": mesh.x, "y": mesh.y} if is_grid else {"nodes": mesh.points}
            np.savez(path, values=u, **nodes)
            file = self.files.seal(path)
            kind = "nodal" if is_grid else "block_nodes"
            summary = {"kind": kind, "shape": list(u.shape), "min": float(u.min()), "max": float(u.max())}
            row = SamplesRow(f"{NODAL}{file.sha256[:32]}", file.sha256, file.size, summary, self.store.clock())
            self.store.samples.add(row, partial(self.files.publish, path, file), key_id=caller.key_id)
        return row


def _gone() -> Problem:
    return Problem("conflict", "The mesh that this step follows was deleted.")


def _pointer_of(pointer: str, from_u: tuple[str, ...]) -> str:
    """A pointer into the spec of the mesh as one into the step, whose u is the function at ``from_u``."""
    for place in from_u:
        if pointer == place or pointer.startswith(f"{place}/"):
            return "/u" + pointer.removeprefix(place)
    return pointer
