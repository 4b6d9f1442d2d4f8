"""Sums along the xi-lines: the same for any number of parts, to the last bit, with few messages."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from cases import problem
from equimesh.meshes.parts import Parts
from equimesh.numerics.channel import Channel, Counted, ThreadChannels, Traffic
from equimesh.numerics.types import Array
from equimesh.single_domain.continuation import defects, directions
from equimesh.sweeps.kernels import Lines
from equimesh.sweeps.line_sums import MARGIN, LineSums, cell_memory, cell_metrics
from solver.sweeps.windows import disturbed

SHAPE = (1030, 2100)  # 65 strips
STRIPS = np.random.default_rng(7).random((65, SHAPE[1]))
FIRST, LEFT, RIGHT = np.random.default_rng(8).random((3, SHAPE[1]))
ENDS = SHAPE[0] - 1
NONE = np.zeros((2, SHAPE[1]))


def solved(channel: Channel) -> tuple[LineSums, float, dict[str, Traffic]]:
    counted = Counted(channel)
    parts = Parts.of(SHAPE, 1, counted)
    sums = LineSums(parts, ENDS)
    sums.strips[:] = STRIPS[parts.own.strips.start : parts.own.strips.stop]
    if channel.number == 0:
        sums.first[:], sums.pushes[0] = FIRST, LEFT
    if channel.number == channel.count - 1:
        sums.pushes[1] = RIGHT
    found = sums.solve(Lines(0, ENDS, NONE, (0.0, 0.0), NONE))
    return sums, found, counted.taken()


def test_the_lines_are_those_of_sums_in_order() -> None:
    ((sums, deviation, _),) = ThreadChannels(1).run(solved)
    inner = slice(1, -1)
    total = FIRST + STRIPS.sum(axis=0)
    rows = np.array([last - first for first, last in Parts.of(SHAPE).strips])
    assert rows.sum() + 1 == ENDS
    mean, shift = total / ENDS, (RIGHT - LEFT) / ENDS
    assert sums.levels.mean[inner] == pytest.approx(mean[inner], rel=1e-13)
    assert sums.levels.shift[inner] == pytest.approx(shift[inner], rel=1e-13)
    start = LEFT + FIRST - mean + shift
    for k in range(65):
        expected = start + STRIPS[:k].sum(axis=0) + rows[:k].sum() * (shift - mean)
        assert sums.starts[k][inner] == pytest.approx(expected[inner], rel=1e-11, abs=1e-11)
    assert deviation == pytest.approx((abs(FIRST - mean) / mean)[inner].max(), rel=1e-13)


@pytest.mark.parametrize("count", [2, 3, 4, 5, 6, 7, 8, 16])
def test_parts_find_the_same_to_the_last_bit(count: int) -> None:
    ((whole, deviation, _),) = ThreadChannels(1).run(solved)
    found = ThreadChannels(count).run(solved)
    starts = np.concatenate([sums.starts for sums, _, _ in found])
    assert np.array_equal(starts[:, 1:-1], whole.starts[:, 1:-1])
    for sums, _, _ in found:
        assert all(np.array_equal(one, other) for one, other in zip(sums.levels, whole.levels, strict=True))
    assert [own for _, own, _ in found] == [deviation] + (count - 1) * [0.0]


@pytest.mark.parametrize("count", [2, 4, 8, 16])
def test_sums_go_up_and_starts_down_once_for_every_cut(count: int) -> None:
    sent = [traffic for _, _, traffic in ThreadChannels(count).run(solved)]
    row = 8 * SHAPE[1]
    totals = {tag: [sum(one[tag].bytes for one in sent if tag in one)] for tag in ("sums", "starts", "push")}
    assert totals == {"sums": [row * (count - 1)], "starts": [3 * row * (count - 1)], "push": [row]}
    most = max(sum(traffic.messages for traffic in one.values()) for one in sent)
    assert most <= count.bit_length() + 1, "the logarithm of the number of parts"


def test_a_line_that_is_not_a_number_is_no_convergence() -> None:
    sums = LineSums(Parts.of(SHAPE), ENDS)
    sums.strips[:] = STRIPS
    sums.strips[40, 77] = np.nan
    sums.first[:] = FIRST
    assert sums.solve(Lines(0, ENDS, NONE, (0.0, 0.0), NONE)) == np.inf


# The metric of cells: a stencil of u for the arc length, values at the centres for all other monitors.


@pytest.mark.parametrize("domain", [em.Rectangle(), em.AnnulusSector(angles=(0, 120))], ids=["square", "annulus"])
@pytest.mark.parametrize("kind", [em.ArcLength, em.Curvature])
def test_rows_do_not_depend_on_the_other_rows(kind: type, domain: em.Domain) -> None:
    """To the last bit, and with u given at the nodes or not."""
    monitor = kind(u=em.Expression("tanh(5*(x - y))"))
    case = em.Problem(monitor=monitor, grid=em.Grid(n_xi=9, n_eta=7), domain=domain)
    mesh = disturbed(case, 1e-3)
    whole, some = np.empty((3, 8, 6)), np.empty((3, 3, 6))
    cell_metrics(case.metric, mesh.x, mesh.y, whole)
    rows = slice(2, 6)
    cell_metrics(case.metric, mesh.x[rows], mesh.y[rows], some, case.metric.u(mesh.x[rows], mesh.y[rows]))
    assert np.array_equal(some, whole[:, 2:5])
    assert (whole[0] * whole[2] - whole[1] ** 2 > 0.0).all()


def test_a_linear_u_has_the_metric_of_the_formula() -> None:
    case = em.Problem(
        monitor=em.ArcLength(u=em.Expression("2*x + y"), a=0.8, b=0.5, scaled=False), grid=em.Grid(n_xi=6, n_eta=5)
    )
    mesh, found = disturbed(case), np.empty((3, 5, 4))
    cell_metrics(case.metric, mesh.x, mesh.y, found)
    k = 0.8**2 / (1.0 + 0.5 * 5.0)
    for entry, expected in zip(found, (1.0 + 4.0 * k, 2.0 * k, 1.0 + k), strict=True):
        assert entry == pytest.approx(np.full((5, 4), expected), rel=1e-12)


def test_the_memory_of_cells_lies_apart_from_all_other() -> None:
    cells = cell_memory(3, 9)
    whole = cells.base
    while whole.base is not None:
        whole = whole.base
    before = (cells.ctypes.data - whole.ctypes.data) // 8
    after = whole.size - before - cells.size
    assert cells.shape == (3, 3, 8)
    assert cells.flags.c_contiguous
    assert min(before, after) >= MARGIN + 2 * 8


# The defects are those of the equations that Newton's method with a matrix solves.


def bent(case: em.Problem) -> tuple[Array, Array, Array]:
    """A mesh with random moves inside, and the metric of its cells."""
    mesh, rng = em.Mesh.uniform(case.grid), np.random.default_rng(4)
    x, y = mesh.x.copy(), mesh.y.copy()
    for q in (x, y):
        q[1:-1, 1:-1] += 0.01 * rng.standard_normal((x.shape[0] - 2, x.shape[1] - 2))
    cells = np.empty((3, x.shape[0] - 1, x.shape[1] - 1))
    cell_metrics(case.metric, x, y, cells)
    return x, y, cells


@pytest.mark.parametrize("weight", [0.0, 0.7])
@pytest.mark.parametrize("shape", [(9, 9), (8, 13)])
def test_they_are_the_residual_of_the_equations(shape: tuple[int, int], weight: float) -> None:
    case = problem("ring", *shape)
    x, y, cells = bent(case)
    equations = case.equations(weight)
    expected = equations.residual(equations.vector(em.Mesh(x, y))).reshape(2, *shape)[:, 1:-1, 1:-1]
    found = np.empty_like(expected)
    per_spacing = (float((shape[0] - 1) ** 2), float((shape[1] - 1) ** 2))
    defects(x, y, cells, per_spacing, weight, found)
    assert found == pytest.approx(expected, rel=1e-10, abs=1e-10 * np.abs(expected).max())


def test_the_directions_are_the_metric_times_the_edges() -> None:
    case = problem("ring", 7, 6)
    x, y, m = bent(case)
    found = np.empty((4, 5, 4))
    directions(x, y, m, found)
    i, j = 3, 2
    mean = m[:, i - 1 : i + 1, j - 1 : j + 1].mean(axis=(1, 2))
    tensor = np.array([[mean[0], mean[1]], [mean[1], mean[2]]])
    along_xi = 0.5 * np.array([x[i + 1, j] - x[i - 1, j], y[i + 1, j] - y[i - 1, j]])
    along_eta = 0.5 * np.array([x[i, j + 1] - x[i, j - 1], y[i, j + 1] - y[i, j - 1]])
    assert found[:2, i - 1, j - 1] == pytest.approx(tensor @ along_xi)
    assert found[2:, i - 1, j - 1] == pytest.approx(tensor @ along_eta)
