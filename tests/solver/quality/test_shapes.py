"""The shapes of cells: by rows and one by one, in threads, and the extremes and means of numbers in blocks."""

from __future__ import annotations

import math

import numpy as np
import pytest

from equimesh.meshes.mesh import Mesh
from equimesh.quality import tally
from equimesh.quality.cells import BilinearCells, QuadCells, cells_of
from equimesh.quality.faces import measure_faces
from equimesh.quality.shapes import SHAPES, Shapes, Statistics, fill_parts, skewnesses
from solver.quality.handmade import folded, wavy


def as_blocks(mesh: Mesh) -> Mesh:
    """The same cells in the same order, without rows."""
    return Mesh(points=mesh.points, cells=mesh.cells, sides=mesh.sides)


@pytest.mark.parametrize("shape", [(2, 2), (2, 6), (8, 2), (34, 27)])
def test_rows_have_the_shapes_that_their_cells_have_one_by_one(shape: tuple[int, int]) -> None:
    whole = wavy(max(shape[0], 9), max(shape[1], 7))
    mesh = Mesh(whole.x[: shape[0], : shape[1]], whole.y[: shape[0], : shape[1]])
    rows, one_by_one = Shapes.of(BilinearCells(mesh)), Shapes.of(QuadCells(as_blocks(mesh)))
    assert rows.faces is not None
    assert one_by_one.faces is None
    np.testing.assert_allclose(rows.kept, one_by_one.kept, rtol=1e-12)
    np.testing.assert_allclose(rows.statistics, one_by_one.statistics, rtol=1e-12)
    assert rows.cells.lowest == pytest.approx(one_by_one.cells.lowest, rel=1e-12)
    assert rows.cells.total_area == pytest.approx(one_by_one.cells.total_area, rel=1e-12)
    given, expected = measure_faces(mesh, shapes=rows), measure_faces(as_blocks(mesh))
    assert given.summary() == pytest.approx(expected.summary(), rel=1e-9, abs=1e-6)
    assert given.skewness == pytest.approx(expected.skewness, rel=1e-12)


@pytest.mark.parametrize("side", range(4))
def test_the_faces_on_each_side_count(side: int) -> None:
    x, y = np.meshgrid(np.arange(6.0), np.arange(5.0), indexing="ij")
    y[-1] += 0.4  # the largest skewness is that of the faces on the last row
    mesh = Mesh(*(np.rot90(q, side).copy() for q in (x, y)))
    assert measure_faces(mesh).skewness == pytest.approx(measure_faces(as_blocks(mesh)).skewness, rel=1e-12)
    assert measure_faces(mesh).skewness == pytest.approx(0.4)


def test_a_folded_grid_is_measured_cell_by_cell() -> None:
    mesh = folded()
    found, expected = Shapes.of(cells_of(mesh)), Shapes.of(QuadCells(as_blocks(mesh)))
    assert found.faces is None
    assert np.isinf(found.kept[SHAPES.index("size_ratio")]).any()
    np.testing.assert_allclose(found.kept, expected.kept, rtol=1e-12)


def test_threads_and_strips_change_nothing() -> None:
    mesh = wavy(300, 141)
    one, three = (Shapes.of(BilinearCells(mesh), threads=threads) for threads in (1, 3))
    assert one.cells.count > tally.MIN_CELLS_FOR_THREADS
    assert len(one.cells.rows.strips) > 1
    assert (three.statistics, three.faces) == (one.statistics, one.faces)
    assert one._kept is None, "a large mesh keeps no values"
    for values, numbers in zip(one.kept, one.statistics, strict=True):
        assert (numbers.max, numbers.min) == (values.max(), values.min())
        assert numbers.mean == pytest.approx(values.mean(), rel=1e-12)
        assert numbers.rms == pytest.approx(math.sqrt(np.mean(values**2)), rel=1e-12)
    np.testing.assert_allclose(one.kept, Shapes.of(QuadCells(as_blocks(mesh)), keep=True).kept, rtol=1e-12)


def test_the_skewness_is_the_angle_of_its_tangent() -> None:
    tangents = np.concatenate([[0.0, math.inf], np.logspace(-20.0, 20.0, 2001), np.linspace(0.3, 3.0, 2001)])
    expected = np.arctan(tangents) / (0.5 * np.pi)
    skewnesses(tangents)
    assert np.max(np.abs(tangents - expected) / (expected + 1e-300)) < 1e-15


# Extremes and means of numbers in blocks are those of all numbers.


def of_blocks(values: np.ndarray, size: int) -> Statistics:
    blocks = [values[None, start : start + size] for start in range(0, values.size, size)]
    parts = np.empty((len(blocks), 1, 4))
    for block, part in zip(blocks, parts, strict=True):
        fill_parts(block, part)
    return Statistics.of(parts, values.size)[0]


@pytest.mark.parametrize("size", [1, 7, 100, 1000])
def test_blocks_do_not_matter(size: int) -> None:
    values = np.random.default_rng(size).standard_normal(1000)
    found = of_blocks(values, size)
    assert (found.max, found.min) == (values.max(), values.min())
    assert (found.mean, found.rms) == pytest.approx((values.mean(), math.sqrt(np.mean(values**2))), rel=1e-13)
    assert found.times(2.0) == pytest.approx(tuple(2.0 * value for value in found))


def test_numbers_that_are_not_finite_count_as_in_numpy() -> None:
    values = np.arange(1.0, 31.0)
    values[17] = math.inf
    assert of_blocks(values, 5) == Statistics(math.inf, 1.0, math.inf, math.inf)
    values[3] = math.nan
    assert all(math.isnan(value) for value in of_blocks(values, 5))
