"""Layers inside a cell: their interpolation errors are integrated finely enough, or not called known."""

from __future__ import annotations

import math

import numpy as np
import pytest

import equimesh as em
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.rows import Rows
from equimesh.quality import resolution
from equimesh.quality.cells import BilinearCells, CellPoints
from equimesh.quality.interpolation import InterpolationErrors
from equimesh.quality.measures import measure_errors
from equimesh.quality.resolution import all_but_the_smallest, largest_of, scattered, scattered_between
from equimesh_cluster.messages import Channel, ThreadChannels
from equimesh_cluster.parts.rows import PartRows
from solver.quality.handmade import uniform, wavy


def by_many_points(mesh: Mesh, u: em.Expression, points: int = 120) -> tuple[float, float]:
    """The errors by the midpoint rule with ``points`` points a direction in every cell."""
    cells, middles = BilinearCells(mesh), (np.arange(points) + 0.5) / points
    s, t = (q.ravel()[:, None] for q in np.meshgrid(middles, middles, indexing="ij"))
    rule, squares = CellPoints(s.ravel(), t.ravel(), np.ones(s.size)), np.zeros(2)
    nodal = u.evaluate(*cells.nodes)[0]
    for numbers in np.array_split(np.arange(cells.count), max(1, cells.count // 64)):
        at, (a, b, c, d) = cells.at(rule, numbers), cells.corner_values(nodal, numbers)
        there, u_x, u_y = u.evaluate(at.x, at.y, order=1)
        error = (1 - s) * (1 - t) * a + s * (1 - t) * b + s * t * c + (1 - s) * t * d - there
        along_s, along_t = (1 - t) * (b - a) + t * (c - d), (1 - s) * (d - a) + s * (c - b)
        error_x = (along_s * at.y_t - along_t * at.y_s) / at.det - u_x
        error_y = (along_t * at.x_s - along_s * at.x_t) / at.det - u_y
        squares += [np.sum(at.det * error**2), np.sum(at.det * (error_x**2 + error_y**2))]
    l2, h1 = np.sqrt(squares / points**2)
    return float(l2), float(h1)


def measured(mesh: Mesh, u: em.Expression) -> InterpolationErrors:
    found = measure_errors(mesh, u)
    assert found is not None
    return found


@pytest.mark.parametrize(
    ("mesh", "u"),
    [
        (uniform(17), "exp(-x/.001) + exp(-y/.001)"),
        (wavy(17, 12), "tanh(300*(x + y - 0.15))"),
        (wavy(17, 12), "tanh(100*(x - 0.37))"),
    ],
    ids=["uniform", "wavy", "wavy, along y"],
)
def test_a_layer_inside_a_cell_is_measured_to_a_few_percent(mesh: Mesh, u: str) -> None:
    field = em.Expression(u)
    found = measured(mesh, field)
    assert found.resolved == (True, True)
    assert (found.l2, found.h1) == pytest.approx(by_many_points(mesh, field), rel=0.04)
    assert (found.l2_uniform, found.h1_uniform) == pytest.approx(
        by_many_points(uniform(*mesh.x.shape), field), rel=0.04
    )


@pytest.mark.parametrize("u", ["where(x + y < 0.9, 0, 1)", "exp(-x/1e-6)"])
@pytest.mark.parametrize("n", [9, 33, 65])
def test_a_gradient_that_no_rule_resolves_is_not_called_known(u: str, n: int) -> None:
    found = measured(wavy(n, n), em.Expression(u))
    assert found.resolved == (True, False)
    assert found.gain_l2 > 0.0
    assert math.isnan(found.gain_h1)


@pytest.mark.parametrize(
    ("steep", "share"), [("abs(x - {c})", 0.05), ("abs(x - {c})", 0.94), ("log(1 + exp(600*(x - {c})))/300", 0.04)]
)
def test_what_lies_between_the_points_of_two_rules_is_measured(steep: str, share: float) -> None:
    # One column of cells holds a kink or a layer where neither rule has a point; all others hold a wave. A descent
    # moves nodes to such places, since its own rule has no point there.
    u = em.Expression(steep.format(c=(16 + share) / 32) + " + sin(5*x)")
    found = measured(uniform(33, 18), u)
    assert found.h1 == pytest.approx(by_many_points(uniform(33, 18), u, 50)[1], rel=0.02)


def test_a_resolved_function_takes_few_points_more() -> None:
    u, points = em.Expression("(1 - exp(15*(x - 1)))*sin(pi*y)"), []

    class Counting:
        def evaluate(self, x: np.ndarray, y: np.ndarray, order: int = 0) -> tuple[np.ndarray, ...]:
            points.append(x.size)
            return u.evaluate(x, y, order)

    mesh = wavy(65, 65)
    assert measured(mesh, Counting()).resolved == (True, True)  # type: ignore[arg-type]
    rule = mesh.grid.points + 6 * mesh.grid.cells  # nodes, 4 Gauss points, the middles of edges that two cells share
    assert 2 * rule < sum(points) < 1.25 * 2 * rule


def test_the_cost_of_a_function_that_nothing_resolves_is_bounded() -> None:
    noise, points = np.random.default_rng(0), []

    class Noise:
        def evaluate(self, x: np.ndarray, y: np.ndarray, order: int = 0) -> tuple[np.ndarray, ...]:
            points.append(x.size)
            return tuple(noise.standard_normal(x.shape) for _ in (x, x, y)[: 1 if order == 0 else 3])

    mesh = wavy(33, 33)
    found = measure_errors(mesh, Noise())
    assert found.resolved[1] is False
    pieces = resolution.MAX_PIECES + (resolution.MAX_PIECES_PER_CELL + 2) * mesh.grid.cells
    assert sum(points) < 2 * 24 * pieces


# Cells chosen among those of all processes: the same ones, however they are shared out.


VALUES = np.abs(np.random.default_rng(3).standard_normal(1000)) * 10.0 ** np.random.default_rng(4).integers(-9, 9, 1000)


def alone(count: int, channel: Channel) -> Rows:
    """Rows of so many cells, of which those of every process begin at 0."""
    return PartRows(shape=(count + 1, 2), begin=0, end=count + 1, first=0, last=count, channel=channel)


def in_parts(values: np.ndarray, cuts: list[int], count: int) -> np.ndarray:
    """The places of the largest values, from one process for each piece of the values."""
    pieces, ends = np.split(values, cuts), [0, *cuts, values.size]

    def work(channel: Channel) -> np.ndarray:
        k = channel.number
        first, last = ends[k : k + 2]
        rows = PartRows(shape=(values.size + 1, 2), begin=first, end=last + 1, first=first, last=last, channel=channel)
        return ends[k] + largest_of(pieces[k], count, rows)

    return np.concatenate(ThreadChannels(len(pieces)).run(work))


@pytest.mark.parametrize("sent", [0, 5, 100, 4096])
@pytest.mark.parametrize("cuts", [[], [1], [300, 310, 900]])
@pytest.mark.parametrize("count", [1, 27, 999])
def test_the_largest_are_those_at_the_end_of_the_sorted_ones(
    cuts: list[int], count: int, sent: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(resolution, "MAX_SENT", sent)
    assert np.array_equal(in_parts(VALUES, cuts, count), np.sort(np.argsort(VALUES)[-count:]))


@pytest.mark.parametrize("sent", [0, 4096])
def test_the_first_of_equal_values_are_taken_and_nan_before_all(sent: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(resolution, "MAX_SENT", sent)
    values = np.repeat([2.0, 1.0, np.nan, 1.0, 0.0], 4)
    for cuts in ([], [5], [6, 14]):
        assert in_parts(values, cuts, 10).tolist() == [0, 1, 2, 3, 4, 5, 8, 9, 10, 11]


@pytest.mark.parametrize("parts", [1, 3])
def test_the_values_that_are_taken_away_have_about_the_allowed_sum(parts: int) -> None:
    pieces = np.array_split(VALUES, parts)
    for share in (1e-6, 0.01, 0.5):
        allowed = share * VALUES.sum()

        def work(channel: Channel, allowed: float = allowed) -> np.ndarray:
            return all_but_the_smallest(pieces[channel.number], allowed, alone(VALUES.size, channel))

        kept = np.concatenate(ThreadChannels(parts).run(work))
        assert VALUES[~kept].sum() <= 1.02 * allowed
        assert VALUES[~kept].max() < VALUES[kept].min()
        assert VALUES[~kept].sum() + 1.05 * VALUES[kept].min() * (1.05 * VALUES[kept].min() > VALUES).sum() > allowed


def test_nothing_is_left_of_what_is_allowed_and_nan_never() -> None:
    def of(values: list[float], allowed: float) -> list[bool]:
        return all_but_the_smallest(np.array(values), allowed, Rows.whole((len(values) + 1, 2))).tolist()

    assert of([1.0, 2.0, 0.0], 3.5) == [False, False, False]
    assert of([1.0, 2.0, 0.0], 0.0) == [True, True, False]
    assert of([1.0, np.inf, np.nan], 2.0) == [False, True, False]


@pytest.mark.parametrize(("first", "last", "one_of"), [(0, 1000, 3), (17, 999, 7), (5, 5, 2), (40, 41, 260)])
def test_scattered_cells_are_found_without_a_look_at_the_others(first: int, last: int, one_of: int) -> None:
    numbers = np.arange(first, last)
    assert np.array_equal(scattered_between(first, last, one_of), numbers[scattered(numbers, one_of)])


@pytest.mark.parametrize(("shape", "one_of"), [((64, 64), 16), ((33, 50), 6), ((3, 700), 8), ((900, 2), 5)])
def test_scattered_cells_of_a_grid_are_one_of_each_tile(shape: tuple[int, int], one_of: int) -> None:
    rows, columns = shape
    found = scattered_between(0, rows, one_of, columns)
    width = min(one_of // math.isqrt(one_of), columns)
    height = one_of // width
    tiles = np.unique(np.stack([found // columns // height, found % columns // width]), axis=1)
    assert tiles.shape[1] == found.size > 0.8 * rows * columns / (height * width)
    assert np.all(np.diff(found) > 0)
    parts = [scattered_between(first, last, one_of, columns) for first, last in ((0, 2), (2, rows - 1))]
    rest = scattered_between(rows - 1, rows, one_of, columns)
    assert np.array_equal(np.concatenate([*parts, rest]), found)
