"""Pictures: what they show, that equal data give equal files, and that they leave matplotlib as it was."""

from __future__ import annotations

import math
import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from equimesh.errors import InputError
from equimesh.meshes.grid import Grid
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.mesh_data import MeshData
from equimesh.plot.convergence import draw_convergence, draw_histories
from equimesh.plot.mesh_lines import SHARED_OWNER, MeshLines
from equimesh.plot.meshes import (
    MAX_LINES,
    OVERLAP_COLOUR,
    SINGLE_COLOUR,
    SUBDOMAIN_COLOURS,
    draw_decomposition,
    draw_mesh,
    draw_quality,
    draw_surface,
)
from equimesh.schwarz.decomposition import Decomposition

matplotlib = pytest.importorskip("matplotlib")

RED, BLUE = SUBDOMAIN_COLOURS[:2]


def strips(n_xi: int = 12, n_eta: int = 10, overlap: int = 4) -> Decomposition:
    return Decomposition(grid=Grid(n_xi=n_xi, n_eta=n_eta), subdomains=(2, 1), overlap=overlap)


def result(decomposition: Decomposition) -> MeshData:
    """A curved mesh with a bump for u, and cells owned as the decomposition has it."""
    start = Mesh.uniform(decomposition.grid)
    bump = np.sin(np.pi * start.x) * np.sin(np.pi * start.y)
    mesh = Mesh(start.x + 0.1 * bump, start.y - 0.05 * bump)
    area = mesh.corner_jacobians().mean(axis=0)
    return MeshData(mesh=mesh, u=bump, q_eq=area / area.mean(), subdomain=decomposition.owner_of_cells())


def convergence(count: int, *, errors: bool = True, subdomains: int = 2) -> dict[str, Any]:
    """The JSON of a made-up Schwarz iteration."""
    return {
        "iterations": [
            {
                "iteration": k,
                "max_q_eq": 1.2 + 0.4 * 0.5**k,
                "change": None if k == 0 else 0.3**k,
                "error": 0.5**k if errors else None,
                "min_jacobian": 0.5,
                "subdomains": [
                    {
                        "subdomain": s,
                        "newton_steps": 3,
                        "status": "converged",
                        "error_x": 0.5**k if errors else None,
                        "error_y": 0.4**k / 3 if errors else None,
                    }
                    for s in range(subdomains)
                ],
            }
            for k in range(count)
        ],
        "rate": 0.5,
        "predicted_rate": None,
    }


def texts(path: Path) -> str:
    """All text of an SVG: matplotlib keeps it as comments beside the outlines."""
    parser = ElementTree.XMLParser(target=ElementTree.TreeBuilder(insert_comments=True))
    tree = ElementTree.parse(path, parser)
    return "\n".join(node.text or "" for node in tree.iter() if node.tag is ElementTree.Comment)


def colours(path: Path) -> set[str]:
    """All stroke colours of an SVG."""
    styles = ";".join(node.get("style", "") for node in ElementTree.parse(path).iter())
    return {part.split(":")[1].strip() for part in styles.split(";") if part.strip().startswith("stroke:")}


DRAWINGS: dict[str, Callable[[Path], None]] = {
    "mesh": lambda path: draw_mesh(result(strips()), path, decomposition=strips()),
    "decomposition": lambda path: draw_decomposition(strips(), path),
    "quality": lambda path: draw_quality(result(strips()), path),
    "surface": lambda path: draw_surface(result(strips()), path),
    "convergence": lambda path: draw_convergence(convergence(8), path),
    "histories": lambda path: draw_histories({"one": [1, 0.1], "two": [1, 0.2]}, path, title="Two"),
}


@pytest.mark.parametrize("draw", DRAWINGS.values(), ids=DRAWINGS)
class TestEveryDrawing:
    def test_writes_a_png_with_something_on_it(self, draw: Callable[[Path], None], tmp_path: Path) -> None:
        draw(tmp_path / "picture.png")
        image = matplotlib.image.imread(tmp_path / "picture.png")
        assert min(image.shape[:2]) > 500
        assert 0.01 < (image[..., :3].min(axis=-1) < 0.9).mean() < 0.9

    def test_writes_the_same_file_again(self, draw: Callable[[Path], None], tmp_path: Path) -> None:
        for suffix in ("svg", "png"):
            first, second = tmp_path / f"first.{suffix}", tmp_path / f"second.{suffix}"
            draw(first)
            with matplotlib.rc_context({"lines.linewidth": 9, "font.size": 30, "svg.hashsalt": None}):
                draw(second)
            assert first.read_bytes() == second.read_bytes()
        assert "<dc:date>" not in (tmp_path / "first.svg").read_text()

    def test_leaves_the_settings_of_matplotlib_alone(self, draw: Callable[[Path], None], tmp_path: Path) -> None:
        before = dict(matplotlib.rcParams)
        draw(tmp_path / "picture.svg")
        assert dict(matplotlib.rcParams) == before

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
from equimesh.meshes.grid import Grid
assert "matplotlib" not in sys.modules
mesh, cells = Mesh.uniform(Grid(n_xi=4, n_eta=4)), (3, 3)
data = MeshData(mesh=mesh, u=mesh.x, q_eq=np.ones(cells), subdomain=np.zeros(cells, dtype=np.int64))
for draw in (plot.draw_mesh, plot.draw_quality, plot.draw_surface):
    draw(data, sys.argv[1])
