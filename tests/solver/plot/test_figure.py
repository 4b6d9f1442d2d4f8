"""Every picture: equal data give equal files, and matplotlib is left as it was."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from equimesh.errors import InputError
from equimesh.plot.meshes import (
    draw_mesh,
)
from solver.plot.drawings import DRAWINGS, result, strips

matplotlib = pytest.importorskip("matplotlib")


@pytest.mark.parametrize("draw", DRAWINGS.values(), ids=DRAWINGS)
class TestEveryDrawing:
    def test_writes_a_png_with_something_on_it(self, draw: Callable[[Path], None], tmp_path: Path) -> None:
        draw(tmp_path / "picture.png")
        image = matplotlib.image.imread(tmp_path / "picture.png")
        assert min(image.shape[:2]) > 500
        assert 0.01 < (image[..., :3].min(axis=-1) < 0.9).mean() < 0.9

    def test_writes_the_same_file_again_whatever_the_settings_and_leaves_these_alone(
        self, draw: Callable[[Path], None], tmp_path: Path
    ) -> None:
        first, second = tmp_path / "first.svg", tmp_path / "second.svg"
        before = dict(matplotlib.rcParams)
        draw(first)
        assert dict(matplotlib.rcParams) == before
        with matplotlib.rc_context({"lines.linewidth": 9, "font.size": 30, "svg.hashsalt": None}):
            draw(second)
        assert first.read_bytes() == second.read_bytes()
        assert "<dc:date>" not in first.read_text()

    def test_refuses_other_formats(self, draw: Callable[[Path], None], tmp_path: Path) -> None:
        with pytest.raises(InputError, match=r"picture\.jpg.*\.png or \.svg"):
            draw(tmp_path / "picture.jpg")
        assert not list(tmp_path.iterdir())

    def test_says_what_to_install(
        self, draw: Callable[[Path], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
        with pytest.raises(ImportError, match=r"pip install 'equimesh\[plot\]'"):
            draw(tmp_path / "picture.png")


def test_a_png_is_the_same_again(tmp_path: Path) -> None:
    for name in ("first", "second"):
        DRAWINGS["mesh"](tmp_path / f"{name}.png")
    assert (tmp_path / "first.png").read_bytes() == (tmp_path / "second.png").read_bytes()


def test_threads_do_not_disturb_each_other(tmp_path: Path) -> None:
    draw_mesh(result(strips()), tmp_path / "alone.svg", decomposition=strips())
    paths = [tmp_path / f"{number}.svg" for number in range(4)]
    before = dict(matplotlib.rcParams)
    with ThreadPoolExecutor(max_workers=3) as pool:
        list(pool.map(DRAWINGS["mesh"], paths))
    assert {path.read_bytes() for path in paths} == {(tmp_path / "alone.svg").read_bytes()}
    assert dict(matplotlib.rcParams) == before


def test_pyplot_is_never_imported_and_matplotlib_only_when_drawing(tmp_path: Path) -> None:
    code = """
import sys
import numpy as np
from equimesh import plot
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.mesh_data import MeshData
from equimesh.meshes.mesh import Grid
assert "matplotlib" not in sys.modules
mesh, cells = Mesh.uniform(Grid(n_xi=4, n_eta=4)), (3, 3)
data = MeshData(mesh=mesh, u=mesh.x, q_eq=np.ones(cells), subdomain=np.zeros(cells, dtype=np.int64))
for draw in (plot.draw_mesh, plot.draw_quality, plot.draw_surface):
    draw(data, sys.argv[1])
assert "matplotlib.pyplot" not in sys.modules
"""
    subprocess.run([sys.executable, "-c", code, str(tmp_path / "picture.png")], check=True, timeout=60)
