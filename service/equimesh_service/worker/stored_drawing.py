"""The drawing of a mesh that the service keeps."""

from collections.abc import Mapping
from typing import Any

import equimesh
from equimesh import Mesh
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.quality import compare_with_uniform
from equimesh.solving.measured_mesh import interpolated_cells
from equimesh.specs import build_schwarz
from equimesh_service.assembly.problem import SamplesOf, build
from equimesh_service.problems.problem import Problem
from equimesh_service.store.rows import MeshRow
from equimesh_service.worker.comparison import of_blocks
from equimesh_service.worker.drawing import arrays_of, document_of, pack


def draw_mesh_row(
    row: MeshRow,
    spec: Mapping[str, Any],
    convergence: Mapping[str, Any] | None,
    mesh: Mesh | QuadMesh,
    find: SamplesOf,
) -> bytes:
    """The drawing of a finished ``mesh`` from its ``row`` in the store, its spec and its history."""
    result = row.result or {}
    schwarz = build_schwarz(spec)
    document = document_of(spec, result, error=row.error, convergence=convergence, schwarz=schwarz, mesh=mesh)
    document["seconds"] = result.get("timings")
    problem = _problem(spec, result["certificate"], find)
    if isinstance(mesh, QuadMesh) or isinstance(problem, equimesh.BlockProblem):
        return pack(document, arrays_of(of_blocks(mesh, problem).against_initial, is_folded=False))
    monitor = problem.monitor
    compared = compare_with_uniform(mesh, monitor, domain=problem.domain, kind=interpolated_cells(monitor))
    return pack(document, arrays_of(compared, is_folded=False))


def _problem(
    spec: Mapping[str, Any], certificate: Mapping[str, Any], find: SamplesOf
) -> equimesh.Problem | equimesh.BlockProblem:
    """The problem that was solved: where the monitor was chosen, that of the chosen one."""
    chosen = next((one for one in certificate.get("comparison", ()) if one["chosen"]), None)
    if spec["monitor"]["kind"] == "auto" and chosen is not None:
        shared = {name: spec["monitor"][name] for name in ("u", "orthogonality") if name in spec["monitor"]}
        monitor = {"kind": chosen["kind"], **shared, **chosen["settings"]}
        try:
            return build({**spec, "monitor": monitor}, find).problem
        except Problem:
            pass  # a candidate that no spec names, such as the uniform mesh
    return build(spec, find).problem
