"""Errors of interpolation: exact values, orders, samples of many cells, and gains over the uniform mesh."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

import equimesh as em
from equimesh.domains.domain import map_mesh
from equimesh.meshes.mesh import Mesh
from equimesh.monitors.metrics import ArcLength
from equimesh.quality import measures
from equimesh.quality.cells import BilinearCells, UniformCells
from equimesh.quality.degrees import gains_by_degree
from equimesh.quality.interpolation import MAX_PROBES_PER_CELL, PROBES, InterpolationErrors, probe_errors
from equimesh.quality.measures import equidistribution, measure, measure_errors
from solver.quality.handmade import CONSTANT, ERRORS, SLOPE, TANH20, Analytic, constant, uniform, wavy


def test_interpolation_error_by_hand() -> None:
    # u = y^2 on cells of height h: u - u_h = -t (h - t), so L2^2 = h^4/30 and H1^2 = h^2/3 on the square.
    square_y = Analytic(lambda x, y: 0 * x + y**2, constant(0.0), lambda x, y: 2 * y + 0 * x)
    error = measure(uniform(5, 11), ArcLength(u=square_y, scaled=False)).interpolation_error
    assert error.l2 == pytest.approx(math.sqrt(1e-4 / 30), rel=1e-12)
    assert error.h1 == pytest.approx(math.sqrt(1e-2 / 3), rel=1e-12)
    # On a distorted mesh the bilinear space still holds x and y themselves.
    error = measure(wavy(), ArcLength(u=SLOPE, scaled=False)).interpolation_error
    assert max(error.l2, error.h1) < 1e-12


def test_few_points_a_cell_suffice_on_many_cells() -> None:
    monitor = ArcLength(u=TANH20, scaled=False)
    grid = uniform(257)
    x, y = grid.x, grid.y  # towards the front
    mesh = Mesh(x + 0.2 * x * (1 - x) * np.sin(3 * y), y - 0.15 * y * (1 - y) * (1 + x))
    full = measure(mesh, monitor, gauss=5)
    lean = equidistribution(mesh, monitor, gauss=measures.GAUSS_POINTS_BEYOND)
    assert lean == pytest.approx(full.q_eq.cells, rel=1e-5)
    exact, fast = full.interpolation_error, measure_errors(mesh, monitor.u)
    for name in ERRORS:
        assert getattr(fast, name) == pytest.approx(getattr(exact, name), rel=1e-4), name
    # 2 x 2 points alone see too little of the error: a finer rule takes their place
    two = measure(mesh, monitor, gauss=2).interpolation_error
    assert two.l2 == pytest.approx(exact.l2, rel=1e-4)


def test_a_sample_of_the_cells_gives_the_errors_of_all() -> None:
    u = em.Expression("tanh(100*(x - 0.5)) + tanh(60*(y - x - 0.1))")
    start = uniform(460, 400)
    mesh = Mesh(start.x + 0.1 * start.x * (1 - start.x) * (start.y + 1), start.y**1.2)
    full = measure_errors(mesh, u, gauss=3)
    seen: list[int] = []

    class Counting:
        def evaluate(self, x: np.ndarray, y: np.ndarray, order: int = 0) -> tuple[np.ndarray, ...]:
            seen.append(x.size)
            return u.evaluate(x, y, order)

    some = measure_errors(mesh, Counting())
    assert sum(seen) < 2 * 14.2 * mesh.grid.cells / 34 + 100
    measured = measure(mesh, ArcLength(u=u, scaled=False)).interpolation_error
    for name in ERRORS:
        assert getattr(some, name) == pytest.approx(getattr(full, name), rel=1e-2), name
        assert getattr(measured, name) == getattr(some, name)


def test_gains_compare_with_the_uniform_mesh_of_the_domain() -> None:
    sector = em.AnnulusSector()
    plain = Mesh(*sector.map(uniform(12).x, uniform(12).y))
    u = em.Expression("exp(-20*(x**2 + y**2 - 1))")  # a layer at the inner arc
    same = measure(plain, ArcLength(u=u, scaled=False), uniform=plain).interpolation_error
    assert same.gain_l2 == same.gain_h1 == 1.0
    adapted = Mesh(*sector.map(uniform(12).x ** 1.5, uniform(12).y))
    error = measure(adapted, ArcLength(u=u, scaled=False), uniform=plain).interpolation_error
    assert error.gain_l2 == error.l2_uniform / error.l2 > 1.5
    assert error.gain_h1 == error.h1_uniform / error.h1 > 1.2
    assert (error.l2_uniform, error.h1_uniform) == (same.l2, same.h1)
    alone, there = (measure_errors(mesh, u, alone=True) for mesh in (adapted, plain))
    assert math.isnan(alone.gain_l2)
    assert alone.against(there) == error
    hidden = replace(there, resolved=(False, True))
    assert alone.against(hidden).resolved == (False, True)
    worse = Mesh(*sector.map(uniform(12).x ** 0.7, uniform(12).y))
    assert measure_errors(worse, u, uniform=plain).gain_l2 < 0.9


def test_rounding_is_no_gain_and_no_loss() -> None:
    for u in (CONSTANT, SLOPE, em.Expression("1e9*x + 7")):
        error = measure(wavy(), ArcLength(u=u, scaled=False)).interpolation_error
        assert error.gain_l2 == error.gain_h1 == 1.0
        assert measure_errors(wavy(41, 30), u).gain_h1 == 1.0
    tiny = em.Expression("1e-9*sin(5*x)")
    assert measure_errors(wavy(), tiny).gain_l2 != 1.0


def test_what_is_known_of_u_on_the_uniform_mesh_is_kept_as_long_as_u_is(monkeypatch: pytest.MonkeyPatch) -> None:
    u, points, evaluate, plain = (
        em.Expression("tanh(20*(x - 0.3)) + y", t=4.0),
        [],
        em.Expression.evaluate,
        em.Rectangle(),
    )
    monkeypatch.setattr(
        em.Expression, "evaluate", lambda u, x, y, order=0: points.append(x.size) or evaluate(u, x, y, order)
    )

    def count(mesh: Mesh, u: em.Field, domain: em.Rectangle = plain) -> tuple[int, InterpolationErrors]:
        points.clear()
        errors = measure_errors(mesh, u, domain=domain)
        gains_by_degree(BilinearCells(mesh), UniformCells(mesh.grid, domain), u, errors)
        return sum(points), errors

    mesh, wide = wavy(41, 30), em.Rectangle(x=(0.0, 2.0))
    first, errors = count(mesh, u)
    again, same = count(mesh, em.Expression(u.text, t=4.0))
    assert again < 0.6 * first
    assert same == errors
    for other in (em.Expression(u.text, t=5.0), em.Expression("sin(x*y)", t=4.0)):
        assert count(mesh, other)[0] > 0.9 * first
    assert count(wavy(30, 41), u)[0] > 0.9 * first
    assert count(map_mesh(mesh, wide), u, wide)[0] > 0.9 * first
    assert measure_errors(mesh, u, gauss=4).l2_uniform != errors.l2_uniform, "by another rule"


def test_what_is_kept_of_u_is_not_that_of_a_zero_of_the_other_sign() -> None:
    above, below = (em.Expression("where(1/k > 0, x**3, tanh(9*y))", parameters={"k": k}) for k in (0.0, -0.0))
    assert above == below
    for u, same in ((above, "x**3"), (below, "tanh(9*y)")):
        assert measure_errors(wavy(), u).l2_uniform == measure_errors(wavy(), em.Expression(same)).l2_uniform


def test_the_uniform_mesh_gains_nothing_whatever_u_is() -> None:
    axis = np.linspace(0.0, 1.0, 9)
    samples = em.GridSamples(x=axis, y=axis, values=np.sin(5.0 * np.add.outer(axis, axis**2)))
    mesh = em.Mesh(*uniform(20, 40).points.T.reshape(2, 20, 40))
    found = measure_errors(mesh, samples)
    assert (found.gain_l2, found.gain_h1) == (1.0, 1.0)
    mesh.x[10, 20] += 1e-6
    assert measure_errors(em.Mesh(mesh.x, mesh.y), samples).gain_l2 != 1.0


def test_interpolation_error_falls_at_second_order_and_its_gradient_at_first() -> None:
    smooth = Analytic(
        lambda x, y: np.sin(3 * x) * np.exp(y),
        lambda x, y: 3 * np.cos(3 * x) * np.exp(y),
        lambda x, y: np.sin(3 * x) * np.exp(y),
    )
    errors = [measure(uniform(n), ArcLength(u=smooth, scaled=False)).interpolation_error for n in (9, 17, 33)]
    for coarse, fine in itertools.pairwise(errors):
        assert math.log2(coarse.l2 / fine.l2) == pytest.approx(2.0, abs=0.02)
        assert math.log2(coarse.h1 / fine.h1) == pytest.approx(1.0, abs=0.02)
    assert errors[-1].l2 < 1.5e-3
    assert errors[-1].h1 < 0.12
    assert errors[-1].l2 == errors[-1].l2_uniform
    assert errors[-1].h1 == errors[-1].h1_uniform


# Probes of u between the nodes.


def test_what_vanishes_at_the_nodes_is_seen_between_them() -> None:
    found, variation = probe_errors(uniform(65), em.Expression("sin(64*pi*x)*sin(64*pi*y)"))
    assert found.value == pytest.approx(1.0, abs=0.01)
    assert variation == pytest.approx(2.0, abs=0.02)


@pytest.mark.parametrize("mesh", [uniform(33), wavy(21, 40)])
def test_a_spike_between_the_nodes_is_found_in_its_place(mesh: em.Mesh) -> None:
    found, _ = probe_errors(mesh, em.Expression("exp(-5e4*((x - 0.4033)**2 + (y - 0.7077)**2))"))
    assert found.value > 0.5
    assert (found.x, found.y) == pytest.approx((0.4033, 0.7077), abs=0.01)


def test_a_bilinear_function_has_no_error() -> None:
    found, variation = probe_errors(uniform(9, 12), em.Expression("1 + 2*x - 3*x*y"))
    assert found.value < 1e-14
    assert variation == pytest.approx(3.0)


def test_values_that_are_not_finite_are_left_out() -> None:
    found, variation = probe_errors(uniform(9), em.Expression("y + 0/(x - 0.5)"))
    assert found.value < 1e-14
    assert variation == pytest.approx(1.0)


def test_the_number_of_probes_is_bounded() -> None:
    seen: list[int] = []

    class Counting:
        def evaluate(self, x: np.ndarray, y: np.ndarray, order: int = 0) -> tuple[np.ndarray, ...]:
            seen.append(x.size)
            return (x * y,) if order == 0 else (x * y, y, x)

    for n, most in ((5, 16 * MAX_PROBES_PER_CELL), (65, PROBES), (300, 299**2)):
        seen.clear()
        probe_errors(uniform(n), Counting())
        assert 0 < sum(seen) - n * n <= most + 2 * n, "a row of nodes between two strips counts twice"
