"""Files of a finished mesh that a worker writes on request: other formats, pictures, arrays of quality."""

import json
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import equimesh
from equimesh.fields.curved_sides import curved_edges
from equimesh.io.npz import load_npz
from equimesh.io.write import CELLS, FORMATS, write_mesh
from equimesh.solving.solution import MeasuredMesh
from equimesh.specs import subdomains_of
from equimesh_service.assembly.problem import build
from equimesh_service.files.port import Files
from equimesh_service.problems.problem import Problem
from equimesh_service.problems.storage import storage_faults
from equimesh_service.store.rows import Artifact, MeshInput
from equimesh_service.store.store import Store
from equimesh_service.telemetry import log_context, tracing
from equimesh_service.worker.drawing import compare, draw_mesh_row
from equimesh_service.worker.in_parts import PartsLayout, convert_part_file, write_head_file
from equimesh_service.worker.job import CONVERGENCE, DRAWING, MESH, Export, part_artifact
from equimesh_service.worker.part_formats import PART_FORMATS, WRITTEN
from equimesh_service.worker.solve import samples_of
from equimesh_service.worker.summary import NO_ITERATIONS


def export(task: Export) -> Artifact | None:
    """Write the file and add it to the mesh; None when the mesh is gone."""
    here = log_context.LogContext(request_id=task.request_id, mesh_id=task.mesh_id)
    with log_context.enter(here), tracing.continue_span("export", task.trace), storage_faults():
        return _export(task)


def _export(task: Export) -> Artifact | None:
    store, files = task.storage.store(), task.storage.files()
    with files.unfinished(_suffix(task.name)) as path:
        with ExitStack() as sources:
            _write(task, path, store, files, sources)
        file = files.seal(path)
        artifact = Artifact(task.name, file.sha256, file.size)
        kept = store.meshes.add_artifact(task.mesh_id, artifact, partial(files.publish, path, file))
    return artifact if kept else None


def _suffix(name: str) -> str:
    match name.split(":"):
        case ["file", format, _, *_]:
            return FORMATS[format].suffix
        case ["plot", _, format]:
            return f".{format}"
        case ["part", format, _]:
            return PART_FORMATS[format].suffix
        case [name] if name == DRAWING:
            return ".npz"
        case ["head", format]:
            return PART_FORMATS[format].head_suffix
        case _:
            return ".json"


def _write(task: Export, path: Path, store: Store, files: Files, sources: ExitStack) -> None:
    def source(name: str) -> Path:
        return sources.enter_context(files.local(_artifact(task, name, store).sha256))

    match task.name.split(":"):
        case ["file", format, requested, *order]:
            cells, data = next(known for known in CELLS if known == requested), load_npz(source(MESH))
            if order:
                domain = _problem(task, store, files, sources).domain
                data = replace(data, curved=curved_edges(data.mesh, domain))
            write_mesh(path, data, format=format, cells=cells, order=2 if order else 1)
        case ["head", format]:
            write_head_file(path, _layout(task, store), format)
        case ["part", format, number]:
            stored = source(part_artifact(WRITTEN, int(number)))
            convert_part_file(stored, path, _layout(task, store), int(number), format)
        case ["plot", "convergence", _]:
            from equimesh.plot.convergence import draw_convergence

            kept = store.meshes.artifact(task.mesh_id, CONVERGENCE)
            draw_convergence(json.loads(source(CONVERGENCE).read_bytes()) if kept else NO_ITERATIONS, path)
        case ["plot", "comparison", _]:
            from equimesh.plot.meshes import draw_comparison

            mesh, problem = load_npz(source(MESH)).mesh, _problem(task, store, files, sources)
            row = store.meshes.get(task.mesh_id)
            draw_comparison(compare(mesh, problem, ((row and row.result) or {}).get("certificate")), path)
        case ["plot", kind, _]:
            from equimesh.plot.meshes import draw_mesh, draw_quality

            data = load_npz(source(MESH))
            if kind == "quality":
                draw_quality(data, path)
            else:
                draw_mesh(data, path, decomposition=subdomains_of(store.meshes.spec(task.mesh_id) or {}))
        case [name] if name == DRAWING:
            path.write_bytes(_drawing(task, store, files, sources, source))
        case _:
            mesh, problem = load_npz(source(MESH)).mesh, _problem(task, store, files, sources)
            quality = MeasuredMesh(problem=problem, mesh=mesh, reference=mesh).quality()
            path.write_text(json.dumps(quality.summary(arrays=True), allow_nan=False))


def _problem(task: Export, store: Store, files: Files, sources: ExitStack) -> equimesh.Problem[Any]:
    mesh_input = _input(task, store)
    return build(mesh_input.spec, samples_of(mesh_input, files, sources)).problem


def _drawing(task: Export, store: Store, files: Files, sources: ExitStack, source: Callable[[str], Path]) -> bytes:
    row, mesh_input = store.meshes.get(task.mesh_id), _input(task, store)
    if row is None or row.result is None:
        raise Problem("not-found", "The mesh is gone.")
    kept = store.meshes.artifact(task.mesh_id, CONVERGENCE)
    convergence = json.loads(source(CONVERGENCE).read_bytes()) if kept else None
    find = samples_of(mesh_input, files, sources)
    return draw_mesh_row(row, mesh_input.spec, convergence, load_npz(source(MESH)).mesh, find)


def _input(task: Export, store: Store) -> MeshInput:
    mesh_input = store.meshes.get_input(task.mesh_id)
    if mesh_input is None:
        raise Problem("not-found", "The mesh is gone.")
    return mesh_input


def _layout(task: Export, store: Store) -> PartsLayout:
    row = store.meshes.get(task.mesh_id)
    if row is None or row.result is None or "parts" not in row.result:
        raise Problem("not-found", "The mesh is gone.")
    return PartsLayout.of(row.result["parts"], equimesh.Grid(n_xi=row.n_xi, n_eta=row.n_eta))


def _artifact(task: Export, name: str, store: Store) -> Artifact:
    artifact = store.meshes.artifact(task.mesh_id, name)
    if artifact is None:
        raise Problem("not-found", "The mesh is gone.")
    return artifact
