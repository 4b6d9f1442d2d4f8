"""Other solvers take our meshes, by file and by adaptor: nodes, area, orientation, the four sides, and a solution."""

from __future__ import annotations

import json
import os
import re
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import skfem

import equimesh as em
from equimesh.io import write_mesh
from equimesh_coupling import MeshParts
from solvers import records
from solvers.consumers import poisson
from solvers.environment import ROOT, python_of_consumers
from solvers.records import Record

NAMES = {
    "skfem": "scikit-fem",
    "fipy": "FiPy",
    "mfem": "MFEM",
    "ngsolve": "NGSolve",
    "sfepy": "SfePy",
    "pyvista": "PyVista",
    "vtk": "VTK",
    "gmsh": "Gmsh",
    "meshio": "meshio",
}
FORMATS = ("msh", "vtu", "vtk", "xdmf", "mesh", "su2", "vts", "foam.zip")
PAGE = ROOT / "docs" / "how-to" / "use-in-your-solver.md"
SIZE = 33
# Their sections of the page have code that works on a mesh.
DOCUMENTED = ("fipy", "mfem", "ngsolve", "sfepy", "pyvista")
# L2 errors of bilinear and linear elements on the mesh by arc length, and on the uniform one.
ELEMENTS = {
    "square quads": (1.940e-3, 7.430e-3),
    "square triangles": (3.557e-3, 1.855e-2),
    "annulus quads": (3.516e-3, 1.859e-2),
    "annulus triangles": (6.618e-3, 1.678e-2),
}
# L2 errors at the centres of cells, with FiPy's plain diffusion term: it takes the line of two centres as normal to
# their face, so it is right on the uniform quadrilaterals of the square alone.
PLAIN_FLUXES = {
    "square quads": (1.785e-1, 6.495e-3),
    "square triangles": (2.100e-1, 1.249e-1),
    "annulus quads": (3.585e-1, 2.180e-2),
    "annulus triangles": (2.146e-2, 6.635e-2),
}
# How far the errors of two solvers lie apart that integrate with different points.
SAME = 0.004


@dataclass(frozen=True)
class Meshes:
    """A folder with meshes as files and as arrays, and these arrays by name, such as ``adapted square quads``."""

    folder: Path
    parts: dict[str, MeshParts]


def uniform(domain: em.Domain | None) -> em.Mesh:
    mesh = em.Mesh.uniform(em.Grid(n_xi=SIZE, n_eta=SIZE))
    return mesh if domain is None else em.Mesh(*domain.map(mesh.x, mesh.y))


@pytest.fixture(scope="module")
def meshes(tmp_path_factory: pytest.TempPathFactory) -> Meshes:
    """Square and annulus, quadrilaterals and triangles, adapted and uniform; files of the adapted ones."""
    folder, parts = tmp_path_factory.mktemp("meshes"), {}
    monitor = em.ArcLength(u=em.Expression("tanh(20*(x + y/2 - 0.75))"), scaled=False)
    for name, domain in {"square": em.Rectangle(), "annulus": em.AnnulusSector()}.items():
        problem = em.Problem(monitor=monitor, grid=em.Grid(n_xi=SIZE, n_eta=SIZE), domain=domain)
        data = em.solve(problem).data()
        for cells in ("quad", "triangle"):
            for which, mesh in (("adapted", data.mesh), ("uniform", uniform(domain))):
                title = f"{which} {name} {cells}s"
                found = parts[title] = mesh.mesh_parts(cells)
                arrays: dict[str, Any] = {"points": found.points, "cells": found.cells, **found.sides}
                np.savez(folder / f"{title}.npz", shape=found.shape, **arrays)
            for suffix in FORMATS:
                if (suffix, cells) != ("vts", "triangle"):
                    write_mesh(folder / f"adapted {name} {cells}s.{suffix}", data, cells=cells)
    return Meshes(folder, parts)


def write_documented(name: str, folder: Path) -> None:
    """The code of the docs about a consumer, for its process to run."""
    section = PAGE.read_text().partition(f"\n## {NAMES[name]}\n")[2].partition("\n## ")[0]
    blocks = re.findall(r"^```py\n(.*?)^```$", section, re.MULTILINE | re.DOTALL)
    if name in DOCUMENTED:
        (folder / f"{name}.py").write_text("".join(blocks))


