"""Limited slopes on the cells of blocks."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.transfers.integrals import QuadCells, cells_of
from equimesh.transfers.slopes import continue_quads, edge_to, slopes_of_averages, slopes_of_quads
from solver.fields.bent_meshes import smooth_mesh
from solver.meshes.quad_cases import bent, corner, disc, strip


def test_a_grid_has_the_same_slopes_and_bounds() -> None:
    grid = smooth_mesh(9)
    one = cells_of(grid)
    other = QuadCells.of(QuadMesh(points=grid.points, cells=grid.cells, sides=grid.sides))
    averages = np.round(np.sin(5 * one.x - 3 * one.y), 1)
    for mine, his in zip(
        slopes_of_quads(other, averages, -1.0, 1.0), slopes_of_averages(one, averages, -1.0, 1.0), strict=True
    ):
        assert max(np.abs(a - b).max() for a, b in zip(mine, his, strict=True)) < 1e-12


@pytest.mark.parametrize("mesh", [corner(5), bent(disc(5), 0.02)])
def test_linear_functions_have_exact_slopes_inside(mesh: QuadMesh) -> None:
    cells = QuadCells.of(mesh)
    (g, h), _ = slopes_of_quads(cells, 2 * cells.x - cells.y, -9.0, 9.0)
    exact = (np.abs(g - 2) < 1e-9) & (np.abs(h + 1) < 1e-9)
    assert exact[(cells.links.neighbours >= 0).all(axis=1)].mean() > 0.9


def test_values_go_on_beyond_sides_and_joins() -> None:
    cells = QuadCells.of(strip(5))
    beyond = np.empty((3, 25, 4))
    continue_quads(cells.links, (cells.x, cells.y), cells.y**2, cells.corners, beyond)
    column = cells.y[:5]
    assert beyond[2, 4, 2] == pytest.approx(column[4] ** 2 + column[3] ** 2 - column[2] ** 2)
    assert np.allclose(beyond[:2, 4, 2], [0.1, 1.1])
    assert np.allclose(beyond[0, :5, 3], -0.1)  # through the join, translated
    assert np.allclose(beyond[2, :5, 3], column**2)
    assert edge_to(cells.links.neighbours, 5, 0) == 3


def test_slopes_keep_the_bounds_at_the_corners() -> None:
    cells = QuadCells.of(bent(disc(6), 0.02))
    averages = (cells.x > 0.1).astype(float)
    (g, h), (low, high) = slopes_of_quads(cells, averages, 0.0, 1.0)
    at = (
        averages[:, None]
        + g[:, None] * (cells.corners[0] - cells.x[:, None])
        + h[:, None] * (cells.corners[1] - cells.y[:, None])
    )
    assert np.all((at >= low[:, None] - 1e-12) & (at <= high[:, None] + 1e-12))
    assert (low.min(), high.max()) == (0.0, 1.0)


def test_one_row_of_cells_has_slopes_along_it() -> None:
    x, y = np.meshgrid(np.linspace(0, 1, 6), [0.0, 0.1], indexing="ij")
    grid = em.Mesh(x, y)
    cells = QuadCells.of(QuadMesh(points=grid.points, cells=grid.cells, sides={}))
    (g, h), _ = slopes_of_quads(cells, 3 * cells.x, -9.0, 9.0)
    assert np.allclose(g, 3.0)
    assert np.allclose(h, 0.0)
