"""One pass over the cells: in blocks and threads, with u evaluated once, and values only for those who ask."""

from __future__ import annotations

import math

import numpy as np
import pytest

import equimesh as em
from equimesh.monitors.monitor import OfDerivatives
from equimesh.quality import tally
from equimesh.quality.cells import BilinearCells, CellPoints
from equimesh.quality.measures import PER_CELL, measure, measure_all, measure_errors
from equimesh.quality.survey import Statistics, Survey, fill_parts, skewnesses
from equimesh.quality.tally import ErrorRule, ErrorTally
from solver.quality.handmade import TANH20, wavy

RULE = CellPoints.gauss(2)


class Counting:
    """A field that counts the points where it is evaluated."""

    def __init__(self) -> None:
        self.points = 0

    def evaluate(self, x: np.ndarray, y: np.ndarray, order: int = 0) -> tuple[np.ndarray, ...]:
        self.points += x.size
        return TANH20.evaluate(x, y, order)


def of(threads: int, *, keep: bool = False) -> tuple[Survey, ErrorTally]:
    cells = BilinearCells(wavy(150, 141))
    errors = ErrorTally.of(cells, TANH20, ErrorRule.lean())
    monitor = em.ArcLength(u=TANH20, scaled=False)
    return Survey.of(cells, monitor, RULE, tally=errors, threads=threads, keep=keep), errors


def test_threads_change_nothing() -> None:
    (first, alone), (second, shared) = of(1), of(3)
    assert alone.cells.count > tally.MIN_CELLS_FOR_THREADS
    assert second.statistics == first.statistics
    assert np.array_equal(second.q_eq, first.q_eq)
    assert np.array_equal(shared.sums, alone.sums)
    assert shared.range == alone.range
    whole = ErrorTally.of(alone.cells, TANH20, ErrorRule.lean())
    whole.add_all(threads=2)
    assert np.array_equal(whole.sums, alone.sums)


def test_the_statistics_are_those_of_the_values() -> None:
    (found, _), (kept, _) = of(1), of(1, keep=True)
    assert found.kept is None
    assert kept.kept is not None
    assert np.array_equal(kept.q_eq, found.q_eq)
    for values, numbers in zip(kept.kept, found.statistics, strict=True):
        assert (numbers.max, numbers.min) == (values.max(), values.min())
        assert numbers.mean == pytest.approx(values.mean(), rel=1e-12)
        assert numbers.rms == pytest.approx(math.sqrt(np.mean(values**2)), rel=1e-12)


def test_the_values_of_a_large_mesh_are_computed_when_asked_for() -> None:
    mesh, u = wavy(150, 141), Counting()
    quality = measure(mesh, em.ArcLength(u=u, scaled=False))
    before = u.points
    assert quality.q_eq.cells.shape == (149, 140)
    quality.summary()
    assert u.points == before
    for name in PER_CELL[1:]:
        values = getattr(quality, name).cells
        assert values.max() == getattr(quality, name).max, name
    assert u.points == before + mesh.grid.points, "once for all measures"


@pytest.mark.parametrize("kind", [em.ArcLength, em.Curvature])
def test_u_is_evaluated_once_for_metric_and_errors(kind: type[em.ArcLength] | type[em.Curvature]) -> None:
    mesh, u = wavy(70, 70), Counting()
    monitor = kind(u=u).on(em.Rectangle())
    assert isinstance(monitor, OfDerivatives)
    u.points = 0
    errors = measure_errors(mesh, u)
    alone, u.points = u.points, 0
    quality = measure(mesh, monitor)
    assert u.points == alone
    assert quality.interpolation_error == errors
    u.points = 0
    measure_all(mesh, monitor, nodal=TANH20.evaluate(mesh.x, mesh.y)[0])
    assert u.points == alone - mesh.grid.points


def test_metric_and_derivatives_belong_together() -> None:
    x, y = np.random.default_rng(2).random((2, 50))
    for monitor in (em.ArcLength(u=TANH20), em.Curvature(u=TANH20, norm="h1")):
        bound = monitor.on(em.Rectangle())
        assert isinstance(bound, OfDerivatives)
        for entry, expected in zip(
            bound.metric_of(*TANH20.evaluate(x, y, bound.order)), bound.metric(x, y), strict=True
        ):
            assert np.array_equal(entry, expected)


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
