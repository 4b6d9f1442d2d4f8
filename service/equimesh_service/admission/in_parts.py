"""Meshes that a cluster computes in parts: which they are, and what may be requested of them."""

from collections.abc import Iterator

from equimesh_schema.monitors import AnyMonitor
from equimesh_service.problems.problem import problem_at
from equimesh_service.settings import Settings
from equimesh_service.spec.mesh import CheckedSpec

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


def assign(checked: CheckedSpec, settings: Settings) -> CheckedSpec:
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