def report_of(name: str, meshes: Meshes, everything: bool) -> dict[str, Any]:
    """What a consumer did with all meshes, in a process of its own."""
    python = python_of_consumers(from_source=name == "sfepy", compile_it=everything)
    path = os.pathsep.join([str(python.parent), os.environ["PATH"]])  # FiPy calls the program gmsh
    env = {**os.environ, "PYTHONPATH": str(ROOT / "client"), "PATH": path, "OMP_NUM_THREADS": "1"}
    script = Path(__file__).parent / "consumers" / "run.py"
    write_documented(name, meshes.folder)
    command = [str(python), str(script), name, str(meshes.folder)]
    done = subprocess.run(command, env=env, capture_output=True, text=True, timeout=300, cwd=meshes.folder)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-4000:]
    report: dict[str, Any] = json.loads((meshes.folder / f"{name}.json").read_text())
    return report


def check_what_arrived(found: dict[str, Any], parts: MeshParts, way: str) -> None:
    """Nodes and sides bit for bit and in our order, the area to rounding, and no cell that is turned over."""
    if way == "vts":  # xi runs first there
        found["nodes"] = np.reshape(found["nodes"], parts.shape[::-1]).T.ravel().tolist()
    assert found["nodes"] == list(range(len(parts.points)))
    x, y = parts.points[parts.cells].transpose(2, 0, 1)
    area = (x * np.roll(y, -1, 1) - y * np.roll(x, -1, 1)).sum() / 2
    assert abs(found["area"] - area) < 1e-12 * area
    assert found["smallest"] > 0
    assert found["sides"] == {side: np.unique(edges).tolist() for side, edges in parts.sides.items()}


def l2_error(values: Any, parts: MeshParts) -> float:
    """The L2 error of values at the nodes, interpolated in the cells."""
    kind = skfem.MeshTri if parts.is_triangular else skfem.MeshQuad
    mesh = kind(parts.points.T.copy(), parts.cells.T.copy())
    basis = skfem.Basis(mesh, mesh.elem(), intorder=10)
    square = skfem.Functional(lambda at: (at["u"] - poisson.w(*at.x)) ** 2)
    return float(np.sqrt(square.assemble(basis, u=basis.interpolate(np.ravel(values)))))


def error_of(found: dict[str, Any], parts: MeshParts) -> float | None:
    if "values" not in found:
        return None
    return float(found["error"]) if "error" in found else l2_error(found["values"], parts)


def check_ways(
    name: str, mesh: str, report: dict[str, Any], meshes: Meshes, errors: tuple[float, float | None]
) -> None:
    """What has arrived of an adapted mesh in each way, which is recorded.

    ``errors`` are the one that is expected on it, and that on the uniform mesh.
    """
    expected, uniform_error = errors
    ways = report["meshes"][f"adapted {mesh}"]
    assert ways, mesh
    for way, found in ways.items():
        parts = meshes.parts[f"adapted {mesh}"]
        check_what_arrived(found, parts, way)
        error = error_of(found, parts)
        assert error is None or abs(error / expected - 1) < SAME, (mesh, way, error)
        records.write(
            Record(
                consumer=name,
                version=report["version"],
                format=way,
                mesh=mesh,
                error=error,
                uniform_error=uniform_error,
                read=True,
                tags=True,
            )
        )


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.needs("gmsh-libraries") if name in ("fipy", "gmsh") else ())
        for name in NAMES
    ],
)
def test_a_consumer_takes_nodes_cells_and_sides_and_solves(name: str, meshes: Meshes, everything: bool) -> None:
    report = report_of(name, meshes, everything)
    expected = PLAIN_FLUXES if name == "fipy" else ELEMENTS
    assert {*report["meshes"]} == {*meshes.parts}
    for mesh, pair in expected.items():
        at_uniform = [
            error_of(found, meshes.parts[f"uniform {mesh}"]) for found in report["meshes"][f"uniform {mesh}"].values()
        ]
        uniform_error = at_uniform[0] if at_uniform else None
        assert uniform_error is None or abs(uniform_error / pair[1] - 1) < SAME, mesh
        check_ways(NAMES[name], mesh, report, meshes, (pair[0], uniform_error))
    assert report.get("carried", True)
    assert report.get("documented", name not in DOCUMENTED)
    for sentence in report["refused"]:
        assert any(words in sentence for words in ("return ", "needs ", "the solver diverged"))
    assert bool(report["refused"]) is report["takes_fields"]
