"""Every picture: equal data give equal files, and matplotlib is left as it was."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from equimesh.errors import InputError
from equimesh.meshes.mesh import Grid
from equimesh.plot.figure import SHARED_OWNER, MeshLines
from equimesh.plot.meshes import MAX_LINES, draw_mesh
from equimesh.schwarz.decomposition import Decomposition
from solver.plot.drawings import DRAWINGS, result, strips

matplotlib = pytest.importorskip("matplotlib")


@pytest.mark.parametrize("draw", DRAWINGS.values(), ids=DRAWINGS)
class TestEveryDrawing:
    def test_writes_a_png_with_something_on_it(self, draw: Callable[[Path], None], tmp_path: Path) -> None:
        draw(tmp_path / "picture.png")
        image = matplotlib.image.imread(tmp_path / "picture.png")
        assert min(image.shape[:2]) > 500
        assert 0.01 < (image[..., :3].min(axis=-1) < 0.9).mean() < 0.9

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


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=() if name in ("mesh", "histories") else pytest.mark.everything) for name in DRAWINGS],
)
def test_the_same_file_is_written_again_whatever_the_settings_which_are_left_alone(name: str, tmp_path: Path) -> None:
    first, second = tmp_path / "first.svg", tmp_path / "second.svg"
    before = dict(matplotlib.rcParams)
    DRAWINGS[name](first)
    assert dict(matplotlib.rcParams) == before
    with matplotlib.rc_context({"lines.linewidth": 9, "font.size": 30, "svg.hashsalt": None}):
        DRAWINGS[name](second)
    assert first.read_bytes() == second.read_bytes()
    assert "<dc:date>" not in first.read_text()


def test_a_png_is_the_same_again(tmp_path: Path) -> None:
    for name in ("first", "second"):
        DRAWINGS["mesh"](tmp_path / f"{name}.png")
    assert (tmp_path / "first.png").read_bytes() == (tmp_path / "second.png").read_bytes()


def test_threads_do_not_disturb_each_other(tmp_path: Path) -> None:
    draw_mesh(result(strips()), tmp_path / "alone.svg", decomposition=strips())
    paths = [tmp_path / f"{number}.svg" for number in range(3)]
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
    subprocess.run([sys.executable, "-c", code, str(tmp_path / "picture.png")], check=True, timeout=300)


# The lines of a mesh: each edge belongs to one subdomain, or to the overlap, and is drawn once.


def test_edges_belong_to_their_subdomain_and_the_shared_columns_to_the_overlap() -> None:
    decomposition = strips(12, 10, overlap=2)
    assert [part.columns for part in decomposition.parts] == [range(7), range(5, 12)]
    data = result(decomposition)
    lines = MeshLines.of(data.mesh, most=MAX_LINES)
    along_xi, along_eta = lines.owners(data.subdomain, decomposition)
    assert along_xi.shape == (11, 10)
    assert along_eta.shape == (12, 9)
    # Between columns 5 and 6 both subdomains hold the edge; the lines of columns 5 and 6 themselves are shared.
    assert (along_xi == np.array([0] * 5 + [SHARED_OWNER] + [1] * 5)[:, None]).all()
    assert (along_eta == np.array([0] * 5 + [SHARED_OWNER] * 2 + [1] * 5)[:, None]).all()


def test_every_edge_is_drawn_exactly_once() -> None:
    decomposition = Decomposition(grid=Grid(n_xi=14, n_eta=11), subdomains=(2, 2), overlap=3)
    data = result(decomposition)
    lines = MeshLines.of(data.mesh, most=MAX_LINES)
    edges = lines.owners(data.subdomain, decomposition)
    assert set(np.union1d(*edges)) == {SHARED_OWNER, 0, 1, 2, 3}
    drawn = [
        (*map(tuple, np.round(piece[k : k + 2], 12).tolist()),)
        for owner in (SHARED_OWNER, 0, 1, 2, 3)
        for piece in lines.polylines(*edges, owner)
        for k in range(len(piece) - 1)
    ]
    assert len(drawn) == len(set(drawn)) == 13 * 11 + 14 * 10
    nodes = {tuple(point) for point in np.round(data.mesh.points, 12).tolist()}
    assert {end for edge in drawn for end in edge} == nodes
