"""The lines of blocks in a picture, and the colours of their cells."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from block_cases import data_of, in_blocks, l_shape
from equimesh.fields.expression import Expression
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.monitors.metrics import ArcLength
from equimesh.plot.figure import all_edges, colour_cells, drawn_lines, outlines, owners_of_blocks
from equimesh.plot.meshes import draw_comparison, draw_mesh, draw_quality, draw_surface
from equimesh.quality.comparison import compare_with_uniform
from equimesh.quality.interpolation import interpolation_errors
from solver.plot.drawings import texts
from solver.quality.handmade import wavy


def edges_in(lines: list[np.ndarray]) -> set[frozenset[tuple[float, ...]]]:
    pieces = [zip(line.tolist(), line[1:].tolist(), strict=False) for line in lines]
    return {frozenset((tuple(one), tuple(two))) for piece in pieces for one, two in piece}


def without_blocks(mesh: QuadMesh) -> QuadMesh:
    return replace(mesh, blocks=(), block_names=())


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


def test_blocks_are_compared_with_the_mesh_that_they_began_with(tmp_path: Path) -> None:
    u, mesh, before = Expression("tanh(9*(x + y - 1))"), l_shape(), l_shape(bend=0.0)
    errors = interpolation_errors(mesh, u, before)
    draw_comparison(
        compare_with_uniform(mesh, ArcLength(u=u, scaled=False), uniform=before, interpolation=errors),
        tmp_path / "both.svg",
    )
    found = texts(tmp_path / "both.svg")
    assert "initial" in found
    assert "uniform" not in found
    assert "with the same 65 points" in found
