"""The measures of a mesh of blocks: those of a grid where it is one, and what only blocks have."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import equimesh as em
from block_cases import channel, in_blocks, l_shape
from equimesh.errors import InputError
from equimesh.quality.cells import BilinearCells, QuadCells, cells_of
from equimesh.quality.interpolation import MIN_SAMPLED_CELLS, interpolation_errors, probe_errors, sample
from equimesh.quality.measures import alignment, equidistribution, measure, measure_all, shape_regularity
from equimesh.quality.survey import ROWS
from equimesh.quality.tally import ErrorRule, ErrorTally
from equimesh.quality.triangles import triangle_errors
from solver.quality.handmade import ERRORS, SLOPE, TANH20, folded, uniform, wavy

MONITOR = em.ArcLength(u=TANH20, scaled=False)


@pytest.mark.parametrize("kind", ["quad", "triangle"])
@pytest.mark.parametrize("shape", [(13, 9), (61, 45)])
def test_a_grid_as_blocks_has_the_quality_of_the_grid(shape: tuple[int, int], kind: str) -> None:
    grid, plain = wavy(*shape), uniform(*shape)
    turned = kind == "quad"  # of two equal diagonals the one from the first corner is taken
    whole, before = in_blocks(grid, turned=turned), in_blocks(plain, turned=turned)
    expected = measure_all(grid, MONITOR, kind=kind)
    found = measure_all(whole.mesh, MONITOR, uniform=before.mesh, kind=kind)
    for name in ROWS:
        values = getattr(found, name).cells
        assert values.shape == whole.mesh.cell_shape
        assert values == pytest.approx(getattr(expected, name).cells.ravel()[whole.cells], rel=1e-11), name
        assert getattr(found, name).rms == pytest.approx(getattr(expected, name).rms, rel=1e-12)
    assert found.min_jacobian == pytest.approx(expected.min_jacobian, rel=1e-12)
    assert found.interpolation_error is not None
    for name in ERRORS:
        there = getattr(expected.interpolation_error, name)
        assert getattr(found.interpolation_error, name) == pytest.approx(there, rel=1e-9), name
    assert isinstance(found.summary(arrays=True)["q_geo"]["cells"][0], float)


def test_threads_and_single_measures_agree() -> None:
    mesh = in_blocks(wavy(150, 141)).mesh
    two = measure_all(mesh, MONITOR, uniform=mesh, threads=2)
    assert two.q_eq.cells == pytest.approx(equidistribution(mesh, MONITOR), rel=1e-14)
    assert two.q_ali.cells == pytest.approx(alignment(mesh, MONITOR), rel=1e-14)
    assert two.q_geo.cells == pytest.approx(shape_regularity(mesh), rel=1e-14)
    assert two.interpolation_error.gain_l2 == 1.0


def test_without_a_mesh_to_compare_with_there_is_no_gain() -> None:
    mesh = l_shape()
    found = measure(mesh, MONITOR).interpolation_error
    assert found.l2 == pytest.approx(interpolation_errors(mesh, TANH20).l2, rel=0.05)
    assert math.isnan(found.l2_uniform)
    assert math.isnan(found.gain_l2)
    assert measure(mesh, MONITOR).summary()["interpolation_error"]["gain_l2"] is None
    assert math.isnan(triangle_errors(mesh, TANH20).gain_l2)
    for other in (l_shape(4), wavy()):
        with pytest.raises(InputError, match="compare it with the mesh that it began with"):
            interpolation_errors(mesh, TANH20, other)


def test_a_folded_cell_spoils_what_it_touches() -> None:
    whole = in_blocks(folded())
    quality = measure(whole.mesh, MONITOR, uniform=whole.mesh)
    expected = measure(folded(), MONITOR)
    for name in ("q_eq", "q_geo", "size_ratio"):
        found = getattr(quality, name).cells
        assert np.array_equal(np.isinf(found), np.isinf(getattr(expected, name).cells.ravel()[whole.cells])), name
    assert quality.interpolation_error.l2 == math.inf
    broken = replace(whole.mesh, points=np.where(np.arange(36)[:, None] == 7, np.nan, whole.mesh.points))
    assert not cells_of(broken).all_valid


def test_cells_across_a_join_are_neighbours() -> None:
    """The cells at both ends of the channel differ in size from those next to them by the join alone."""
    mesh = channel()
    x = mesh.points[:, 0].copy()
    x[mesh.blocks[0][1]] -= 0.5 * (x[mesh.blocks[0][1]] - x[mesh.blocks[0][0]])
    narrow = mesh.moved(np.column_stack([x, mesh.points[:, 1]]))
    ratios = measure(narrow, em.ArcLength(u=SLOPE, scaled=False)).size_ratio.cells[narrow.block_cells[0]]
    cut = replace(narrow, ties=mesh.ties[:0])
    apart = measure(cut, em.ArcLength(u=SLOPE, scaled=False)).size_ratio.cells[narrow.block_cells[0]]
    assert ratios[-1] == pytest.approx(np.full(4, 2.0), rel=0.2)
    assert apart[-1] == pytest.approx(np.full(4, 1.0), rel=0.2)
    assert ratios[1:-1] == pytest.approx(apart[1:-1])


def test_a_sample_of_many_cells_gives_the_errors_of_all() -> None:
    mesh, plain = in_blocks(wavy(460, 400)).mesh, in_blocks(uniform(460, 400)).mesh
    cells = QuadCells(mesh)
    numbers = sample(cells.rows)
    assert numbers is not None
    assert MIN_SAMPLED_CELLS <= numbers.size <= 3 * MIN_SAMPLED_CELLS
    found = interpolation_errors(mesh, TANH20, plain)
    tally = ErrorTally.of(cells, TANH20, ErrorRule.lean())
    tally.add_all(2)
    tally.add_edges()
    assert found.l2 == pytest.approx(math.sqrt(tally.sums[0].sum()), rel=0.01)


def test_probes_find_the_largest_error_of_a_spike() -> None:
    u = em.Expression("exp(-400*((x - 0.613)**2 + (y - 0.307)**2))")
    grid = wavy(31, 21)
    (error, x, y), variation = probe_errors(in_blocks(grid).mesh, u)
    expected, of_grid = probe_errors(grid, u)
    assert (error, variation) == pytest.approx((expected.value, of_grid), rel=0.05)
    assert math.hypot(x - expected.x, y - expected.y) < 0.1


def test_corners_areas_and_values() -> None:
    grid = wavy()
    whole = in_blocks(grid)
    cells, plain = QuadCells(whole.mesh), BilinearCells(grid)
    assert cells.area == pytest.approx(plain.area[whole.cells], rel=1e-12)
    assert cells.total_area == pytest.approx(plain.total_area, rel=1e-12)
    chosen = np.array([0, 5, 70])
    corners = cells.corners(chosen)
    assert cells.corner_values(whole.mesh.x, chosen) == pytest.approx(corners[:4])
    turned = [sorted(zip(column[:4], column[4:], strict=True)) for column in corners.T]
    there = [sorted(zip(column[:4], column[4:], strict=True)) for column in plain.corners(whole.cells[chosen]).T]
    assert turned == there
    assert {*cells.cuts} == {int(np.flatnonzero(whole.cells == k)[0]) for k in plain.cuts}
    assert isinstance(cells_of(grid), BilinearCells)


def test_the_l_has_its_area() -> None:
    cells = QuadCells(l_shape(bend=0.0))
    assert cells.total_area == pytest.approx(3.0)
    assert cells.all_valid
