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
from equimesh.quality.survey import Survey
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
    alone.add_edges()
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
    assert u.points == before + mesh.grid.points, "for the alignment alone"


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
