"""VTK, PyVista, ParaView and xarray read meshes in parts: nodes, cells and data are those of the whole mesh."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from equimesh.io.write import node_groups
from equimesh_cluster import PARTED_FORMATS, PartData, cut, write_head, write_part
from solver.io.files import adapted
from solvers.environment import python_of_consumers

SCRIPT = Path(__file__).parent / "consumers" / "parted.py"
N_XI, N_ETA = 41, 12
CUTS: tuple[tuple[int, ...], ...] = ((), (13, 20), (9, 17, 30))
# Who reads the format, by the words of the table.
READERS = {"vtk": "VTK", "pyvista": "PyVista", "paraview": "ParaView", "xarray": "xarray"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The mesh in 1, 3 and 4 parts in every format, and as a whole."""
    folder, data = tmp_path_factory.mktemp("parted"), adapted(N_XI, N_ETA)
    assert data.u is not None
    for cuts in CUTS:
        place = folder / str(len(cuts) + 1)
        place.mkdir()
        subdomain = np.searchsorted(cuts, np.arange(N_XI - 1), side="right")[:, None] + np.zeros((1, N_ETA - 1), int)
        arrays = {"x": data.mesh.x, "y": data.mesh.y, "u": data.u, "Q_eq": data.q_eq, "subdomain": subdomain}
        np.savez(place / "whole.npz", node_groups=node_groups(data), **arrays)
        for kind in PARTED_FORMATS.values():
            head = place / f"mesh{kind.suffix}"
            for part in cut(data.mesh, cuts):
                first, last = part.cell_rows
                contents = PartData(nodes={"u": data.u[first : last + 1]}, cells={"Q_eq": data.q_eq[first:last]})
                write_part(head, part, contents)
            write_head(head, grid=data.mesh.grid, cuts=cuts, nodes=("u",), cells=("Q_eq",))
    return folder


def report(name: str, folder: Path, command: list[str]) -> dict[str, dict[str, Any]]:
    """What was read, by the number of parts and the suffix."""
    env = {**os.environ, "OMP_NUM_THREADS": "1", "QT_QPA_PLATFORM": "offscreen"}
    done = subprocess.run(
        [*command, str(SCRIPT), name, str(folder)], env=env, capture_output=True, text=True, timeout=300, cwd=folder
    )
    path = folder / f"{name}.json"
    assert path.exists(), done.stdout[-2000:] + done.stderr[-4000:]
    found: dict[str, dict[str, Any]] = json.loads(path.read_text())
    return found


def check(name: str, found: dict[str, dict[str, Any]]) -> None:
    formats = {kind.suffix: kind for kind in PARTED_FORMATS.values() if READERS[name] in kind.readers}
    for cuts in CUTS:
        count = str(len(cuts) + 1)
        read = {key.removeprefix(count): grid for key, grid in found.items() if key.startswith(count)}
        assert read.keys() == formats.keys()
        for suffix, grid in read.items():
            twice = len(cuts) * N_ETA if suffix == ".pvtu" else 0  # nodes of two pieces
            assert grid["points"] == N_XI * N_ETA + twice
            assert grid["counter-clockwise"]


@pytest.mark.parametrize("name", ["vtk", "pyvista", "xarray"])
def test_a_library_of_pip_reads_meshes_in_parts(name: str, folder: Path) -> None:
    check(name, report(name, folder, [str(python_of_consumers())]))


@pytest.mark.needs("paraview")
def test_paraview_reads_meshes_in_parts(folder: Path) -> None:
    check("paraview", report("paraview", folder, ["pvpython"]))
