"""Quality measures: the paper's number, exact values on hand-made meshes, invariants, and orders."""

from __future__ import annotations

import itertools
import json
import math
import tracemalloc
import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

import equimesh as em
from equimesh.meshes.grid import Grid
from equimesh.meshes.mesh import Mesh
from equimesh.monitors.arc_length import ArcLength
from equimesh.quality import cells, measures
from equimesh.quality.cells import BilinearCells
from equimesh.quality.interpolation import ErrorRule, errors_of, interpolation_errors
from equimesh.quality.measures import alignment, equidistribution, measure, shape_regularity

Partial = Callable[[np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Analytic:
    """A field given by its value and gradient."""

    value: Partial
    along_x: Partial
    along_y: Partial

    def evaluate(self, x: np.ndarray, y: np.ndarray, order: int = 0) -> tuple[np.ndarray, ...]:
        parts = (self.value, self.along_x, self.along_y)[: 1 if order == 0 else 3]
        return tuple(part(x, y) for part in parts)


PAPER = Analytic(
    lambda x, y: (1 - np.exp(15 * (x - 1))) * np.sin(np.pi * y),
    lambda x, y: -15 * np.exp(15 * (x - 1)) * np.sin(np.pi * y),
    lambda x, y: (1 - np.exp(15 * (x - 1))) * np.pi * np.cos(np.pi * y),
)


def constant(value: float) -> Partial:
    return lambda x, y: np.full(np.broadcast_shapes(x.shape, y.shape), value)


PAPER_TEXT = "(1 - exp(15*(x - 1))) * sin(pi*y)"
TANH20 = em.Expression("tanh(20*(x + y/2 - 0.75))")
ERRORS = ("l2", "l2_uniform", "h1", "h1_uniform")

CONSTANT = Analytic(constant(3.0), constant(0.0), constant(0.0))
SLOPE = Analytic(lambda x, y: 2 * x + 0 * y, constant(2.0), constant(0.0))
CUBIC_Y = Analytic(lambda x, y: 0 * x + y**3, constant(0.0), lambda x, y: 3 * y**2 + 0 * x)


SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


def uniform(n_xi: int, n_eta: int | None = None) -> Mesh:
    return Mesh.uniform(Grid(n_xi=n_xi, n_eta=n_eta or n_xi))


def wavy(n_xi: int = 13, n_eta: int = 9) -> Mesh:
    """A smooth valid mesh without any symmetry."""
    start = uniform(n_xi, n_eta)
    x, y = start.x, start.y
    bump = np.sin(np.pi * x) * np.sin(np.pi * y)
    return Mesh(x + 0.1 * bump * (1 + y) + 0.05 * x * (1 - x), y - 0.08 * bump * (2 - x))


def folded() -> Mesh:
    """A uniform mesh with one inner node moved across the next line."""
    mesh = uniform(6)
    x = mesh.x.copy()
    x[2, 2] = 0.75
    return Mesh(x, mesh.y)


def one_quad(*corners: tuple[float, float]) -> Mesh:
    """The mesh of a single cell, given counter-clockwise from (0, 0)."""
    (x0, y0), (x1, y1), (x2, y2), (x3, y3) = corners
    return Mesh(np.array([[x0, x3], [x1, x2]]), np.array([[y0, y3], [y1, y2]]))


# The paper


def test_uniform_mesh_has_the_q_eq_of_table_1() -> None:
    q = equidistribution(uniform(12), ArcLength(u=PAPER, a=0.7, b=0.05))
    assert q.shape == (11, 11)
    assert f"{q.max():.4f}" == "1.6375"


def test_eight_gauss_points_are_enough_for_the_paper() -> None:
    monitor = ArcLength(u=PAPER)
    fine = equidistribution(uniform(12), monitor, gauss=20)
    assert np.abs(equidistribution(uniform(12), monitor) - fine).max() < 1e-9
    assert np.abs(equidistribution(uniform(12), monitor, gauss=4) - fine).max() > 1e-9


def test_the_largest_q_eq_sits_where_the_layer_is() -> None:
    q = equidistribution(uniform(12), ArcLength(u=PAPER))
    i, j = np.unravel_index(q.argmax(), q.shape)
    assert i == 10
    assert j == 5


# Exact values


def test_nothing_to_adapt_to_makes_every_measure_perfect() -> None:
    q = measure(uniform(7), ArcLength(u=CONSTANT))
    for name in ("q_eq", "q_ali", "q_geo", "scaled_jacobian", "aspect_ratio", "size_ratio"):
        assert getattr(q, name).cells == pytest.approx(np.ones((6, 6)), abs=1e-12), name
    assert q.skewness.max == pytest.approx(0.0, abs=1e-12)
    assert q.min_jacobian == pytest.approx(1.0)
    assert q.min_jacobian_over_mean == pytest.approx(1.0)
    error = q.interpolation_error
    assert max(error.l2, error.l2_uniform, error.h1, error.h1_uniform) < 1e-13


def test_mean_metric_is_the_integral_over_the_cell_and_not_its_centre_value() -> None:
    # b = 0, u = y^3: det M = 1 + 9 a^2 y^4, and det M_K = 1 + 9 a^2 (the mean of y^4 over the cell).
    mesh = Mesh(*np.meshgrid([0.0, 1.0], [0.0, 0.5, 1.0], indexing="ij"))
    means = np.array([0.5**5, 1 - 0.5**5]) / 5 / 0.5
    share = np.sqrt(1 + 9 * 0.25 * means)
    expected = 2 * share / share.sum()
    assert equidistribution(mesh, ArcLength(u=CUBIC_Y, a=0.5, b=0.0))[0] == pytest.approx(expected, rel=1e-12)


def test_mean_metric_weighs_by_area_in_a_tapered_cell() -> None:
    # Trapezium of width 1 at y = 0 and 0.5 at y = 1 beside its complement in a rectangle of height 1:
    # the mean of 9 y^4 over a width w(y) is 9 int y^4 w / int w.
    mesh = Mesh(np.array([[0.0, 0.0], [1.0, 0.5], [2.0, 2.0]]), np.array([[0.0, 1.0]] * 3))
    area = np.array([0.75, 1.25])
    moment = np.array([1 / 5 - 0.5 / 6, 1 / 5 + 0.5 / 6])  # int y^4 (1 -+ y/2)
    share = area * np.sqrt(1 + 9 * moment / area)
    expected = 2 * share / share.sum()
    got = equidistribution(mesh, ArcLength(u=CUBIC_Y, a=1.0, b=0.0))[:, 0]
    assert got == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("ratio", [1.0, 3.0, 0.2])
def test_rectangles(ratio: float) -> None:
    mesh = one_quad((0, 0), (ratio, 0), (ratio, 1), (0, 1))
    assert shape_regularity(mesh)[0, 0] == pytest.approx((ratio + 1 / ratio) / 2)


def test_a_rectangle_that_is_square_in_the_metric_is_aligned() -> None:
    # u = 2x, a = 1, b = 0: M = diag(5, 1), so a cell sqrt(5) times as tall as wide is a square to M.
    mesh = one_quad((0, 0), (0.2, 0), (0.2, 0.2 * math.sqrt(5)), (0, 0.2 * math.sqrt(5)))
    monitor = ArcLength(u=SLOPE, a=1.0, b=0.0)
    assert alignment(mesh, monitor)[0, 0] == pytest.approx(1.0)
    assert shape_regularity(mesh)[0, 0] == pytest.approx(3 / math.sqrt(5))


def test_alignment_sees_the_off_diagonal_of_the_metric() -> None:
    diagonal = Analytic(lambda x, y: x + y, constant(1.0), constant(1.0))
    monitor = ArcLength(u=diagonal, a=1.0, b=0.0)  # M = [[2, 1], [1, 2]], det 3
    square = one_quad((0, 0), (1, 0), (1, 1), (0, 1))
    assert alignment(square, monitor)[0, 0] == pytest.approx(4 / (2 * math.sqrt(3)))
    # F' = sheared so that F'^T M F' = diag(2, 3/2): columns (1, 0) and (-1/2, 1).
    sheared = one_quad((0, 0), (1, 0), (0.5, 1), (-0.5, 1))
    assert alignment(sheared, monitor)[0, 0] == pytest.approx(3.5 / (2 * math.sqrt(3)))


def test_a_skewed_quadrilateral_by_hand() -> None:
    # (0,0) (2,0) (2,1) (0,2): a right trapezium. Corner angles 90, 90, 90 + t, 90 - t with tan t = 1/2.
    tilt = math.atan(0.5)
    quad = one_quad((0, 0), (2, 0), (2, 1), (0, 2))
    # F' = [[2, 0], [-t, 2 - s]]: Q = (4 + t^2 + (2 - s)^2) / (4 (2 - s)), largest at s = t = 1.
    assert shape_regularity(quad)[0, 0] == pytest.approx(6 / 4)
    # The same quadrilateral tiled side by side, mirrored, so that the mesh is large enough to measure.
    columns = np.array([0.0, 2.0, 4.0, 6.0]) / 6
    low, high = np.zeros(4), np.array([2.0, 1.0, 2.0, 1.0]) / 6
    tiled = Mesh(
        np.repeat(columns[:, None], 4, axis=1),
        np.stack([low, high, high + 1 / 3, high + 2 / 3], axis=1),
    )
    q = measure(tiled, ArcLength(u=CONSTANT))
    row = np.s_[:, 0]
    assert q.q_geo.cells[row] == pytest.approx([1.5, 1.5, 1.5])
    assert q.scaled_jacobian.cells[row] == pytest.approx([math.cos(tilt)] * 3)
    assert q.skewness.cells[row] == pytest.approx([tilt / (math.pi / 2)] * 3)
    assert q.aspect_ratio.cells[row] == pytest.approx([math.sqrt(5)] * 3)  # edges 2, 1, sqrt 5, 2


def test_the_largest_misalignment_of_a_cell_is_at_a_corner() -> None:
    rng = np.random.default_rng(5)
    s, t = np.meshgrid(np.linspace(0, 1, 21), np.linspace(0, 1, 21))
    for _ in range(50):
        (x0, y0), (x1, y1), (x2, y2), (x3, y3) = SQUARE + rng.uniform(-0.4, 0.4, (4, 2))
        x_s, y_s = (1 - t) * (x1 - x0) + t * (x2 - x3), (1 - t) * (y1 - y0) + t * (y2 - y3)
        x_t, y_t = (1 - s) * (x3 - x0) + s * (x2 - x1), (1 - s) * (y3 - y0) + s * (y2 - y1)
        det = x_s * y_t - x_t * y_s
        if det.min() > 0:
            m11, m12, m22 = 3.0, 1.2, 0.8
            trace = m11 * (x_s**2 + x_t**2) + 2 * m12 * (x_s * y_s + x_t * y_t) + m22 * (y_s**2 + y_t**2)
            fields = [em.Expression(str(entry)) for entry in (m11, m12, m22)]
            monitor = em.Tensor(m11=fields[0], m12=fields[1], m22=fields[2])
            got = alignment(one_quad((x0, y0), (x1, y1), (x2, y2), (x3, y3)), monitor)[0, 0]
            assert got == pytest.approx((trace / det).max() / (2 * math.sqrt(m11 * m22 - m12**2)), rel=1e-12)


@pytest.mark.parametrize("reach", [0.6, 1.8], ids=["the widest angle decides", "the narrowest angle decides"])
def test_skewness_of_a_kite(reach: float) -> None:
    mesh = uniform(4)
    x, y = mesh.x.copy(), mesh.y.copy()
    x[2, 2] = y[2, 2] = (1 + reach) / 3  # the unit kite (0,0) (1,0) (reach,reach) (0,1), a third of its size
    tip = 2 * math.degrees(math.atan2(0.5, reach - 0.5))
    angles = [90, tip, (270 - tip) / 2]
    expected = max(max(angles) - 90, 90 - min(angles)) / 90
    assert (max(angles) - 90 > 90 - min(angles)) == (reach == 0.6)
    assert measure(Mesh(x, y), ArcLength(u=CONSTANT)).skewness.cells[1, 1] == pytest.approx(expected)


def test_size_ratio_takes_the_worst_neighbour_along_both_directions() -> None:
    x = np.array([0.0, 0.1, 0.4, 1.0])  # widths 1, 3, 6
    y = np.array([0.0, 0.4, 0.8, 1.0])  # heights 2, 2, 1
    q = measure(Mesh(*np.meshgrid(x, y, indexing="ij")), ArcLength(u=CONSTANT))
    assert q.size_ratio.cells == pytest.approx(np.array([[3, 3, 3], [3, 3, 3], [2, 2, 2]], dtype=float))
    tall = measure(Mesh(*np.meshgrid(y, x, indexing="ij")), ArcLength(u=CONSTANT))
    assert tall.size_ratio.cells == pytest.approx(q.size_ratio.cells.T)


def test_interpolation_error_by_hand() -> None:
    # u = y^2 on cells of height h: u - u_h = -t (h - t), so L2^2 = h^4/30 and H1^2 = h^2/3 on the square.
    square_y = Analytic(lambda x, y: 0 * x + y**2, constant(0.0), lambda x, y: 2 * y + 0 * x)
    error = measure(uniform(5, 11), ArcLength(u=square_y)).interpolation_error
    assert error.l2 == pytest.approx(math.sqrt(1e-4 / 30), rel=1e-12)
    assert error.h1 == pytest.approx(math.sqrt(1e-2 / 3), rel=1e-12)
    # On a distorted mesh the bilinear space still holds x and y themselves.
    error = measure(wavy(), ArcLength(u=SLOPE)).interpolation_error
    assert max(error.l2, error.h1) < 1e-12


# Invariants


def test_q_eq_averages_to_one_and_the_others_are_at_least_one() -> None:
    q = measure(wavy(), ArcLength(u=PAPER))
    assert q.q_eq.mean == pytest.approx(1.0, abs=1e-14)
    assert q.q_eq.min > 0
    assert q.q_eq.rms > 1.0
    for name in ("q_ali", "q_geo", "aspect_ratio", "size_ratio"):
        assert getattr(q, name).min >= 1.0 - 1e-12, name
        assert getattr(q, name).cells.shape == (12, 8), name
    assert 0 < q.scaled_jacobian.min <= q.scaled_jacobian.max <= 1
    assert 0 <= q.skewness.min <= q.skewness.max < 1


def test_the_measures_of_shape_do_not_see_scale_or_rotation() -> None:
    mesh, c, s = wavy(), math.cos(0.7), math.sin(0.7)
    moved = Mesh(5 + 1e-3 * (c * mesh.x - s * mesh.y), 1e-3 * (s * mesh.x + c * mesh.y))
    assert shape_regularity(moved) == pytest.approx(shape_regularity(mesh), rel=1e-9)
    first, second = (measure(m, ArcLength(u=CONSTANT)) for m in (mesh, moved))
    for name in ("scaled_jacobian", "skewness", "aspect_ratio", "size_ratio"):
        assert getattr(second, name).cells == pytest.approx(getattr(first, name).cells, rel=1e-9), name
    assert second.min_jacobian_over_mean == pytest.approx(first.min_jacobian_over_mean)
    assert second.min_jacobian == pytest.approx(first.min_jacobian)


def test_reflection_reflects_every_measure() -> None:
    mesh = wavy()
    mirrored = Mesh(mesh.x[:, ::-1], 1 - mesh.y[:, ::-1])
    first, second = (measure(m, ArcLength(u=PAPER)) for m in (mesh, mirrored))
    for name in measures.PER_CELL:
        assert getattr(second, name).cells == pytest.approx(getattr(first, name).cells[:, ::-1]), name
    assert second.interpolation_error.l2 == pytest.approx(first.interpolation_error.l2)
    assert second.interpolation_error.h1 == pytest.approx(first.interpolation_error.h1)


def test_exchanging_the_axes_transposes_every_measure() -> None:
    mesh, u = wavy(), PAPER
    turned = Analytic(lambda x, y: u.value(y, x), lambda x, y: u.along_y(y, x), lambda x, y: u.along_x(y, x))
    first, second = measure(mesh, ArcLength(u=u)), measure(Mesh(mesh.y.T, mesh.x.T), ArcLength(u=turned))
    for name in measures.PER_CELL:
        assert getattr(second, name).cells == pytest.approx(getattr(first, name).cells.T), name


def test_blocks_do_not_change_the_measures(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = measure(wavy(), ArcLength(u=PAPER)).summary(arrays=True)
    monkeypatch.setattr(cells, "BLOCK_POINTS", 64 * 7)  # seven cells at a time, 96 in all
    blocked = measure(wavy(), ArcLength(u=PAPER)).summary(arrays=True)
    for name in measures.PER_CELL:
        assert np.array(blocked[name]["cells"]) == pytest.approx(np.array(whole[name]["cells"]), rel=1e-12)
    assert blocked["interpolation_error"] == pytest.approx(whole["interpolation_error"], rel=1e-12)


def test_memory_is_bounded_and_large_meshes_use_fewer_gauss_points() -> None:
    seen: list[int] = []

    def value(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        seen.append(x.size)
        return PAPER.value(x, y)

    counting = ArcLength(u=Analytic(value, PAPER.along_x, PAPER.along_y))
    equidistribution(uniform(17, 33), counting)  # 512 cells
    assert sum(seen) == 16 * 32 * 8**2
    seen.clear()
    equidistribution(uniform(17, 34), counting)
    assert sum(seen) == 16 * 33 * 3**2
    seen.clear()
    equidistribution(uniform(401), counting)
    assert sum(seen) == 400 * 400 * 2**2
    assert max(seen) <= cells.BLOCK_POINTS
    assert len(seen) > 5


def test_the_temporaries_of_a_large_mesh_are_small() -> None:
    mesh, monitor = uniform(513), ArcLength(u=TANH20)
    measure(uniform(320), monitor)  # what is kept for good
    tracemalloc.start()
    try:
        kept = measure(mesh, monitor)
        now, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    cells = mesh.grid.cells
    assert kept.q_eq.cells.size == cells
    assert now < 58 * cells
    assert peak - now < 60 * cells + 4e6


@pytest.mark.parametrize("text", [PAPER_TEXT, TANH20.text])
def test_few_points_a_cell_suffice_on_many_cells(text: str) -> None:
    monitor = ArcLength(u=em.Expression(text))
    grid = uniform(257)
    x, y = grid.x, grid.y  # towards the front of the second function
    mesh = Mesh(x + 0.2 * x * (1 - x) * np.sin(3 * y), y - 0.15 * y * (1 - y) * (1 + x))
    full = measure(mesh, monitor, gauss=8)
    lean = equidistribution(mesh, monitor, gauss=measures.GAUSS_POINTS_BEYOND)
    assert lean == pytest.approx(full.q_eq.cells, rel=1e-5)
    exact, fast = full.interpolation_error, interpolation_errors(mesh, monitor.u)
    assert exact is not None
    for name in ERRORS:
        assert getattr(fast, name) == pytest.approx(getattr(exact, name), rel=1e-4), name
    # 2 x 2 points alone see too little of the error: the reason for the middles of the edges
    two = measure(mesh, monitor, gauss=2).interpolation_error
    assert two is not None
    assert two.l2 < 0.97 * exact.l2


def test_a_sample_of_the_cells_gives_the_errors_of_all() -> None:
    u = em.Expression("tanh(100*(x - 0.5)) + tanh(60*(y - x - 0.1))")
    start = uniform(460, 400)
    mesh = Mesh(start.x + 0.1 * start.x * (1 - start.x) * (start.y + 1), start.y**1.2)
    full = errors_of(BilinearCells(mesh), BilinearCells(uniform(460, 400)), u, ErrorRule.lean())
    seen: list[int] = []

    class Counting:
        def evaluate(self, x: np.ndarray, y: np.ndarray, order: int = 0) -> tuple[np.ndarray, ...]:
            seen.append(x.size)
            return u.evaluate(x, y, order)

    some = interpolation_errors(mesh, Counting())
    assert sum(seen) < 2 * 12 * mesh.grid.cells / 5 + 100
    measured = measure(mesh, ArcLength(u=u)).interpolation_error
    for name in ERRORS:
        assert getattr(some, name) == pytest.approx(getattr(full, name), rel=5e-3), name
        assert getattr(measured, name) == getattr(some, name)


# Other domains and monitors


@pytest.mark.parametrize("name", ["parallelogram", "rectangle"])
def test_a_mesh_of_equal_parallelograms_has_jacobian_one(name: str) -> None:
    x, y = uniform(9, 14).x, uniform(9, 14).y
    mesh = Mesh(3 * x + y, 0.5 * y + x / 7) if name == "parallelogram" else Mesh(200 * x - 3, 1e-3 * y)
    q = measure(mesh, ArcLength(u=CONSTANT))
    assert q.min_jacobian == pytest.approx(1.0)
    assert q.min_jacobian_over_mean == pytest.approx(1.0)
    assert q.q_eq.cells == pytest.approx(np.ones((8, 13)))


def test_gains_compare_with_the_uniform_mesh_of_the_domain() -> None:
    sector = em.AnnulusSector()
    plain = Mesh(*sector.map(uniform(12).x, uniform(12).y))
    u = em.Expression("exp(-20*(x**2 + y**2 - 1))")  # a layer at the inner arc
    same = measure(plain, ArcLength(u=u), uniform=plain).interpolation_error
    assert same is not None
    assert same.gain_l2 == same.gain_h1 == 1.0
    adapted = Mesh(*sector.map(uniform(12).x ** 1.5, uniform(12).y))
    error = measure(adapted, ArcLength(u=u), uniform=plain).interpolation_error
    assert error is not None
    assert error.gain_l2 == error.l2_uniform / error.l2 > 1.5
    assert error.gain_h1 == error.h1_uniform / error.h1 > 1.2
    assert (error.l2_uniform, error.h1_uniform) == (same.l2, same.h1)
    worse = Mesh(*sector.map(uniform(12).x ** 0.7, uniform(12).y))
    assert interpolation_errors(worse, u, plain).gain_l2 < 0.9


def test_rounding_is_no_gain_and_no_loss() -> None:
    for u in (CONSTANT, SLOPE, em.Expression("1e9*x + 7")):
        error = measure(wavy(), ArcLength(u=u)).interpolation_error
        assert error is not None
        assert error.gain_l2 == error.gain_h1 == 1.0
        assert interpolation_errors(wavy(41, 30), u).gain_h1 == 1.0
    tiny = em.Expression("1e-9*sin(5*x)")
    assert interpolation_errors(wavy(), tiny).gain_l2 != 1.0


def test_a_folded_mesh_gains_nothing() -> None:
    error = interpolation_errors(folded(), PAPER)
    assert error.gain_l2 == error.gain_h1 == 0.0


def test_a_monitor_without_u_has_no_interpolation_error() -> None:
    q = measure(wavy(), em.Weight(rho=em.Expression("1 + x")))
    assert q.interpolation_error is None
    assert q.summary()["interpolation_error"] is None
    assert q.q_eq.mean == pytest.approx(1.0)


def test_every_monitor_is_measured_by_its_own_metric() -> None:
    # rho = 1 + x on the unit square: the mean of rho over a column is that at its centre, the shares are known.
    q = equidistribution(uniform(5), em.Weight(rho=em.Expression("1 + x")))
    expected = (1 + np.array([1, 3, 5, 7]) / 8) / 1.5
    assert q == pytest.approx(np.repeat(expected[:, None], 4, axis=1), rel=1e-12)


# Folded meshes


def test_a_folded_mesh_is_infinite_where_it_folds_and_raises_no_warning() -> None:
    mesh = folded()
    assert mesh.is_folded
    bad = (mesh.corner_jacobians() <= 0).any(axis=0)
    assert 0 < bad.sum() < bad.size
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        q = measure(mesh, ArcLength(u=PAPER))
        summary = q.summary(arrays=True)
    for name in ("q_eq", "q_ali", "q_geo"):
        cells = getattr(q, name).cells
        assert np.array_equal(np.isinf(cells), bad), name
        assert np.isfinite(cells[~bad]).all(), name
        assert getattr(q, name).max == math.inf, name
    assert q.size_ratio.max == math.inf
    assert q.scaled_jacobian.min <= 0
    assert np.array_equal(q.skewness.cells == 1.0, bad)
    assert q.min_jacobian <= 0
    assert math.isinf(q.interpolation_error.l2)
    assert math.isfinite(q.interpolation_error.l2_uniform)
    assert summary["q_ali"]["max"] is None
    json.dumps(summary, allow_nan=False)


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_coordinates_that_are_not_finite_count_as_folded(value: float) -> None:
    mesh = uniform(6)
    x = mesh.x.copy()
    x[2, 3] = value
    q = measure(Mesh(x, mesh.y), ArcLength(u=PAPER))
    assert np.isinf(q.q_eq.cells[1:3, 2:4]).all()
    assert np.isinf(q.q_ali.cells[1:3, 2:4]).all()
    json.dumps(q.summary(arrays=True), allow_nan=False)


def test_a_collapsed_cell_is_degenerate() -> None:
    mesh = uniform(6)
    x = mesh.x.copy()
    x[2, :] = x[1, :]
    q = measure(Mesh(x, mesh.y), ArcLength(u=PAPER))
    assert np.isinf(q.q_ali.cells[1]).all()
    assert np.isinf(q.aspect_ratio.cells[1]).all()
    assert q.scaled_jacobian.cells[1] == pytest.approx(np.zeros(5))
    assert (q.skewness.cells[1] == 1.0).all()


# Orders, and the summary


def test_interpolation_error_falls_at_second_order_and_its_gradient_at_first() -> None:
    smooth = Analytic(
        lambda x, y: np.sin(3 * x) * np.exp(y),
        lambda x, y: 3 * np.cos(3 * x) * np.exp(y),
        lambda x, y: np.sin(3 * x) * np.exp(y),
    )
    errors = [measure(uniform(n), ArcLength(u=smooth)).interpolation_error for n in (9, 17, 33)]
    for coarse, fine in itertools.pairwise(errors):
        assert math.log2(coarse.l2 / fine.l2) == pytest.approx(2.0, abs=0.02)
        assert math.log2(coarse.h1 / fine.h1) == pytest.approx(1.0, abs=0.02)
    assert errors[-1].l2 < 1.5e-3
    assert errors[-1].h1 < 0.12
    assert errors[-1].l2 == errors[-1].l2_uniform
    assert errors[-1].h1 == errors[-1].h1_uniform


def test_a_mesh_that_gathers_in_the_layer_interpolates_better_than_the_uniform_one() -> None:
    start = uniform(12)
    error = measure(Mesh(1 - (1 - start.x) ** 1.5, start.y), ArcLength(u=PAPER)).interpolation_error
    assert error.l2 < 0.7 * error.l2_uniform
    assert error.h1 < 0.7 * error.h1_uniform


def test_summary_is_plain_json() -> None:
    q = measure(wavy(5, 4), ArcLength(u=PAPER))
    plain = q.summary()
    assert json.loads(json.dumps(plain, allow_nan=False)) == plain
    assert set(plain["q_eq"]) == {"max", "min", "mean", "rms"}
    assert plain["q_eq"]["max"] == q.q_eq.cells.max()
    assert set(plain["interpolation_error"]) == {*ERRORS, "gain_l2", "gain_h1"}
    full = q.summary(arrays=True)
    assert np.array_equal(np.array(full["q_geo"]["cells"]), q.q_geo.cells)
    assert {type(value) for row in full["q_eq"]["cells"] for value in row} == {float}
