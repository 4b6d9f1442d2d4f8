"""Our meshes compared with those of Mmg2d and Gmsh, for the same functions and numbers of vertices.

Mmg gets the tensors of our curvature monitor at its vertices and adapts in several passes; Gmsh gets an isotropic size
from the same curvature. The time for finding the scale that gives the number of vertices is not counted.
"""

import importlib
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

import equimesh as em
from costs.quadrature import l2_error

Array: TypeAlias = npt.NDArray[np.float64]
IntArray: TypeAlias = npt.NDArray[np.int64]
Triangles: TypeAlias = tuple[Array, IntArray]

FUNCTIONS = {
    "paper": "(1 - exp(15*(x - 1))) * sin(pi*y)",
    "tanh60": "tanh(60*(x + y/2 - 0.75))",
    "ring": "tanh(20*((x - 0.5)**2 + (y - 0.5)**2 - 0.09))",
    "wave": "tanh(50*(y - 0.5 - 0.25*sin(2*pi*x)))",
}
MAX_VERTEX_DEVIATION_SHARE = 0.03
"""Accepted difference from the requested number of vertices, relative."""
MAX_ATTEMPTS = 8
"""Attempts at the number of vertices."""
PASSES = 3
"""Passes of Mmg, after which its error no longer falls."""
SIZES = 257
"""Points a side of the table of sizes for Gmsh."""
AREA_SHARE = 0.43
"""The area of an equilateral triangle of unit edges."""


@dataclass(frozen=True, kw_only=True)
class Meshed:
    """One measured mesh: its function and mesher, its size, its CPU time and its interpolation error."""

    function: str
    mesher: str
    vertices: int
    cpu: float
    l2: float
    note: str = ""

    @property
    def rate(self) -> float:
        """Vertices a second of CPU time."""
        return self.vertices / self.cpu if self.cpu > 0.0 else float("inf")

    @property
    def in_one_second(self) -> float:
        """The error after one second of CPU time, if time grows and the error falls with the number of vertices."""
        return self.l2 * self.cpu

    def plain(self) -> dict[str, Any]:
        """The numbers as plain data, ready for JSON."""
        rate = self.rate if self.cpu > 0.0 else None
        return {**asdict(self), "vertices_per_second": rate, "l2_in_one_second": self.in_one_second}


def compare(n: int, functions: Sequence[str] = tuple(FUNCTIONS)) -> Iterator[Meshed]:
    """All meshes of about ``n`` x ``n`` vertices, by every installed mesher."""
    for name in functions:
        u = em.Expression(FUNCTIONS[name])
        yield from ours(name, u, n)
        if is_installed("mmgpy"):
            yield mmg(name, u, n)
        if is_installed("gmsh"):
            yield gmsh(name, u, n)


def lines(meshes: Iterable[Meshed]) -> Iterator[str]:
    """The lines of a table with a heading, each as soon as its mesh is measured."""
    yield f"{'u':<8}{'mesher':<22}{'vertices':>9}{'CPU [s]':>10}{'vertices/s':>12}{'L2 error':>11}{'in 1 s':>10}"
    for m in meshes:
        rate = f"{m.rate:.0f}" if m.cpu > 0.0 else "-"
        after = f"{m.in_one_second:.1e}" if m.cpu > 0.0 else "-"
        row = f"{m.function:<8}{m.mesher:<22}{m.vertices:>9}{m.cpu:>10.4f}{rate:>12}{m.l2:>11.2e}{after:>10}  {m.note}"
        yield row.rstrip()


def is_installed(name: str) -> bool:
    """Whether a library and the libraries of the system that it needs can be imported."""
    try:
        importlib.import_module(name)
    except (ImportError, OSError):
        return False
    return True


def ours(name: str, u: em.Expression, n: int) -> Iterator[Meshed]:
    """The uniform mesh, and those of the least error and of the arc-length and the curvature monitor."""
    grid = em.Grid(n_xi=n, n_eta=n)
    uniform = em.Mesh.uniform(grid)
    yield measure(name, u, "uniform", 0.0, (uniform.points, uniform.cells))
    monitors: dict[str, em.Monitor] = {
        "LeastError": em.LeastError(u=u),
        "ArcLength": em.ArcLength(u=u),
        "Curvature": em.Curvature(u=u),
    }
    for kind, monitor in monitors.items():
        problem = em.Problem(monitor=monitor, grid=grid)
        em.solve(replace(problem, grid=em.Grid(n_xi=17, n_eta=17)), threads=1, check=False)  # loads the kernels
        begun = time.process_time()
        solution = em.solve(problem, threads=1, check=False)
        seconds = time.process_time() - begun
        relaxed = ", ".join(f"{r.what} {r.reached:.2g}" for r in solution.relaxed)
        note = f"{solution.status}: {relaxed}" if relaxed else str(solution.status)
        mesh = solution.mesh
        yield measure(name, u, f"equimesh {kind}", seconds, (mesh.points, mesh.cells), note)


def mmg(name: str, u: em.Expression, n: int) -> Meshed:
    """Mmg2d, from the uniform mesh, with the tensors of the curvature monitor."""

    def adapt(scale: float) -> Triangles:
        *_, last = mmg_passes(u, n, scale)
        return last

    seconds, found = _scale(adapt, first_scale(n), n**2)
    return measure(name, u, "Mmg2d, Hessian", seconds, found, f"{PASSES} passes")


