"""Common parts of two meshes of blocks: nothing is left out, nothing counts twice."""

from __future__ import annotations

import numpy as np
import pytest

from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.meshes.unrolled import Unrolled
from equimesh.transfers.overlaps import Overlaps, centroids_of, corners_from, longer
from solver.fields.bent_meshes import smooth_mesh
from solver.meshes.quad_cases import bent, corner, disc, ring, strip, turned


@pytest.mark.parametrize(
    ("old", "new"),
    [(corner(5), bent(corner(6), 0.03)), (bent(disc(4), 0.03), disc(4)), (strip(7), strip(5, 0.2, 0.03))],
)
def test_the_parts_fill_every_old_and_every_new_cell(old: QuadMesh, new: QuadMesh) -> None:
    overlaps = Overlaps.of(old, new)
    found = np.bincount(overlaps.cell, overlaps.area, minlength=overlaps.old.area.size)
    assert np.abs(overlaps.covered / overlaps.new.area - 1.0).max() < 1e-12
    assert np.abs(found / overlaps.old.area - 1.0).max() < 1e-12
    for of_axis in (overlaps.of_x, overlaps.of_y):  # the first moments of an old cell are those of its centroid
        assert np.abs(np.bincount(overlaps.cell, of_axis)).max() < 1e-15


def test_a_grid_has_the_same_parts() -> None:
    grids = smooth_mesh(9), smooth_mesh(12, depth=-0.05)
    quads = [QuadMesh(points=grid.points, cells=grid.cells, sides=grid.sides) for grid in grids]
    one, other = Overlaps.of(*grids), Overlaps.of(*quads)
    found = []
    for a, b in ((one, one.area), (other, other.area)):
        assert np.abs(np.bincount(a.cell, b) - one.old.area).max() < 1e-15
        numbers = np.repeat(np.arange(len(a.first) - 1), np.diff(a.first))
        found.append({pair for pair, area in zip(zip(numbers, a.cell, strict=True), b, strict=True) if area > 1e-12})
    assert found[0] == found[1]


def test_cells_beyond_a_curved_side_are_seen() -> None:
    old, new = ring(4), turned(ring(4), 0.15)
    overlaps, nothing = Overlaps.of(old, new), np.zeros(64)
    assert overlaps.beyond.max() > 0.01
    assert np.abs(overlaps.integrals(nothing + 3.0, (nothing, nothing)) / overlaps.new.area - 3.0).max() < 1e-12


def test_a_cell_out_of_reach_has_the_nearest_old_one() -> None:
    old = corner(3)
    away = old.moved(old.points + np.array([9.0, 0.0]))
    overlaps = Overlaps.of(old, away)
    assert (overlaps.covered == 0.0).all()
    values = np.arange(len(old.cells), dtype=float)
    means = overlaps.integrals(values, (0 * values, 0 * values)) / overlaps.new.area
    assert set(old.points[old.cells[means.round().astype(int)]].max(axis=(1, 2))) == {2.0}


def test_more_parts_than_expected_find_room() -> None:
    overlaps = Overlaps.of(corner(24), corner(1))
    assert overlaps.cell.size > 12 * 3 * 24
    assert overlaps.area.sum() == pytest.approx(3.0, abs=1e-12)
    assert np.array_equal(longer(np.array([1, 2]), 5)[:2], [1, 2])


def test_centroids_and_corners_of_copies() -> None:
    mesh, quad = strip(4), np.empty((4, 2))
    x, y = centroids_of(Unrolled.of(mesh))
    assert (x[:16].min(), x.min(), x.max()) == (0.125, -0.875, 1.875)
    assert y.max() == 0.875
    least, most = corners_from((mesh.x.copy(), mesh.y.copy()), mesh.cells[5], 0.25, 0.0, quad)
    assert (least, most, quad[2].tolist()) == ((0.0, 0.25), (0.25, 0.5), [0.25, 0.5])