assert "matplotlib.pyplot" not in sys.modules
"""
    subprocess.run([sys.executable, "-c", code, str(tmp_path / "picture.png")], check=True, timeout=60)


# The mesh


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


def test_the_mesh_is_red_and_blue_with_a_purple_overlap(tmp_path: Path) -> None:
    data, path = result(strips()), tmp_path / "mesh.svg"
    draw_mesh(data, path, decomposition=strips())
    assert {RED, BLUE, OVERLAP_COLOUR} <= colours(path)
    for label in ("subdomain 1", "subdomain 2", "overlap", "Mesh of 12 × 10 points"):
        assert label in texts(path)
    draw_mesh(data, path)  # the owners of the cells are known, the overlap is not
    assert {RED, BLUE} <= colours(path)
    assert OVERLAP_COLOUR not in colours(path)
    draw_mesh(data, path, decomposition=strips(), show_subdomains=False)
    assert SINGLE_COLOUR in colours(path)
    assert not {RED, BLUE, OVERLAP_COLOUR} & colours(path)
    assert "subdomain" not in texts(path)


def test_the_first_subdomain_is_on_the_left_in_the_picture(tmp_path: Path) -> None:
    draw_mesh(result(strips()), tmp_path / "mesh.png", decomposition=strips())
    image = matplotlib.image.imread(tmp_path / "mesh.png")[:-150, :, :3]  # without the legend below
    place = {}
    for colour in (RED, OVERLAP_COLOUR, BLUE):
        near = np.abs(image - matplotlib.colors.to_rgb(colour)).max(axis=-1) < 0.05
        place[colour] = np.nonzero(near)[1].mean()
    assert place[RED] < place[OVERLAP_COLOUR] < place[BLUE]
    strongest = [int(np.argmax(matplotlib.colors.to_rgb(colour))) for colour in (RED, BLUE)]
    assert strongest == [0, 2]


def test_the_decomposition_names_its_subdomains_and_the_ends_of_the_overlap(tmp_path: Path) -> None:
    path = tmp_path / "decomposition.svg"
    draw_decomposition(strips(12, 10, overlap=4), path)
    for label in (
        r"$\Omega_{1}$",
        r"$\Omega_{2}$",
        "$\\alpha$ \n 4/11",
        "$\\beta$ \n 7/11",
        "12 × 10 points, 4 points",
    ):
        assert label in texts(path)
    draw_decomposition(strips(12, 10, overlap=2), tmp_path / "narrow.png")
    image = matplotlib.image.imread(tmp_path / "narrow.png")[300, :, :3]  # a row above the names
    tints = {
        colour: 1 - 0.4 * (1 - np.array(matplotlib.colors.to_rgb(colour))) for colour in (RED, OVERLAP_COLOUR, BLUE)
    }
    columns = {colour: np.nonzero(abs(image - tint).max(axis=-1) < 0.02)[0] for colour, tint in tints.items()}
    assert columns[RED].max() < columns[OVERLAP_COLOUR].min() < columns[OVERLAP_COLOUR].max() < columns[BLUE].min()
    assert columns[RED].size / columns[OVERLAP_COLOUR].size == pytest.approx(5, rel=0.1)
    blocks = Decomposition(grid=Grid(n_xi=40, n_eta=40), subdomains=(4, 4), overlap=2)
    draw_decomposition(blocks, path)  # too many to name
    assert "16 subdomains" in texts(path)
    assert "Omega" not in texts(path)


def test_large_meshes_are_thinned_and_the_title_says_so(tmp_path: Path) -> None:
    decomposition = strips(601, 5, overlap=2)
    data, path = result(decomposition), tmp_path / "mesh.svg"
    draw_mesh(data, path, decomposition=decomposition)
    assert "one line in 3 drawn" in texts(path)
    assert OVERLAP_COLOUR in colours(path)  # its two columns are among the lines that stay
    lines = MeshLines.of(data.mesh, most=MAX_LINES, decomposition=decomposition)
    assert lines.columns[[0, -1]].tolist() == [0, 600]
    assert {300, 301} <= set(lines.columns.tolist())
    assert lines.columns.size <= MAX_LINES + 3
    draw_surface(data, path)
    assert "one line in 8 drawn" in texts(path)
    draw_mesh(result(strips()), path)
    assert "drawn" not in texts(path)


def test_many_subdomains_are_counted_instead_of_named(tmp_path: Path) -> None:
    decomposition = Decomposition(grid=Grid(n_xi=60, n_eta=5), subdomains=(14, 1), overlap=2)
    draw_mesh(result(decomposition), tmp_path / "mesh.svg", decomposition=decomposition)
    assert "14 subdomains" in texts(tmp_path / "mesh.svg")
    assert "subdomain 1\n" not in texts(tmp_path / "mesh.svg")


def test_quality_of_a_folded_or_perfect_mesh(tmp_path: Path) -> None:
    data, path = result(strips()), tmp_path / "quality.svg"
    draw_quality(data, path)
    assert f"{data.q_eq.max():.4f}" in texts(path)
    assert "grey" not in texts(path)
    q = data.q_eq.copy()
    q[3, 4], q[0, 0] = math.inf, math.nan
    draw_quality(MeshData(mesh=data.mesh, u=data.u, q_eq=q, subdomain=data.subdomain), path)
    assert "2 cells without a finite value in grey" in texts(path)
    for everywhere in (1.0, math.inf):
        same = np.full_like(q, everywhere)
        draw_quality(MeshData(mesh=data.mesh, u=data.u, q_eq=same, subdomain=data.subdomain), path)


# Convergence


def test_convergence_shows_the_components_of_the_error(tmp_path: Path) -> None:
    path = tmp_path / "convergence.svg"
    draw_convergence(convergence(6), path)
    for number in (1, 2):
        assert f"$x$ in subdomain {number}" in texts(path)
        assert f"$y$ in subdomain {number}" in texts(path)
    assert "0.500 measured" in texts(path)
    assert "predicted" not in texts(path)
    draw_convergence(convergence(6, subdomains=9), path)
    assert "in subdomain" not in texts(path)
    assert "error against the single domain" in texts(path)
    draw_convergence({**convergence(6, errors=False), "predicted_rate": 0.25}, path)
    assert "largest change of a node" in texts(path)
    assert "0.250 predicted" in texts(path)


def test_convergence_shows_what_else_is_known_and_marks_what_was_not_asked(tmp_path: Path) -> None:
    path, made = tmp_path / "convergence.svg", convergence(5, errors=False)
    marks = ("took over", "Newton step", "estimated error", "mismatch", "deviation")
    draw_convergence(made, path)
    assert not any(mark in texts(path) for mark in marks)
    for record in made["iterations"]:
        record.update(transmission="linear_robin", estimate=None, mismatch=0.0, deviation=None)
    for record in made["iterations"][3:]:
        record.update(transmission="optimized", estimate=0.2, mismatch=0.1, deviation=0.3, global_step=True)
    draw_convergence(made, path)
    assert "optimized took over from linear_robin" in texts(path)
    assert all(mark in texts(path) for mark in marks)
    assert re.findall(r"^ *(\d+) *$", texts(path), flags=re.MULTILINE)[:5] == ["0", "1", "2", "3", "4"]


def test_convergence_without_numbers(tmp_path: Path) -> None:
    path = tmp_path / "convergence.svg"
    draw_convergence({"iterations": [], "rate": None, "predicted_rate": None}, path)
    assert "single domain" in texts(path)
    for count in (1, 2):
        draw_convergence(convergence(count), path)
        draw_convergence(convergence(count, errors=False), path)
    holes = convergence(4)
    holes["iterations"][2].update(max_q_eq=None, error=math.nan, subdomains=[])
    holes["iterations"][3].update(max_q_eq=math.inf, error=0.0, subdomains=[])
    draw_convergence(holes, path)


@pytest.mark.parametrize(
    ("histories", "marks"),
    [
        ({"ends at nil": [1.0, 1e-8, 0.0]}, {"zero"}),
        ({"blows up": [1.0, math.inf], "has a gap": [1.0, math.nan, 0.1]}, {"infinite"}),
        ({"all": [0.0, math.inf, math.nan]}, {"zero", "infinite"}),
        ({"single": [0.25]}, set()),
        ({"single nil": [0.0]}, {"zero"}),
        ({"constant": [0.5, 0.5, 0.5]}, set()),
        ({"tiny": [5e-324, 1e-300], "huge": [1e300]}, {"zero"}),
        ({"nothing": []}, set()),
        ({}, set()),
    ],
    ids=lambda case: ", ".join(case) if isinstance(case, dict) else "",
)
def test_histories_of_every_kind(histories: dict[str, list[float]], marks: set[str], tmp_path: Path) -> None:
    path = tmp_path / "histories.svg"
    draw_histories(histories, path, title="A title", ylabel="a label", first=1)
    assert {mark for mark in ("zero", "infinite") if mark in texts(path).split()} == marks
    for text in ("A title", "a label", "iteration"):
        assert text in texts(path)


def test_many_long_histories_stay_distinct(tmp_path: Path) -> None:
    histories = {f"p = {number}": [0.9 ** (k * (number + 1)) for k in range(300)] for number in range(16)}
    draw_histories(histories, tmp_path / "many.svg", title="Many")
    for label in histories:
        assert label in texts(tmp_path / "many.svg")
