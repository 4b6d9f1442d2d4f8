"""A tally of errors: from nodal values or without them, of all cells or of some."""

from __future__ import annotations

import math

import numpy as np
import pytest

import equimesh as em
from equimesh.domains.domain import map_mesh
from equimesh.quality import tally as tally_module
from equimesh.quality.cell_maps import locate
from equimesh.quality.cells import BilinearCells, CellPoints, UniformCells
from equimesh.quality.survey import mean_metrics
from equimesh.quality.tally import MIDDLE_WEIGHT, ErrorRule, ErrorTally, add_errors, add_middles, add_values
from solver.quality.handmade import TANH20, wavy


def tally(numbers: np.ndarray | None = None, nodal: np.ndarray | None = None) -> ErrorTally:
    found = ErrorTally.of(BilinearCells(wavy()), TANH20, ErrorRule.lean(), numbers, nodal)
    found.add_all()
    return found


def test_some_cells_have_the_errors_that_they_have_among_all() -> None:
    numbers = np.array([3, 90, 17, 42])
    every, some = tally(), tally(numbers)
    assert some.sums == pytest.approx(every.sums[:, numbers], rel=1e-9, abs=1e-15)
    assert some.largest == pytest.approx(every.largest[numbers], rel=1e-9)
    assert every.range[0] < some.range[0] < some.range[1] < every.range[1]


def test_at_edge_points_of_some_cells_u_is_evaluated_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    calls, evaluate = [], type(TANH20).evaluate
    monkeypatch.setattr(
        type(TANH20), "evaluate", lambda u, x, y, order=0: calls.append((x.shape, order)) or evaluate(u, x, y, order)
    )
    found = tally(np.array([3, 90, 17, 42]))
    assert calls == [((4, 4), 0), ((4, 4), 1), ((4, 4), 0)], "the corners, then the points of the rule"
    x, y = found.cells.corners(np.array([3])).reshape(2, 4)
    middles = 0.5 * (x + np.roll(x, -1)), 0.5 * (y + np.roll(y, -1))
    ends = [float(part) for part in (np.min(TANH20.evaluate(*middles)[0]), np.max(TANH20.evaluate(*middles)[0]))]
    assert found.range[0] <= ends[0] <= ends[1] <= found.range[1]


def test_known_nodal_values_change_nothing() -> None:
    nodal = TANH20.evaluate(*BilinearCells(wavy()).nodes)[0]
    for numbers in (None, np.array([3, 90, 17, 42])):
        assert tally(numbers, nodal).sums == pytest.approx(tally(numbers).sums, rel=1e-12)


@pytest.mark.parametrize("rule", [ErrorRule.lean(), ErrorRule.gauss(3)], ids=["lean", "gauss"])
def test_cells_between_lines_have_the_errors_that_they_have_as_any_cells(
    rule: ErrorRule, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tally_module, "BLOCK_POINTS", 400)  # a few rows
    axis, domain, grid = np.linspace(0.0, 1.0, 9), em.Rectangle(x=(0.0, 1.0), y=(0.2, 0.9)), em.Grid(n_xi=20, n_eta=14)
    u = em.GridSamples(x=axis, y=axis, values=np.sin(5.0 * np.add.outer(axis, axis**2)))
    straight = ErrorTally.of(UniformCells(grid, domain), u, rule)
    plain = ErrorTally.of(BilinearCells(map_mesh(em.Mesh.uniform(grid), domain)), u, rule)
    assert straight.lines is not None
    assert plain.lines is None
    for one in (straight, plain):
        one.add_all()
    assert straight.nodal == pytest.approx(plain.nodal, rel=1e-12)
    assert straight.sums[:2] == pytest.approx(plain.sums[:2], rel=1e-9, abs=1e-15)
    assert straight.size == pytest.approx(plain.size, rel=1e-12)
    some = np.array([3, 90, 17, 42])
    for one, other in zip(straight.pieces(some), plain.pieces(some), strict=True):
        assert one == pytest.approx(other, rel=1e-12, abs=1e-12)


def test_a_block_with_nan_has_no_part_in_the_range() -> None:
    found = tally()
    before = found.range
    found.ends.append((math.nan, math.nan))
    assert found.range == before
    found.ends.append((-9.0, 0.0))
    assert found.range == (-9.0, before[1])


# Integrals over cells: exact values, and the same errors whether an edge is evaluated once or twice.


GAUSS = CellPoints.gauss(3)


def test_the_mean_of_a_linear_metric_is_its_value_at_the_centroid() -> None:
    cells = BilinearCells(wavy())
    corners = cells.corners(slice(0, cells.count))
    x, y = np.empty((2, GAUSS.s.size, cells.count))
    locate(corners, GAUSS.s, GAUSS.t, x, y)
    out = np.empty((3, cells.count))
    mean_metrics(corners, cells.area, GAUSS, (np.ones_like(x), x, y), out)
    assert out[0] == pytest.approx(np.ones(cells.count), rel=1e-13)
    x0, x1, x2, x3, y0, y1, y2, y3 = corners
    first, second = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0), (x2 - x0) * (y3 - y0) - (x3 - x0) * (y2 - y0)
    centre = (first * (x0 + x1 + x2) + second * (x0 + x2 + x3)) / (3.0 * (first + second))
    assert out[1] == pytest.approx(centre, rel=1e-12)


def test_errors_of_a_square_by_hand() -> None:
    # u = x^2 on the unit square: e = x - x^2 has the squared integral 1/30, its gradient 1 - 2x the integral 1/3
    corners = np.array([[0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0, 1.0]]).T
    x, values = GAUSS.s[:, None], np.array([[0.0, 1.0, 1.0, 0.0]]).T
    sums, largest = np.zeros((4, 1)), np.zeros(1)
    add_errors(corners, values, x**2, (2.0 * x, np.zeros_like(x)), GAUSS, sums, largest, 0)
    assert sums[:, 0] == pytest.approx([1 / 30, 1 / 3, 0.0, 0.0], abs=1e-15)
    assert largest[0] == pytest.approx(0.25)
    alone, peak = np.zeros(1), np.zeros(1)
    add_values(corners, values, x**2, GAUSS, alone, peak)
    assert (alone[0], peak[0]) == (pytest.approx(1 / 30), largest[0])


def test_middles_shared_by_two_cells_are_those_of_each() -> None:
    cells, edge = BilinearCells(wavy()), ErrorRule.lean().edge
    assert edge.weights == pytest.approx(MIDDLE_WEIGHT)
    x, y = cells.nodes
    (nodal,) = TANH20.evaluate(x, y)
    (of_xi,) = TANH20.evaluate(0.5 * (x[1:] + x[:-1]), 0.5 * (y[1:] + y[:-1]))
    (of_eta,) = TANH20.evaluate(0.5 * (x[:, 1:] + x[:, :-1]), 0.5 * (y[:, 1:] + y[:, :-1]))
    once, once_largest = np.zeros(cells.count), np.zeros(cells.count)
    add_middles((x, y), nodal, (of_xi, of_eta), once, once_largest)
    corners = cells.corners(slice(0, cells.count))
    px, py = np.empty((2, edge.s.size, cells.count))
    locate(corners, edge.s, edge.t, px, py)
    twice, twice_largest = np.zeros(cells.count), np.zeros(cells.count)
    values = cells.corner_values(nodal, np.arange(cells.count))
    add_values(corners, values, TANH20.evaluate(px, py)[0], edge, twice, twice_largest)
    assert once == pytest.approx(twice, rel=1e-10)
    assert once_largest == pytest.approx(twice_largest, rel=1e-10)