def mmg_passes(u: em.Expression, n: int, scale: float) -> Iterator[Triangles]:
    """The meshes of Mmg2d after every pass, from the uniform mesh of ``n`` x ``n`` vertices.

    Mmg2d adapts to the tensors of the curvature monitor times ``scale``.
    """
    library = importlib.import_module("mmgpy")
    monitor = em.Curvature(u=u).on(em.Rectangle())
    points, triangles = _uniform_triangles(n)
    for _ in range(PASSES):
        mesh = library.MmgMesh2D(points, np.ascontiguousarray(triangles, dtype=np.int32))
        metric = np.column_stack(monitor.metric(points[:, 0], points[:, 1]))
        mesh.set_field("tensor", np.ascontiguousarray(scale * metric))
        mesh.remesh(verbose=-1)
        points, triangles = np.ascontiguousarray(mesh.get_vertices()), mesh.get_triangles()
        yield points, triangles


def first_scale(n: int) -> float:
    """The scale of the metric that gives about ``n`` x ``n`` vertices.

    The metric has an area of 2; an equilateral triangle of unit edges has 0.43 for each half vertex.
    """
    return AREA_SHARE * n**2


def gmsh(name: str, u: em.Expression, n: int) -> Meshed:
    """Gmsh, Frontal-Delaunay, with an isotropic size from the curvature."""
    with gmsh_generator(u) as generate:
        seconds, found = _scale(generate, first_scale(n), n**2)
    return measure(name, u, "Gmsh, size field", seconds, found, "isotropic")


@contextmanager
def gmsh_generator(u: em.Expression) -> Iterator[Callable[[float], Triangles]]:
    """A function that gives the mesh of Gmsh for a scale of the curvature, while Gmsh is open.

    The table of sizes is evaluated once, before.
    """
    library = importlib.import_module("gmsh")
    monitor = em.Curvature(u=u, isotropic=True).on(em.Rectangle())
    axis = np.linspace(0.0, 1.0, SIZES)
    size = monitor.metric(*np.meshgrid(axis, axis, indexing="ij"))[0] ** -0.5
    with tempfile.TemporaryDirectory() as folder:
        table = Path(folder) / "sizes.dat"

        def generate(scale: float) -> Triangles:
            _write_sizes(table, size / scale**0.5)
            return _gmsh_mesh(library, table)

        library.initialize(interruptible=False)
        try:
            yield generate
        finally:
            library.finalize()


def _gmsh_mesh(library: Any, table: Path) -> Triangles:
    options = {"Terminal": 0, "NumThreads": 1}
    sizes = {"MeshSizeExtendFromBoundary": 0, "MeshSizeFromPoints": 0, "MeshSizeFromCurvature": 0, "Algorithm": 6}
    for prefix, values in (("General", options), ("Mesh", sizes)):
        for key, value in values.items():
            library.option.setNumber(f"{prefix}.{key}", value)
    library.clear()
    library.model.occ.addRectangle(0.0, 0.0, 0.0, 1.0, 1.0)
    library.model.occ.synchronize()
    field = library.model.mesh.field.add("Structured")
    library.model.mesh.field.setString(field, "FileName", str(table))
    library.model.mesh.field.setAsBackgroundMesh(field)
    library.model.mesh.generate(2)
    tags, coordinates, _ = library.model.mesh.getNodes()
    number = np.zeros(int(tags.max()) + 1, dtype=np.int64)
    number[tags] = np.arange(tags.size)
    _, nodes = library.model.mesh.getElementsByType(2)
    return coordinates.reshape(-1, 3)[:, :2], number[nodes].reshape(-1, 3)


def _write_sizes(table: Path, size: Array) -> None:
    """The binary table of a Structured field: origin, spacings and numbers of points, then the values, z first."""
    h = 1.0 / (SIZES - 1)
    layers = np.repeat(size[:, :, None], 2, axis=2)  # below and above the plane
    with table.open("wb") as file:
        np.array([0.0, 0.0, -1.0, h, h, 2.0]).tofile(file)
        np.array([SIZES, SIZES, 2], dtype=np.int32).tofile(file)
        layers.tofile(file)


def _scale(make: Callable[[float], Triangles], scale: float, vertices: int) -> tuple[float, Triangles]:
    """CPU time and mesh for the scale that gives about this number of vertices."""
    for _ in range(MAX_ATTEMPTS):
        begun = time.process_time()
        found = make(scale)
        seconds = time.process_time() - begun
        if abs(len(found[0]) / vertices - 1.0) <= MAX_VERTEX_DEVIATION_SHARE:
            break
        scale *= vertices / len(found[0])
    return seconds, found


def _uniform_triangles(n: int) -> Triangles:
    mesh = em.Mesh.uniform(em.Grid(n_xi=n, n_eta=n))
    return mesh.points, np.concatenate([mesh.cells[:, [0, 1, 2]], mesh.cells[:, [0, 2, 3]]])


def measure(name: str, u: em.Expression, mesher: str, seconds: float, found: Triangles, note: str = "") -> Meshed:
    points, cells = found
    error = l2_error(points, cells, lambda x, y: u.evaluate(x, y)[0])
    return Meshed(function=name, mesher=mesher, vertices=len(points), cpu=seconds, l2=error, note=note)
