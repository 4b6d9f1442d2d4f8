"""Pictures of meshes, decompositions and quality: colours, places, and titles."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from equimesh.meshes.mesh import Grid, Mesh
from equimesh.meshes.mesh_data import MeshData
from equimesh.plot.figure import MeshLines
from equimesh.plot.meshes import (
    MAX_LINES,
    OVERLAP_COLOUR,
    SINGLE_COLOUR,
    draw_decomposition,
    draw_mesh,
    draw_quality,
    draw_surface,
)
from equimesh.schwarz.decomposition import Decomposition
from solver.plot.drawings import BLUE, RED, colours, result, strips, texts

matplotlib = pytest.importorskip("matplotlib")


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


@pytest.mark.parametrize(
    ("x", "y", "inches"), [(1, 1, (6, 6.4)), (4, 1, (6, 2.65)), (60, 1, (6, 1.8)), (1, 2, (4, 6.4))]
)
def test_pictures_are_as_wide_and_as_high_as_their_meshes(
    tmp_path: Path, x: int, y: int, inches: tuple[float, float]
) -> None:
    data = result(strips())
    stretched = replace(data, mesh=Mesh(x * data.mesh.x, y * data.mesh.y))
    draw_mesh(stretched, tmp_path / "mesh.png", decomposition=strips())
    height, width = matplotlib.image.imread(tmp_path / "mesh.png").shape[:2]
    assert (width / 150, height / 150) == pytest.approx(inches, abs=0.02)
