"""The objective of straight lines: its derivatives, and the meshes that a descent by it makes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import equimesh as em
from equimesh.least_error.cells import cells_of_grid
from equimesh.least_error.charts import DomainChart
from equimesh.least_error.descent import StraightLines
from equimesh.least_error.kernels import Rule
from equimesh.least_error.objective import Objective, Weights
from equimesh.least_error.starts import product

U = em.Expression("exp((x - 1)/0.1) + tanh(6*y - 2) + x*y")


def straight(shape: tuple[int, int]) -> tuple[StraightLines, np.ndarray]:
    s, t = (np.linspace(0.0, 1.0, n) for n in shape)
    weights = Weights(distortion=0.03, smoothness=0.02)
    objective = Objective(
        U, DomainChart(em.AnnulusSector()), cells_of_grid(shape), product(s, t), weights, Rule(points=3)
    )
    lines = StraightLines(objective, shape)
    return lines, lines.lines(product(s**1.2, t**0.8))


def test_the_derivatives_by_lines_are_those_of_the_objective() -> None:
    lines, at = straight((7, 5))
    there = lines.evaluate(at)
    assert there is not None
    step = 1e-6
    for axis, count in enumerate(lines.shape):
        for k in range(at.shape[1]):
            moved = np.zeros_like(at)
            moved[axis, k] = step
            is_free = 0 < k < count - 1
            if is_free:
                above, below = lines.evaluate(at + moved), lines.evaluate(at - moved)
                assert above is not None
                assert below is not None
                slope = (above.value - below.value) / (2 * step)
                assert there.gradient[axis, k] == pytest.approx(slope, rel=1e-5, abs=1e-7)
            else:
                assert there.gradient[axis, k] == 0.0


def test_lines_and_mesh_are_one_another() -> None:
    lines, at = straight((7, 5))
    assert np.array_equal(lines.lines(lines.mesh(at)), at)
    assert lines.smallest_share(at) > 0.0


@pytest.mark.parametrize("domain", [em.Rectangle(x=(0.0, 2.0)), em.AnnulusSector()], ids=["rectangle", "annulus"])
def test_a_rectilinear_mesh_has_straight_lines_and_a_smaller_error_than_its_start(domain: em.Domain) -> None:
    layers = em.Expression("exp((1 - hypot(x, y))/0.05) + exp(-3*y)")
    monitor = em.LeastError(u=layers, rectilinear=True)
    solution = em.solve(em.Problem(monitor=monitor, grid=em.Grid(n_xi=25, n_eta=17), domain=domain))
    assert np.ptp(solution.reference.x, axis=1).max() == 0.0
    assert np.ptp(solution.reference.y, axis=0).max() == 0.0
    assert solution.interpolation.gain_l2 > 1.5
    last = [row for row in solution.descent if row["grid"] == [25, 17]]
    assert last[-1]["error"] < last[0]["error"]
    free = em.solve(replace(solution.problem, monitor=replace(monitor, rectilinear=False)))
    assert np.ptp(free.reference.x, axis=1).max() > 0.0


def test_a_rectilinear_mesh_of_a_rectangle_is_orthogonal_also_from_a_given_mesh() -> None:
    layers = em.Expression("exp(-x/0.02) + exp(-y/0.02)")
    problem = em.Problem(monitor=em.LeastError(u=layers, rectilinear=True), grid=em.Grid(n_xi=17, n_eta=17))
    oblique = em.solve(replace(problem, monitor=em.LeastError(u=em.Expression("tanh(9*(x - y))"))))
    for initial in (em.Initial.NESTED, em.Initial.UNIFORM, oblique.reference):
        solution = em.solve(problem, initial=initial)
        assert solution.faces.non_orthogonality == 0.0
        assert solution.interpolation.gain_l2 > 10.0
