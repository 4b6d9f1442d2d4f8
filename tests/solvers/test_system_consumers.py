"""Solvers of the system take our meshes: nodes, area, orientation, the four sides, and a solution."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import equimesh as em
from equimesh.io import write_mesh
from solvers import records
from solvers.environment import ROOT
from solvers.records import Record
from solvers.test_consumers import ELEMENTS, PAGE, SAME, SIZE, Meshes, check_ways, check_what_arrived, error_of
from solvers.test_consumers import meshes as meshes

NAMES = {
    "dolfinx": "FEniCSx dolfinx",
    "dmplex": "PETSc DMPlex",
    "freefem": "FreeFEM",
    "dealii": "deal.II",
    "openfoam": "OpenFOAM",
    "paraview": "ParaView",
}
# Its program is compiled from C++ for a minute.
COMPILED = {"dealii": [pytest.mark.everything]}
PROGRAMS = {"dmplex": "petsc4py", "dealii": "deal.II"}
# Debian's interpreter has Debian's libraries, ParaView one of its own; the others are programs.
PYTHONS = {"dolfinx": ["/usr/bin/python3"], "dmplex": ["/usr/bin/python3"], "paraview": ["pvpython"]}
# L2 errors at the centres of the cells, of OpenFOAM with 40 corrections for angles between faces and centres.
VOLUMES = {
    "square quads": (7.562e-3, 6.498e-3),
    "square triangles": (1.855e-3, 1.134e-2),
    "annulus quads": (1.129e-2, 2.146e-2),
    "annulus triangles": (5.421e-3, 1.901e-2),
}
# The same on the meshes of the preset for finite volumes: at least this many times smaller than on the uniform mesh.
PRESET = "OpenFOAM, mesh for finite volumes"
PRESET_GAINS = {"square quads": 2.5, "square triangles": 1.8, "annulus quads": 2.5, "annulus triangles": 1.8}
UNIFORM_FORMATS = ("msh", "mesh", "foam.zip")
CONSUMERS = Path(__file__).parent / "consumers"
# Compiling the program of deal.II, and the forms of dolfinx, takes the longest.
RUN_SECONDS = 600


@pytest.fixture(scope="module")
def all_meshes(meshes: Meshes) -> Meshes:
    """The meshes, the uniform ones as files, too: these consumers have no adaptor."""
    for title, parts in meshes.parts.items():
        if title.startswith("uniform"):
            x, y = parts.points.T.reshape(2, *parts.shape).copy()
            none = np.zeros((parts.shape[0] - 1, parts.shape[1] - 1))
            data = em.MeshData(mesh=em.Mesh(x, y), u=None, q_eq=none, subdomain=none.astype(np.int64))
            for suffix in UNIFORM_FORMATS:
                cells: Any = "triangle" if parts.is_triangular else "quad"
                write_mesh(meshes.folder / f"{title}.{suffix}", data, cells=cells)
    return meshes


def environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(ROOT / "client"), "OMP_NUM_THREADS": "1"}


def report_of(name: str, folder: Path) -> dict[str, Any]:
    """What a consumer did with all meshes of a folder, in a process of its own."""
    command = [*PYTHONS.get(name, [sys.executable]), str(CONSUMERS / "run.py"), name, str(folder)]
    done = subprocess.run(
        command, env=environment(), capture_output=True, text=True, timeout=RUN_SECONDS, cwd=folder, check=False
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-4000:]
    report: dict[str, Any] = json.loads((folder / f"{name}.json").read_text())
    return report


@pytest.mark.external
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.needs(PROGRAMS.get(name, name)), *COMPILED.get(name, ())])
        for name in NAMES
    ],
)
def test_a_consumer_of_the_system_takes_a_mesh_and_solves(name: str, all_meshes: Meshes) -> None:
    meshes = all_meshes
    report = report_of(name, meshes.folder)
    expected = VOLUMES if name == "openfoam" else ELEMENTS
    assert {*report["meshes"]} == {m for m in meshes.parts if name != "freefem" or m.endswith("triangles")}
    for mesh in (mesh for mesh in expected if f"adapted {mesh}" in report["meshes"]):
        uniform = error_on_uniform(name, mesh, report, meshes, expected)
        check_ways(NAMES[name], mesh, report, meshes, (expected[mesh][0], uniform))
    assert report.get("carried", True)
    for sentence in report["refused"]:
        assert any(words in sentence for words in ("return ", "needs "))
    assert bool(report["refused"]) is report["takes_fields"]


def error_on_uniform(
    name: str, mesh: str, report: dict[str, Any], meshes: Meshes, expected: dict[str, tuple[float, float]]
) -> float | None:
    """The error on the uniform mesh, which went there by the adaptor, or else in the first file."""
    parts = meshes.parts[f"uniform {mesh}"]
    errors = [error_of(found, parts) for found in report["meshes"][f"uniform {mesh}"].values()]
    for error in errors:
        assert error is None or abs(error / expected[mesh][1] - 1) < SAME, (name, mesh, error)
    return errors[0] if errors else None


@pytest.fixture(scope="module")
def preset(all_meshes: Meshes, tmp_path_factory: pytest.TempPathFactory) -> Meshes:
    """The meshes that the preset for finite volumes chooses, and the uniform ones."""
    folder, parts = tmp_path_factory.mktemp("preset"), {}
    for path in all_meshes.folder.glob("uniform *"):
        if path.name.endswith((".npz", ".foam.zip")):
            shutil.copy(path, folder)
    u = em.Expression("tanh(20*(x + y/2 - 0.75))")
    for name, domain in {"square": em.Rectangle(), "annulus": em.AnnulusSector()}.items():
        monitor = em.Auto(u=u, purpose="finite_volume")
        data = em.solve(em.Problem(monitor=monitor, grid=em.Grid(n_xi=SIZE, n_eta=SIZE), domain=domain)).data()
        kinds: tuple[Any, ...] = ("quad", "triangle")
        for cells in kinds:
            title = f"adapted {name} {cells}s"
            found = parts[title] = data.mesh.mesh_parts(cells)
            arrays: dict[str, Any] = {"points": found.points, "cells": found.cells, **found.sides}
            np.savez(folder / f"{title}.npz", shape=found.shape, **arrays)
            write_mesh(folder / f"{title}.foam.zip", data, cells=cells)
    return Meshes(folder, {**all_meshes.parts, **parts})


@pytest.mark.external
@pytest.mark.everything
@pytest.mark.needs("openfoam")
def test_openfoam_gains_on_meshes_for_finite_volumes(preset: Meshes) -> None:
    report = report_of("openfoam", preset.folder)
    for mesh, least in PRESET_GAINS.items():
        uniform = error_on_uniform("openfoam", mesh, report, preset, VOLUMES)
        found = report["meshes"][f"adapted {mesh}"]["foam.zip"]
        check_what_arrived(found, preset.parts[f"adapted {mesh}"], "foam.zip")
        error = error_of(found, preset.parts[f"adapted {mesh}"])
        assert error is not None
        assert uniform is not None
        assert uniform / error > least, (mesh, error)
        records.write(
            Record(
                consumer=PRESET,
                version=report["version"],
                format="foam.zip",
                mesh=mesh,
                error=error,
                uniform_error=uniform,
                read=True,
                tags=True,
            )
        )


@pytest.mark.external
@pytest.mark.parametrize(
    ("name", "expected"),
    [
        pytest.param("dolfinx", "[1, 2, 3, 4]", marks=pytest.mark.needs("dolfinx")),
        pytest.param("dmplex", "32", marks=pytest.mark.needs("petsc4py")),
    ],
)
def test_the_code_of_the_page_reads_a_mesh(name: str, expected: str, all_meshes: Meshes, tmp_path: Path) -> None:
    for path in all_meshes.folder.glob("adapted square quads*"):
        data = path.read_bytes()
        if path.suffix == ".xdmf":  # it names the file of its arrays
            data = data.replace(b"adapted square quads", b"mesh")
        (tmp_path / path.name.replace("adapted square quads", "mesh")).write_bytes(data)
    title = {"dolfinx": "FEniCSx (dolfinx)", "dmplex": "PETSc DMPlex"}[name]
    section = PAGE.read_text().partition(f"\n## {title}\n")[2].partition("\n## ")[0]
    code = "".join(re.findall(r"^```py\n(.*?)^```$", section, re.MULTILINE | re.DOTALL))
    shown = {"dolfinx": "print(sorted({*sides.values.tolist()}))", "dmplex": "print(left.getLocalSize())"}[name]
    command = [*PYTHONS[name], "-c", f"{code}\n{shown}"]
    done = subprocess.run(
        command, cwd=tmp_path, env=environment(), capture_output=True, text=True, timeout=RUN_SECONDS, check=False
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-4000:]
    assert done.stdout.strip().splitlines()[-1] == expected


@pytest.mark.external
@pytest.mark.needs("dolfinx")
@pytest.mark.parametrize(
    "mesh",
    [pytest.param(mesh, marks=() if mesh == "annulus triangles" else pytest.mark.everything) for mesh in ELEMENTS],
)
def test_dolfinx_on_two_processes_has_the_same_mesh(mesh: str, all_meshes: Meshes) -> None:
    meshes = all_meshes
    name, report = meshes.folder / f"adapted {mesh}", meshes.folder / "parallel.json"
    mpirun = ["mpirun", "--allow-run-as-root", "--oversubscribe", "-n", "2", "/usr/bin/python3"]
    command = [*mpirun, str(CONSUMERS / "parallel.py"), f"{name}.xdmf", f"{name}.npz", str(report)]
    done = subprocess.run(command, env=environment(), capture_output=True, text=True, timeout=RUN_SECONDS, check=False)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-4000:]
    parts = meshes.parts[f"adapted {mesh}"]
    x, y = parts.points[parts.cells].transpose(2, 0, 1)
    area = (x * np.roll(y, -1, 1) - y * np.roll(x, -1, 1)).sum() / 2
    for found in json.loads(report.read_text()).values():
        assert (found["processes"], found["here"], found["cells"]) == (2, 2, len(parts.cells))
        assert abs(found["area"] - area) < 1e-12
        for side, edges in parts.sides.items():
            ends = parts.points[edges]
            lengths = ((ends[:, 1] - ends[:, 0]) ** 2).sum(axis=1) ** 0.5
            assert abs(found["sides"][side] - lengths.sum()) < 1e-12
        assert abs(found["error"] / ELEMENTS[mesh][0] - 1) < SAME
