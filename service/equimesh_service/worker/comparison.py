"""A finished mesh next to the uniform mesh of its size, measured again from its file and its spec."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import equimesh
from equimesh.meshes.mesh_window import MeshWindow
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.quality.comparison import UniformComparison
from equimesh.solving.measured_mesh import MeasuredMesh


def compare(
    mesh: equimesh.Mesh | QuadMesh,
    problem: equimesh.Problem | equimesh.BlockProblem,
    certificate: Mapping[str, Any] | None = None,
) -> UniformComparison:
    """``mesh`` and the uniform mesh of the domain of ``problem``, with the error of u in each of their cells.

    A mesh of blocks is compared with the initial one.

    ``certificate`` is that of the mesh in its JSON form. It says which monitor an ``auto`` has chosen: on triangles
    errors are only measured of a least-error mesh.
    """
    monitor = problem.monitor
    if isinstance(monitor, equimesh.Auto) and _chosen(certificate or {}) == "least_error":
        problem = replace(problem, monitor=monitor.least_error())
    if isinstance(problem, equimesh.BlockProblem) or isinstance(mesh, QuadMesh):
        return of_blocks(mesh, problem).against_initial
    window, u = MeshWindow.of(mesh), problem.monitor.u
    nodal = None if u is None else u.evaluate(mesh.x, mesh.y)[0]
    measured = MeasuredMesh(problem=problem, mesh=window, reference=window, u=lambda: nodal, threads=1)
    return measured.against_uniform(mesh, measured.quality().interpolation_error)


def of_blocks(mesh: object, problem: object) -> equimesh.BlockSolution:
    """The solution of a problem on blocks whose mesh is known, to measure it."""
    if not isinstance(mesh, QuadMesh) or not isinstance(problem, equimesh.BlockProblem):
        raise TypeError("a mesh of blocks belongs to a problem on blocks")
    return equimesh.BlockSolution(problem=problem, mesh=mesh, status=equimesh.Status.CONVERGED)


def _chosen(certificate: Mapping[str, Any]) -> str:
    """The kind of the monitor that was chosen among several; empty where it was given."""
    return next((str(one["kind"]) for one in certificate.get("comparison") or () if one["chosen"]), "")
