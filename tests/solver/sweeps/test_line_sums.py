"""Sums along the xi-lines, and the metric of cells from which they come."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from cases import problem
from equimesh.meshes.rows import Rows
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


def test_the_lines_are_those_of_sums_in_order() -> None:
    sums = LineSums(Rows.whole(SHAPE), ENDS)
    sums.strips[:], sums.first[:], sums.pushes[:] = STRIPS, FIRST, (LEFT, RIGHT)
    deviation = sums.solve(Lines(0, ENDS, NONE, (0.0, 0.0), NONE))
    inner = slice(1, -1)
    total = FIRST + STRIPS.sum(axis=0)
    rows = np.array([last - first for first, last in Rows.whole(SHAPE).node_strips])
    assert rows.sum() + 1 == ENDS
    mean, shift = total / ENDS, (RIGHT - LEFT) / ENDS
    assert sums.levels.mean[inner] == pytest.approx(mean[inner], rel=1e-13)
    assert sums.levels.shift[inner] == pytest.approx(shift[inner], rel=1e-13)
    start = LEFT + FIRST - mean + shift
    for k in range(65):
        expected = start + STRIPS[:k].sum(axis=0) + rows[:k].sum() * (shift - mean)
        assert sums.starts[k][inner] == pytest.approx(expected[inner], rel=1e-11, abs=1e-11)
    assert deviation == pytest.approx((abs(FIRST - mean) / mean)[inner].max(), rel=1e-13)


def test_a_line_that_is_not_a_number_is_no_convergence() -> None:
    sums = LineSums(Rows.whole(SHAPE), ENDS)
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
