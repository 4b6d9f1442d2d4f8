"""A mesh of a participant of preCICE, against a preCICE in this process (``precice_in_process``)."""

from __future__ import annotations

import runpy
import shutil
import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from coupling import precice_in_process
from coupling.conftest import bent
from equimesh import Mesh
from equimesh_coupling import BadValues, CouplingError, MeshParts, OldLibrary, PreciceMesh

EXAMPLE = Path(__file__).parents[2] / "examples" / "from_outside" / "precice"


@pytest.fixture
def config(tmp_path: Path) -> Path:
    """The example, with four time windows."""
    for name in ("plate.py", "laser.py"):
        shutil.copy(EXAMPLE / name, tmp_path)
    text = (EXAMPLE / "precice-config.xml").read_text().replace('max-time value="1"', 'max-time value="0.2"')
    path = tmp_path / "precice-config.xml"
    path.write_text(text)
    return path


def side_by_side(*calls: Any) -> list[Any]:
    """The results of calls that run at the same time."""
    results: list[Any] = [None] * len(calls)

    def run(number: int) -> None:
        results[number] = calls[number]()

    threads = [threading.Thread(target=run, args=(number,)) for number in range(len(calls))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return results


def test_the_example_moves_its_mesh_and_keeps_the_heat(config: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "precice", precice_in_process)
    mains = [runpy.run_path(str(config.with_name(f"{name}.py")))["main"] for name in ("plate", "laser")]
    (taken, stored, meshes), below = side_by_side(*mains)
    assert len(meshes) == len(below) == 4
    assert taken == pytest.approx(stored, rel=1e-12)
    assert taken > 0.01
    area, centres = meshes[-1].corner_jacobians().mean(axis=0).ravel(), meshes[-1].points[meshes[-1].cells].mean(axis=1)
    angle = 2 * np.pi * 0.2
    spot = 0.5 + 0.25 * np.array([np.cos(angle), np.sin(angle)])
    close = np.hypot(*(centres - spot).T) < 0.08
    assert np.median(area[close]) < 0.6 * np.median(area)


def test_values_come_back_on_the_nodes_also_after_a_move(config: Path) -> None:
    config.write_text(config.read_text().replace('data:scalar name="Heat"', 'data:vector name="Heat"'))
    first, second = Mesh.uniform(bent().grid), bent()
    windows = 4

    def plate() -> list[Any]:
        participant = precice_in_process.Participant("Plate", str(config), 0, 1)
        mesh, read = PreciceMesh(participant, "Plate-Mesh", first), []
        participant.initialize()
        with pytest.raises(CouplingError, match="Plate-Mesh can move in the first step after a complete time window"):
            mesh.move(second)
        for number in range(windows):
            x, y = (first if number == 0 else second).points.reshape(7, 5, 2).transpose(2, 0, 1)
            mesh.write("Temperature", 1 + 2 * x - y)
            participant.advance(participant.get_max_time_step_size())
            read.append(mesh.read("Heat"))
            if number == 0:
                mesh.move(second.mesh_parts("triangle"))
                with pytest.raises(precice_in_process.Error, match="after it has been reset"):
                    mesh.read("Heat")
        return read

    def laser() -> list[Any]:
        participant = precice_in_process.Participant("Laser", str(config), 0, 1)
        mesh, read = PreciceMesh(participant, "Laser-Mesh", first), []
        participant.initialize()
        for _ in range(windows):
            for bad in (np.zeros((7, 5)), np.zeros((7, 5, 3)), np.full((7, 5, 2), np.nan)):
                with pytest.raises(BadValues, match="Heat has"):
                    mesh.write("Heat", bad)
            mesh.write("Heat", first.points.reshape(7, 5, 2))
            participant.advance(participant.get_max_time_step_size())
            read.append(mesh.read("Temperature", 0.0))
        return read

    heat, temperature = side_by_side(plate, laser)
    inside = np.clip(second.points, 0.0, 1.0).reshape(7, 5, 2)  # the other mesh ends there
    assert heat[0] == pytest.approx(first.points.reshape(7, 5, 2), abs=1e-7)
    assert heat[-1] == pytest.approx(inside, abs=1e-7)
    linear = 1 + 2 * first.x - first.y
    assert temperature[0] == pytest.approx(linear, abs=1e-7)
    assert np.abs(temperature[-1] - linear)[1:4, 2:4].max() < 1e-7


class Earlier:
    """A participant in three dimensions, of a version without ``reset_mesh``."""

    def __init__(self) -> None:
        self.points, self.triangles = np.empty(0), np.empty(0)

    def get_mesh_dimensions(self, _: str) -> int:
        return 3

    def requires_mesh_connectivity_for(self, _: str) -> bool:
        return True

    def set_mesh_vertices(self, _: str, positions: Any) -> list[int]:
        self.points = positions
        return list(range(100, 100 + len(positions)))

    def set_mesh_triangles(self, _: str, vertices: Any) -> None:
        self.triangles = vertices


def test_three_dimensions_have_zeros_and_an_early_version_does_not_move(quads: MeshParts) -> None:
    participant = Earlier()
    mesh = PreciceMesh(participant, "M", quads)
    assert (participant.points[:, :2] == quads.points).all()
    assert (participant.points[:, 2] == 0.0).all()
    assert (participant.triangles == 100 + quads.mesh_parts("triangle").cells).all()
    with pytest.raises(OldLibrary, match=r"pyprecice 3\.2"):
        mesh.move(quads)
