"""The choice of a monitor: the comparison, the chosen one, and what subdomains can solve."""

from __future__ import annotations

from typing import Any

import pytest

import equimesh as em
from equimesh.least_error.nest import coarse_level, nested_levels
from equimesh.quality.measures import measure_errors
from equimesh.solving.auto import choose_monitor
from equimesh.solving.status import SolveOptions

FRONT = em.Expression("tanh(40*(x + y/2 - 0.75))")
METRICS = ["arc_length", "curvature"]


def problem(u: em.Field = FRONT, n_xi: int = 33, n_eta: int = 33, norm: Any = "l2") -> em.Problem:
    return em.Problem(monitor=em.Auto(u=u, norm=norm, purpose="interpolation"), grid=em.Grid(n_xi=n_xi, n_eta=n_eta))


@pytest.mark.parametrize("norm", ["l2", "h1"])
def test_the_comparison_lists_the_best_first_and_that_is_chosen(norm: str) -> None:
    solution = em.solve(problem(norm=norm), threads=1)
    comparison = solution.comparison
    gains = [getattr(one, f"gain_{norm}") or 0.0 for one in comparison]
    assert gains == sorted(gains, reverse=True)
    assert [one.chosen for one in comparison] == [True] + [False] * (len(comparison) - 1)
    assert {*METRICS, "least_error"} == {one.kind for one in comparison}
    assert solution.certificate.comparison == comparison
    monitor = solution.problem.monitor
    assert isinstance(monitor, em.LeastError)
    assert (monitor.distortion, monitor.smoothness) == (
        comparison[0].settings["distortion"],
        comparison[0].settings["smoothness"],
    )
    assert solution.interpolation is not None
    assert getattr(solution.interpolation, f"gain_{norm}") > 2.0


@pytest.mark.parametrize("n", [17, 65])
def test_the_history_of_the_chosen_descent_begins_on_its_coarsest_grid(n: int) -> None:
    solution = em.solve(em.Problem(em.Auto(u=FRONT), em.Grid(n, n)), threads=1)
    levels = [record["level"] for record in solution.descent]
    assert sorted({*levels}) == list(range(levels[-1] + 1))
    assert solution.descent[-1]["grid"] == [n, n]
    steps = [(record["level"], record["start"], record["step"]) for record in solution.descent[:-1]]
    assert len({*steps}) == len(steps), "a step is told once, but the best of the coarsest meshes compared"


def test_for_a_degree_the_candidates_are_least_error_alone() -> None:
    monitor = em.Auto(FRONT, degree=2, purpose="interpolation")
    solution = em.solve(em.Problem(monitor, em.Grid(33, 33)), threads=1)
    assert [(one.kind, one.settings["degree"]) for one in solution.comparison] == [("least_error", 2)] * 2
    bilinear = em.solve(problem(), threads=1).gains_by_degree[1]
    assert solution.interpolation.degree == 2
    assert solution.interpolation.gain_l2 > 1.5 * bilinear.l2
    assert isinstance(solution.problem.monitor, em.LeastError)
    assert solution.problem.monitor.degree == 2
    with pytest.raises(em.InputError, match="subdomains equidistribute a metric") as caught:
        em.solve(em.Problem(monitor, em.Grid(33, 33)), em.Schwarz(subdomains=(2, 1)))
    assert caught.value.field == "monitor.degree"


def test_the_error_of_the_gradient_is_compared_as_it_is() -> None:
    # The less smooth descent hides the two layers between the points of a lean rule, which then sees half their error.
    u = em.Expression("exp(-34.1*x) + 0.852*exp(-102.8*(1 - y))")
    candidates = [one for one in em.solve(problem(u, norm="h1"), threads=1).comparison if one.kind == "least_error"]
    assert len(candidates) == 2
    for one in candidates:
        monitor = em.LeastError(u=u, norm="h1", **{k: v for k, v in one.settings.items() if k != "norm"})
        mesh = em.solve(em.Problem(monitor=monitor, grid=em.Grid(n_xi=33, n_eta=33)), threads=1).mesh
        exact = measure_errors(mesh, u, gauss=12)
        assert one.gain_h1 == pytest.approx(exact.gain_h1, rel=0.1)


def test_subdomains_choose_among_metrics() -> None:
    solution = em.solve(problem(em.Expression("sin(3*x)*y + x**2")), em.Schwarz(subdomains=(2, 1)), threads=1)
    assert sorted(one.kind for one in solution.comparison) == METRICS
    assert solution.schwarz is not None
    assert not isinstance(solution.problem.monitor, em.LeastError | em.Auto)


@pytest.mark.parametrize("shape", [(33, 33), (65, 65), (4, 4), (5, 300), (40, 171), (1025, 257)])
def test_the_coarse_grid_has_few_points(shape: tuple[int, int]) -> None:
    grid = em.Grid(n_xi=shape[0], n_eta=shape[1])
    assert coarse_level(nested_levels(grid)).grid.points <= 1600
    assert all(n <= m for n, m in zip(coarse_level(nested_levels(grid)).grid.shape, shape, strict=True))


@pytest.mark.parametrize("shape", [(4, 4), (5, 4), (9, 9), (5, 40)])
def test_grids_with_few_points_have_a_choice(shape: tuple[int, int]) -> None:
    solution = em.solve(problem(n_xi=shape[0], n_eta=shape[1]), threads=1)
    assert not solution.mesh.is_folded
    assert solution.interpolation.gain_l2 >= 1.0


def test_only_auto_is_chosen() -> None:
    other = em.Problem(monitor=em.LeastError(u=FRONT), grid=em.Grid(n_xi=9, n_eta=9))
    with pytest.raises(TypeError, match="Auto"):
        choose_monitor(other, SolveOptions(1, None))
