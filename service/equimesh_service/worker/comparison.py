"""A finished mesh next to the uniform mesh of its size, measured again from its file and its spec."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import equimesh
from equimesh.meshes.mesh_window import MeshWindow
from equimesh.quality.comparison import UniformComparison
from equimesh.solving.measured_mesh import MeasuredMesh


def compare(
    mesh: equimesh.Mesh, problem: equimesh.Problem, certificate: Mapping[str, Any] | None = None
) -> UniformComparison:
    """``mesh`` and the uniform mesh of the domain of ``problem``, with the error of u in each of their cells.

    ``certificate`` is that of the mesh in its JSON form. It says which monitor an ``auto`` has chosen: on triangles
    errors are only measured of a least-error mesh.
    """
    monitor = problem.monitor
    if isinstance(monitor, equimesh.Auto) and _chosen(certificate or {}) == "least_error":
        problem = replace(problem, monitor=monitor.least_error())
    window, u = MeshWindow.of(mesh), problem.monitor.u
    nodal = None if u is None else u.evaluate(mesh.x, mesh.y)[0]
    measured = MeasuredMesh(problem=problem, mesh=window, reference=window, u=lambda: nodal, threads=1)
    return measured.against_uniform(mesh, measured.quality().interpolation_error)


def _chosen(certificate: Mapping[str, Any]) -> str:
    """The kind of the monitor that was chosen among several; empty where it was given."""
    return next((str(one["kind"]) for one in certificate.get("comparison") or () if one["chosen"]), "")
