"""Pictures of meshes, decompositions and quality: colours, places, and titles."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

import equimesh as em
from block_cases import changed, data_of, in_blocks, l_shape
from equimesh.fields.expression import Expression
from equimesh.meshes.mesh import Grid, Mesh
from equimesh.meshes.mesh_data import MeshData
from equimesh.monitors.metrics import ArcLength
from equimesh.plot.figure import MeshLines, all_edges, colour_cells, drawn_lines, outlines, owners_of_blocks
from equimesh.plot.meshes import (
    MAX_LINES,
    OVERLAP_COLOUR,
    SINGLE_COLOUR,
    draw_comparison,
    draw_decomposition,
    draw_mesh,
    draw_quality,
    draw_surface,
    words,
)
from equimesh.quality.comparison import compare_with_uniform
from equimesh.quality.measures import measure_errors
from equimesh.schwarz.decomposition import Decomposition
from equimesh_coupling.display import DECADES, MIN_DECADES, colours_of
from solver.plot.drawings import BLUE, RED, colours, compared, result, strips, texts
from solver.quality.handmade import wavy

matplotlib = pytest.importorskip("matplotlib")


@pytest.mark.usefixtures("without_layout")
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


@pytest.mark.usefixtures("without_layout")
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


@pytest.mark.usefixtures("without_layout")
def test_many_subdomains_are_counted_instead_of_named(tmp_path: Path) -> None:
    decomposition = Decomposition(grid=Grid(n_xi=60, n_eta=5), subdomains=(14, 1), overlap=2)
    draw_mesh(result(decomposition), tmp_path / "mesh.svg", decomposition=decomposition)
    assert "14 subdomains" in texts(tmp_path / "mesh.svg")
    assert "subdomain 1\n" not in texts(tmp_path / "mesh.svg")


@pytest.mark.usefixtures("without_layout")
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


# The uniform mesh next to the adapted one: one scale of colours, and the gain in words.


@pytest.mark.usefixtures("without_layout")
@pytest.mark.parametrize(
    ("gain", "told"),
    [
        (13.125, "interpolation error 13.1 times smaller, with the same 12 × 10 points"),
        (191.8, "interpolation error 192 times smaller, with the same 12 × 10 points"),
        (0.4, "interpolation error 2.5 times larger, with the same 12 × 10 points"),
        (1.001, "the same interpolation error, with the same 12 × 10 points"),
        (None, "No u is given, so there is no error to compare (12 × 10 points)"),
    ],
)
def test_the_gain_is_told_in_words_below_the_picture(gain: float | None, told: str, tmp_path: Path) -> None:
    comparison = compared(gain)
    assert words(comparison) == told
    draw_comparison(comparison, tmp_path / "pair.svg")
    assert told in texts(tmp_path / "pair.svg")
    assert ("interpolation error of u" in texts(tmp_path / "pair.svg")) == (gain is not None)


@pytest.mark.usefixtures("without_layout")
def test_errors_of_rounding_have_no_gain_and_no_colours(tmp_path: Path) -> None:
    comparison = em.mesh("x", 9).against_uniform
    draw_comparison(comparison, tmp_path / "exact.svg")
    assert words(comparison) == "u is interpolated exactly on both meshes, to rounding (9 × 9 points)"
    assert "interpolation error of u" not in texts(tmp_path / "exact.svg")


@pytest.mark.usefixtures("without_layout")
def test_a_folded_mesh_has_grey_cells_and_no_gain(tmp_path: Path) -> None:
    comparison = compared()
    assert comparison.interpolation is not None
    folded = replace(
        comparison,
        adapted=replace(comparison.adapted, error=np.full((11, 9), np.inf)),
        interpolation=replace(comparison.interpolation, l2=math.inf),
    )
    assert words(folded) == "The mesh is folded, and has no error (12 × 10 points)"
    draw_comparison(folded, tmp_path / "folded.png")
    image = matplotlib.image.imread(tmp_path / "folded.png")[..., :3]
    grey = abs(image - 0x77 / 255).max(axis=-1) < 0.02
    left, right = np.split(grey[:, : image.shape[1] // 2 * 2], 2, axis=1)
    assert left.mean() < 0.01
    assert right.mean() > 0.2


@pytest.mark.usefixtures("without_layout")
def test_both_meshes_have_one_scale_of_colours(tmp_path: Path) -> None:
    draw_comparison(compared(), tmp_path / "pair.png")  # the error is ten times smaller on the right
    image = matplotlib.image.imread(tmp_path / "pair.png")[..., :3]
    palette = matplotlib.colormaps["YlOrRd"]
    places = {}
    for end in (0.0, 1.0):
        near = abs(image - palette(end)[:3]).max(axis=-1) < 0.02
        near[int(0.7 * len(near)) :] = False  # without the scale below
        places[end] = np.nonzero(near)[1].mean() / image.shape[1]
    assert places[1.0] < 0.5 < places[0.0]


def test_the_scale_spans_some_decades_below_the_largest_error() -> None:
    for smallest, decades in ((1e-9, DECADES), (1e-2, 2.0), (0.9, MIN_DECADES)):
        scale = colours_of([np.array([smallest, 0.0, np.inf]), np.array([1.0, np.nan])])
        assert scale.vmax == 1.0
        assert scale.vmin == pytest.approx(10.0**-decades)
    assert (colours_of([]).vmin, colours_of([]).vmax) == (0.1, 1.0)


def test_wide_domains_are_drawn_one_below_the_other(tmp_path: Path) -> None:
    u = em.Expression("tanh(20*(x - 1 - y/2))")
    for domain, is_high in ((em.Rectangle(x=(0, 3)), True), (em.Rectangle(), False)):
        problem = em.Problem(monitor=em.ArcLength(u=u), grid=em.Grid(n_xi=25, n_eta=9), domain=domain)
        solution = em.solve(problem)
        draw_comparison(solution.against_uniform, tmp_path / "pair.png")
        image = matplotlib.image.imread(tmp_path / "pair.png")
        assert (image.shape[0] > 0.75 * image.shape[1]) == is_high
        assert image.shape[1] == 1050


# The lines of blocks in a picture, and the colours of their cells.


def edges_in(lines: list[np.ndarray]) -> set[frozenset[tuple[float, ...]]]:
    pieces = [zip(line.tolist(), line[1:].tolist(), strict=False) for line in lines]
    return {frozenset((tuple(one), tuple(two))) for piece in pieces for one, two in piece}


def without_blocks(mesh: Mesh) -> Mesh:
    return changed(mesh, blocks=(), block_names=())


def test_the_lines_are_the_edges_of_all_cells() -> None:
    mesh = in_blocks(wavy()).mesh
    lines, step = drawn_lines(mesh, 100)
    assert step == 1
    assert edges_in(lines) == edges_in(all_edges(mesh)) == edges_in(drawn_lines(without_blocks(mesh), 100)[0])


def test_few_of_many_lines_are_drawn_with_the_edges_of_the_blocks() -> None:
    mesh = l_shape(12)
    lines, step = drawn_lines(mesh, 4)
    assert step == 3
    assert len(lines) == 3 * 2 * len({0, 3, 6, 9, 11})
    assert edges_in(outlines(mesh)) <= edges_in(lines) < edges_in(all_edges(mesh))


def test_a_block_has_one_owner() -> None:
    data = data_of(l_shape())
    assert owners_of_blocks(data.mesh, data.subdomain) == [0, 1, 2]
    assert owners_of_blocks(data.mesh, np.arange(48)) is None


@pytest.mark.parametrize("known", [True, False])
def test_every_cell_has_the_colour_of_its_value(known: bool) -> None:
    mesh = l_shape() if known else without_blocks(l_shape())
    axes = Figure().add_subplot()
    colour_cells(axes, mesh, np.arange(48.0), norm=Normalize(0.0, 47.0))
    found = np.concatenate([np.ravel(drawn.get_array()) for drawn in axes.collections])
    assert sorted(found) == [*range(48)]
    if known:
        assert np.array_equal(np.ravel(axes.collections[1].get_array()), mesh.block_cells[1].ravel())


@pytest.mark.usefixtures("without_layout")
def test_pictures_of_blocks_name_them(tmp_path: Path) -> None:
    data, path = data_of(l_shape()), tmp_path / "mesh.svg"
    draw_mesh(data, path)
    assert "Mesh of 65 points" in texts(path)
    for name in ("low", "right", "high"):
        assert name in texts(path)
    draw_mesh(data, path, show_subdomains=False)
    assert "high" not in texts(path)
    draw_quality(data, path)
    assert f"{data.q_eq.max():.4f}" in texts(path)
    draw_surface(data, path)
    assert "u on the mesh of 65 points" in texts(path)


@pytest.mark.usefixtures("without_layout")
def test_blocks_are_compared_with_the_mesh_that_they_began_with(tmp_path: Path) -> None:
    u, mesh, before = Expression("tanh(9*(x + y - 1))"), l_shape(), l_shape(bend=0.0)
    errors = measure_errors(mesh, u, uniform=before)
    draw_comparison(
        compare_with_uniform(mesh, ArcLength(u=u, scaled=False), uniform=before, interpolation=errors),
        tmp_path / "both.svg",
    )
    found = texts(tmp_path / "both.svg")
    assert "initial" in found
    assert "uniform" not in found
    assert "with the same 65 points" in found
