"""Meshes of triangles by Mmg2d, BAMG of FreeFEM, and Gmsh, for a metric of the curvature of u.

Mmg2d and BAMG take the tensors of our curvature monitor at their vertices, in three passes from the uniform mesh. Gmsh
takes an isotropic size. CPU time is that of the calls which make meshes, without the metric and without files.
"""

from __future__ import annotations

import importlib
import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np
from costs import peers
from made_meshes import BOTTOM, LEFT, RIGHT, TOP, Array, IntArray, Made, Timer, split, uniform, with_vertices

import equimesh as em

FREEFEM = "FreeFem++"
BAMG_SIDES = {1: BOTTOM, 2: RIGHT, 3: TOP, 4: LEFT}
"""The labels of FreeFEM's square."""
BAMG_SCRIPT = """\
mesh Th = readmesh("mesh.msh");
fespace Vh(Th, P1);
Vh m11, m12, m22;
{
  ifstream file("metric.txt");
  for (int i = 0; i < Vh.ndof; i++) { file >> m11[][i]; file >> m12[][i]; file >> m22[][i]; }
}
real begun = clock();
Th = adaptmesh(Th, m11, m12, m22, IsMetric=1, nbvx=1000000, verbosity=0);
cout << "SECONDS " << clock() - begun << endl;
savemesh(Th, "mesh.msh");
"""
ON_CURVE = 1e-9
"""A curve of Gmsh whose nodes have this distance from a side is that side."""


def tensors(u: em.Expression, points: Array) -> Array:
    """The entries m11, m12, m22 of the metric at the points, of shape ``(v, 3)``."""
    return np.column_stack(em.Curvature(u=u).on(em.Rectangle()).metric(points[:, 0], points[:, 1]))


def mmg(u: em.Expression, n: int) -> Made:
    """Mmg2d."""
    library = importlib.import_module("mmgpy")

    def adapted(scale: float) -> Made:
        start, timer = uniform(n), Timer()
        points, cells, edges, tags = start.points, split(start.cells), start.edges, start.tags
        for _ in range(peers.PASSES):
            mesh = library.MmgMesh2D()
            mesh.set_mesh_size(vertices=len(points), triangles=len(cells), edges=len(edges))
            mesh.set_vertices(points)
            mesh.set_triangles(np.ascontiguousarray(cells, dtype=np.int32))
            mesh.set_edges(np.ascontiguousarray(edges, dtype=np.int32), np.ascontiguousarray(tags, dtype=np.int64))
            mesh.set_field("tensor", np.ascontiguousarray(scale * tensors(u, points)))
            with timer.on():
                mesh.remesh(verbose=-1)
            points, cells = np.ascontiguousarray(mesh.get_vertices()), mesh.get_triangles()
            edges, tags = mesh.get_edges_with_refs()
        return Made(points=points, cells=cells, edges=edges, tags=tags, seconds=timer.seconds)

    return with_vertices(adapted, n)


def bamg(u: em.Expression, n: int) -> Made:
    """BAMG, called by a script of FreeFEM; the clock is FreeFEM's, which counts CPU time."""

    def adapted(scale: float) -> Made:
        with tempfile.TemporaryDirectory() as name:
            folder, seconds = Path(name), 0.0
            _freefem(folder, f'savemesh(square({n - 1}, {n - 1}), "mesh.msh");')
            for _ in range(peers.PASSES):
                points, *_ = read_msh(folder / "mesh.msh")
                np.savetxt(folder / "metric.txt", scale * tensors(u, points))
                seconds += float(_freefem(folder, BAMG_SCRIPT).rpartition("SECONDS")[2].split()[0])
            points, cells, edges, tags = read_msh(folder / "mesh.msh")
        return Made(points=points, cells=cells, edges=edges, tags=tags, seconds=seconds)

    return with_vertices(adapted, n)


def read_msh(path: Path) -> tuple[Array, IntArray, IntArray, IntArray]:
    """Points, triangles, edges and their tags of a file in FreeFEM's own format."""
    rows = [line.split() for line in path.read_text().splitlines() if line.strip()]
    vertices, triangles, edges = (int(count) for count in rows[0])
    points = np.array(rows[1 : 1 + vertices], dtype=np.float64)[:, :2]
    cells = np.array(rows[1 + vertices : 1 + vertices + triangles], dtype=np.int64)[:, :3] - 1
    last = np.array(rows[1 + vertices + triangles : 1 + vertices + triangles + edges], dtype=np.int64)
    return points, cells, last[:, :2] - 1, np.array([BAMG_SIDES.get(label, 0) for label in last[:, 2]])


def gmsh(u: em.Expression, n: int) -> Made:
    """Gmsh, Frontal-Delaunay; each curve of its geometry is a side."""
    library = importlib.import_module("gmsh")
    with peers.gmsh_generator(u) as generate:

        def generated(scale: float) -> Made:
            timer = Timer()
            with timer.on():
                points, cells = generate(scale)
            edges, tags = _gmsh_sides(library, points)
            return Made(points=points, cells=cells, edges=edges, tags=tags, seconds=timer.seconds)

        return with_vertices(generated, n)


def _gmsh_sides(library: object, points: Array) -> tuple[IntArray, IntArray]:
    """The edges of the curves of the model that is open, and the side that each curve is."""
    model = library.model  # type: ignore[attr-defined]
    names, *_ = model.mesh.getNodes()
    number = np.zeros(int(names.max()) + 1, dtype=np.int64)
    number[names] = np.arange(names.size)
    edges, tags = [], []
    for _, curve in model.getEntities(1):
        _, nodes = model.mesh.getElementsByType(1, curve)
        found = number[nodes].reshape(-1, 2)
        x, y = points[found].reshape(-1, 2).T
        distances = {LEFT: abs(x), RIGHT: abs(x - 1.0), BOTTOM: abs(y), TOP: abs(y - 1.0)}
        side = next((tag for tag, distance in distances.items() if distance.max() < ON_CURVE), 0)
        edges.append(found)
        tags.append(np.full(len(found), side))
    return np.concatenate(edges), np.concatenate(tags)


def _freefem(folder: Path, script: str) -> str:
    """What FreeFEM prints for a script that runs in this folder."""
    (folder / "script.edp").write_text(script)
    command = [FREEFEM, "-nw", "-v", "0", "script.edp"]
    return subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True).stdout


def has_freefem() -> bool:
    """Whether FreeFEM is installed."""
    return shutil.which(FREEFEM) is not None
