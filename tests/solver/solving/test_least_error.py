"""Least-error solves: never worse than the uniform mesh, for a requested error, and within a bound of angles."""

from __future__ import annotations

import json
import math
import pickle
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

import equimesh as em
from equimesh.least_error.descent import Descent
from equimesh.least_error.nest import nested_levels
from equimesh.quality.faces import measure_faces
from equimesh.quality.interpolation import InterpolationErrors
from equimesh.rounds.shape import proportions
from equimesh.solving import least_error, orthogonality
from equimesh.solving.solution import Solution
from equimesh.solving.target import require_reachable
from equimesh.testing.geometries import l_shape

FRONT = em.Expression("tanh(40*(x + y/2 - 0.75))")
GRID = em.Grid(n_xi=25, n_eta=21)


def problem(u: em.Field = FRONT, grid: em.Grid = GRID, **asked: Any) -> em.Problem:
    return em.Problem(monitor=em.LeastError(u=u, **asked), grid=grid)


@cache
def solution_of(norm: str = "l2") -> Solution:
    """The solution of that problem, which several tests look at."""
    return em.solve(problem(norm=norm), threads=1)


@pytest.mark.parametrize("norm", ["l2", "h1"])
def test_a_solve_gains_and_is_completed(norm: str) -> None:
    solution = solution_of(norm)
    errors = solution.interpolation
    assert errors is not None
    assert (errors.gain_l2 if norm == "l2" else errors.gain_h1) > 2.0
    assert min(errors.gain_l2, errors.gain_h1 if norm == "h1" else 1.0) >= 1.0
    assert solution.status is em.Status.COMPLETED
    assert solution.note == ""
    assert not solution.mesh.is_folded
    assert solution.certificate.equation_residual is None


@pytest.mark.parametrize("asked", [{}, {"norm": "h1"}, {"cells": "triangle"}, {"degree": 2}], ids=str)
def test_the_errors_of_a_solve_are_those_of_its_quality_which_is_not_measured_before_it_is_asked_for(
    asked: dict[str, Any],
) -> None:
    solution = em.solve(problem(grid=em.Grid(9, 9), **asked), threads=1)
    errors = solution.interpolation
    assert "quality" not in vars(solution)
    both = replace(solution).quality.interpolation_error, solution.quality.interpolation_error
    for other in both:
        assert (other.l2, other.h1, other.gain_l2, other.resolved) == (
            errors.l2,
            errors.h1,
            errors.gain_l2,
            errors.resolved,
        )


def test_sides_are_met_exactly() -> None:
    solution = solution_of()
    x, y = solution.mesh.x, solution.mesh.y
    for side in (x[0], 1 - x[-1], y[:, 0], 1 - y[:, -1]):
        assert (side == 0.0).all()


def test_the_observer_gets_every_step_and_the_solution_keeps_their_numbers() -> None:
    seen: list[Any] = []
    solution = em.solve(problem(), threads=1, observe=seen.append)
    assert all(isinstance(step, Descent) for step in seen)
    assert [step.numbers() for step in seen] == list(solution.descent)
    assert json.loads(json.dumps(solution.convergence()))["descent"] == [step.numbers() for step in seen]
    assert np.array_equal(seen[-1].mesh.x, solution.reference.x)
    assert solution.newton_steps == sum(step.grid == GRID for step in seen) > 0


def test_a_solution_can_be_pickled() -> None:
    solution = solution_of()
    summary = solution.certificate.summary()  # its measures stay behind, and are made anew
    copy = pickle.loads(pickle.dumps(solution))
    assert np.array_equal(copy.mesh.x, solution.mesh.x)
    assert copy.certificate.summary() == summary
    assert copy.descent == solution.descent


def test_the_uniform_mesh_is_the_last_resort(monkeypatch: pytest.MonkeyPatch) -> None:
    tried: list[Solution] = []

    def never(solution: Solution, norm: str) -> bool:  # noqa: ARG001
        tried.append(solution)
        return False

    monkeypatch.setattr(least_error, "is_no_worse", never)
    u = em.Expression("exp(-x/0.01) + exp(-y/0.01)")  # begins rectilinear, then from the uniform mesh
    solution = em.solve(problem(u), threads=1)
    assert len(tried) == 2
    assert tried[0].mesh.distance(tried[1].mesh) > 1e-6
    assert {record["start"] for record in tried[1].descent[len(tried[0].descent) :]} == {"uniform"}
    assert solution.mesh.distance(em.Mesh.uniform(GRID)) == 0.0
    assert solution.reference.distance(em.Mesh.uniform(GRID)) == 0.0
    assert solution.note == least_error.NO_BETTER.format("uniform")
    assert solution.interpolation.gain_l2 == 1.0


def test_the_last_resort_is_a_success_where_all_others_are_folded(monkeypatch: pytest.MonkeyPatch) -> None:
    grid, finish = em.Grid(n_xi=5, n_eta=5), least_error._finish
    monkeypatch.setattr(least_error, "_finish", lambda *given: replace(finish(*given), status=em.Status.FOLDED))
    monkeypatch.setattr(least_error, "is_no_worse", lambda *_: False)
    solution = em.solve(problem(grid=grid), threads=1)
    assert solution.mesh.distance(em.Mesh.uniform(grid)) == 0.0
    assert solution.status is em.Status.COMPLETED


@pytest.mark.parametrize(
    ("l2", "h1", "norm", "kept"),
    [(0.5, 2.0, "l2", True), (0.5, 2.0, "h1", False), (2.0, 0.5, "l2", False), (2.0, 0.5, "h1", False)],
)
def test_both_norms_count_where_the_gradient_is_requested(l2: float, h1: float, norm: str, kept: bool) -> None:
    solution = replace(solution_of())
    errors = InterpolationErrors(l2=l2, l2_uniform=1.0, h1=h1, h1_uniform=1.0)
    vars(solution)["interpolation"] = errors  # in place of the measured ones
    assert least_error.is_no_worse(solution, norm) is kept


@pytest.mark.parametrize("norm", ["l2", "h1"])
def test_the_error_of_u_is_tried_where_its_gradient_alone_gains(monkeypatch: pytest.MonkeyPatch, norm: str) -> None:
    tried: list[Solution] = []

    def third(solution: Solution, norm: str) -> bool:  # noqa: ARG001
        tried.append(solution)
        return len(tried) == 3

    monkeypatch.setattr(least_error, "is_no_worse", third)
    layers = problem(em.Expression("exp(-x/0.01) + exp(-y/0.01)"), norm=norm)
    solution = em.solve(layers, threads=1)
    assert len(tried) == (3 if norm == "h1" else 2)
    if norm == "h1":
        monkeypatch.undo()
        values = em.solve(problem(em.Expression("exp(-x/0.01) + exp(-y/0.01)")), threads=1)
        assert solution.mesh.distance(values.mesh) == 0.0
        assert solution.problem == layers


def test_a_steep_front_gains_in_both_norms_where_its_gradient_is_requested() -> None:
    solution = em.solve(problem(em.Expression("tanh(52.4*(x - 0.738))"), em.Grid(n_xi=33, n_eta=33), norm="h1"))
    errors = solution.interpolation
    assert min(errors.gain_l2, errors.gain_h1) > 3.0


THIN_LAYERS = em.Expression("exp(-x/0.001) + exp(-y/0.001)")


def errors_of(solution: Solution, norm: str) -> float:
    errors = solution.interpolation
    assert errors is not None
    return errors.l2 if norm == "l2" else errors.h1


@pytest.mark.parametrize(
    ("u", "norm", "n"),
    [(FRONT, "l2", 9), (FRONT, "h1", 25), (THIN_LAYERS, "l2", 25), (THIN_LAYERS, "h1", 9)],
    ids=["front, l2", "front, h1", "layers, l2", "layers, h1"],
)
def test_a_given_mesh_is_not_made_worse(u: em.Expression, norm: str, n: int) -> None:
    grid = em.Grid(n_xi=n, n_eta=n)
    best = em.solve(problem(u, grid, norm=norm, distortion=0.1, smoothness=0.05), threads=1)
    again = em.solve(problem(u, grid, norm=norm, distortion=5.0, smoothness=5.0), initial=best.reference, threads=1)
    assert errors_of(again, norm) <= errors_of(best, norm) * (1.0 + 1e-12)


def test_a_given_mesh_of_another_time_is_improved() -> None:
    before = em.solve(problem(em.Expression("tanh(40*(x + y/2 - 0.72))")), threads=1)
    after = em.solve(problem(), initial=before.reference, threads=1)
    fresh = solution_of()
    assert after.interpolation.gain_l2 > 0.3 * fresh.interpolation.gain_l2 > 4.0  # type: ignore[union-attr]
    assert after.note == ""


def test_a_given_mesh_that_descent_does_not_better_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    best = solution_of()
    monkeypatch.setattr(least_error.LeastErrorSolve, "steps", lambda solve, _start, **_: iter([uniform_record(solve)]))
    again = em.solve(problem(), initial=best.reference, threads=1)
    assert again.note == least_error.GIVEN_IS_KEPT
    assert again.mesh.distance(best.mesh) == 0.0


def uniform_record(solve: least_error.LeastErrorSolve) -> Descent:
    *_, last = solve.coarse(nested_levels(solve.grid)[0])
    return replace(last, mesh=em.Mesh.uniform(solve.grid), grid=solve.grid)


# Elements of higher degree.

PEAK = em.Expression("exp(-1000*((x-0.5)**2+(y-0.5)**2))")
OF_DEGREE: dict[str, dict[str, Any]] = {
    "quadratic": {"degree": 2},
    "cubic": {"degree": 3},
    "quartic": {"degree": 4},
    "quadratic gradient": {"degree": 2, "norm": "h1"},
    "quadratic triangles": {"degree": 2, "cells": "triangle"},
}


@pytest.mark.parametrize("name", OF_DEGREE)
def test_a_mesh_for_a_degree_gains_for_that_degree(name: str) -> None:
    asked, grid = OF_DEGREE[name], em.Grid(n_xi=17, n_eta=17)
    solution = em.solve(problem(PEAK, grid, **asked), threads=1)
    errors = solution.interpolation
    assert errors.degree == asked["degree"]
    assert not solution.mesh.is_folded
    bilinear = em.solve(problem(PEAK, grid, norm=asked.get("norm", "l2"), cells=asked.get("cells", "quad")), threads=1)
    own = next((one for one in bilinear.gains_by_degree if one.degree == asked["degree"]), None)
    norm = asked.get("norm", "l2")
    assert errors.estimated_gain(norm) > (2.0 * getattr(own, norm) if own is not None else 20.0)
    told = {one.degree: (one.l2, one.h1) for one in solution.certificate.gains_by_degree}
    assert told[errors.degree] == (errors.gain_l2, errors.gain_h1)


@pytest.mark.parametrize("degree", [2, 3])
def test_the_mesh_of_a_degree_is_no_worse_than_uniform_where_that_of_degree_1_is(degree: int) -> None:
    wave = em.Expression("sin(6*x)*cos(5*y)")
    (_, second, third) = em.solve(problem(wave, em.Grid(n_xi=33, n_eta=33)), threads=1).gains_by_degree
    assert max(second.l2, third.l2) < 0.5
    errors = em.solve(problem(wave, em.Grid(n_xi=33, n_eta=33), degree=degree), threads=1).interpolation
    assert errors.gain_l2 > 1.2


def test_a_degree_on_blocks_and_on_closed_lines() -> None:
    nodes = em.Mesh.uniform(em.Grid(n_xi=17, n_eta=17))
    blocks = em.Blocks.of_mesh(nodes.points, nodes.cells, nodes.sides)
    monitor = em.LeastError(u=PEAK, degree=2)
    on_blocks = em.solve(em.Problem(monitor=monitor, domain=blocks), threads=1)
    assert (on_blocks.interpolation.degree, on_blocks.interpolation.gain_l2 > 10.0) == (2, True)
    ring = em.AnnulusSector(radii=(0.5, 1.5), closed=True)
    front = em.LeastError(u=em.Expression("tanh(10*(x + y/2))"), degree=2)
    closed = em.solve(em.Problem(monitor=front, grid=em.Grid(n_xi=9, n_eta=33), domain=ring), threads=1)
    assert closed.interpolation.gain_l2 > 2.0


def test_a_given_mesh_is_kept_where_it_is_better_for_the_degree() -> None:
    asked = problem(PEAK, em.Grid(n_xi=17, n_eta=17), degree=2)
    first = em.solve(asked, threads=1)
    again = em.solve(asked, initial=first.reference, threads=1)
    assert again.interpolation.l2 <= first.interpolation.l2


PAPER = em.Expression("(1-exp(15*(x-1)))*sin(pi*y)")
MONITOR = em.LeastError(u=PAPER)


@pytest.mark.parametrize(("norm", "error"), [("l2", 1e-4), ("h1", 0.06)])
def test_the_error_is_reached_on_the_predicted_grid(norm: Any, error: float) -> None:
    grids: list[em.Grid] = []
    target = em.Target(norm=norm, error=error)
    solution = em.solve_to(target, monitor=em.LeastError(u=PAPER, norm=norm), began=grids.append, threads=1)
    aim = solution.certificate.target
    assert aim.grid == solution.problem.grid.shape == grids[-1].shape
    assert grids[0] == em.Grid(n_xi=33, n_eta=33)
    assert aim.solves == len(grids) <= 4
    assert solution.interpolation is not None
    assert aim.reached == getattr(solution.interpolation, norm)
    assert 0.8 * error <= aim.reached <= error
    assert aim.predicted == pytest.approx(aim.reached, rel=0.05)
    assert solution.certificate.summary()["target"]["grid"] == [*aim.grid]
    assert f"reached on {solution.problem.grid} points" in str(solution.certificate)


@pytest.mark.parametrize("kind", [em.LeastError, em.Auto])
def test_the_least_error_on_so_many_points_takes_a_shape_for_it(kind: Any) -> None:
    u, grids = em.Expression("exp(-30*y)"), list[em.Grid]()
    solution = em.solve_to(em.Target(max_points=300), monitor=kind(u), began=grids.append, threads=1)
    square = em.solve(em.Problem(monitor=kind(u), grid=grids[0]), threads=1)
    assert (grids[0], grids[-1]) == (em.Grid(17), solution.problem.grid)
    assert solution.problem.grid.n_eta > 6 * solution.problem.grid.n_xi
    assert solution.interpolation.l2 < 0.3 * square.interpolation.l2


def test_a_number_of_points_chooses_the_counts_of_blocks() -> None:
    domain, monitor = l_shape(300), em.LeastError(u=em.Expression("exp(-20*x)"))
    solution = em.solve_to(em.Target(max_points=300), monitor=monitor, domain=domain, threads=1)
    even = em.solve(em.Problem(monitor=monitor, domain=domain), threads=1)
    assert 250 < len(solution.mesh.points) <= 300
    assert solution.interpolation.l2 < 0.6 * even.interpolation.l2
    with pytest.raises(em.InputError, match="40 points are too few: the coarsest mesh of these blocks has 65 points"):
        em.solve_to(em.Target(max_points=40), monitor=monitor, domain=domain)
    with pytest.raises(em.InputError, match="give max_points alone") as refused:
        em.solve_to(em.Target(error=1e-3), monitor=monitor, domain=domain)
    assert refused.value.field == "domain"


def test_the_order_of_the_degree_predicts_the_grid() -> None:
    solution = em.solve_to(em.Target(error=2e-6), monitor=em.LeastError(PAPER, degree=3), threads=1)
    aim = solution.certificate.target
    assert aim.predicted == pytest.approx(aim.reached, rel=0.1)
    assert 0.8 * 2e-6 <= aim.reached <= 2e-6  # the first grid of 33 x 33 has a hundredth of that
    assert solution.problem.grid.points < 20 * 20
    assert (solution.interpolation.degree, aim.reached) == (3, solution.interpolation.l2)


def test_a_large_error_takes_a_coarse_grid() -> None:
    solution = em.solve_to(em.Target(error=3e-3), monitor=MONITOR, threads=1)
    assert solution.problem.grid.points < 33 * 33
    assert solution.target.reached <= 3e-3


def test_what_no_allowed_grid_reaches_is_refused_with_the_error_that_it_would_give() -> None:
    target = em.Target(error=1e-6, max_points=50 * 50)
    with pytest.raises(em.InputError, match="the largest allowed grid, 50 x 50, would give about") as caught:
        em.solve_to(target, monitor=MONITOR, threads=1)
    assert caught.value.field == "target.error"
    told = float(caught.value.message.rsplit(" ", 1)[1])
    largest = em.solve(em.Problem(monitor=MONITOR, grid=em.Grid(n_xi=50, n_eta=50)), threads=1)
    assert told == pytest.approx(largest.interpolation.l2, rel=0.1)
    with pytest.raises(em.InputError, match="would give about"):
        require_reachable(target, monitor=MONITOR)
    require_reachable(em.Target(error=1e-4), monitor=MONITOR)


def test_the_largest_grid_is_within_the_limit() -> None:
    for most in (25, 100, 1089, 54321):
        for domain in (em.Rectangle(), em.Rectangle(x=(0, 7)), em.Rectangle(y=(0, 3))):
            target = em.Target(error=1.0, max_points=most)
            grid = target.grid(domain, target.largest_cells(domain))
            assert 0.8 * most < grid.points <= most


@pytest.mark.parametrize(
    ("domain", "ratio"),
    [
        (em.Rectangle(), 1.0),
        (em.Rectangle(x=(0, 4)), 4.0),
        (em.Rectangle(x=(0, 1), y=(0, 1000)), 1 / 64),
        (em.AnnulusSector(radii=(1, 2), angles=(0, 90)), 1 / (1.5 * math.pi / 2)),
    ],
)
def test_cells_have_the_proportions_of_the_domain(domain: em.Domain, ratio: float) -> None:
    along_xi, along_eta = proportions(domain)
    assert along_xi / along_eta == pytest.approx(ratio, rel=0.01)
    assert along_xi * along_eta == pytest.approx(1.0)


def test_a_target_needs_a_function_and_no_mesh() -> None:
    target = em.Target(error=1e-3)
    with pytest.raises(em.InputError, match="this monitor has no u"):
        em.solve_to(target, monitor=em.Weight(rho=PAPER))
    with pytest.raises(em.InputError, match="no mesh to start from"):
        em.solve_to(target, monitor=MONITOR, initial=em.Mesh.uniform(em.Grid(n_xi=33, n_eta=33)))


def test_the_second_grid_begins_where_the_first_has_ended() -> None:
    told: list[em.Event] = []
    target = em.Target(error=2e-4)
    u = em.Expression("(1-exp(15*(x-1)))*sin(pi*y)")
    solution = em.solve_to(target, monitor=em.LeastError(u=u), observe=told.append, threads=1)
    first = [event for event in told if event.phase.startswith("grid 1 for the target: ")]
    second = [event.fraction for event in told if event.phase.startswith("grid 2 for the target: ")]
    assert {event.fraction for event in first} == {None}  # how large the second grid is, is not known yet
    known = [share for share in second if share is not None]
    assert known == sorted(known)
    assert known[0] >= 33 * 33 / (33 * 33 + solution.problem.grid.points) / 2
    assert known[-1] > 0.5


STEEP = em.Expression("tanh(30*(y - 0.5 - 0.25*sin(2*pi*x)))")
SHARP_PEAK = em.Expression("1 + 60*exp(-300*(x + y - 1)**2)")
BOUND = 25.0
MONITORS: dict[str, em.Monitor] = {
    "auto": em.Auto(u=STEEP, orthogonality=BOUND),
    "least_error": em.LeastError(u=STEEP, orthogonality=BOUND),
    "h1": em.LeastError(u=STEEP, norm="h1", orthogonality=BOUND),
    "arc_length": em.ArcLength(u=STEEP, orthogonality=BOUND),
    "curvature": em.Curvature(u=STEEP, isotropic=True, orthogonality=BOUND),
    "smoothed": em.Smoothed(monitor=em.ArcLength(u=STEEP, orthogonality=BOUND), radius=0.02),
    "weight": em.Weight(rho=SHARP_PEAK, orthogonality=BOUND),
    "gradient": em.Weight(rho=SHARP_PEAK, map="gradient", orthogonality=BOUND),
    "tensor": em.Tensor(m11=SHARP_PEAK, m12=em.Expression("0.5"), m22=SHARP_PEAK, orthogonality=BOUND),
    "intersection": em.Intersection(monitors=(em.Weight(rho=SHARP_PEAK), em.ArcLength(u=STEEP, orthogonality=BOUND))),
    "own": em.Intersection(monitors=(em.Weight(rho=SHARP_PEAK), em.ArcLength(u=STEEP)), orthogonality=BOUND),
}


def solved(monitor: em.Monitor, schwarz: em.Schwarz | None = None, **more: Any) -> em.Solution:
    problem = em.Problem(monitor=monitor, grid=em.Grid(n_xi=17, n_eta=17), domain=more.pop("domain", em.Rectangle()))
    return em.solve(problem, schwarz, **more)


@cache
def bounded(name: str) -> em.Solution:
    """The solution by one of these monitors."""
    return solved(MONITORS[name])


@pytest.mark.parametrize("name", MONITORS)
def test_the_bound_holds_and_the_certificate_says_what_it_cost(name: str) -> None:
    solution = bounded(name)
    assert measure_faces(solution.mesh).non_orthogonality <= BOUND
    assert solution.faces.non_orthogonality > 0.3 * BOUND or solution.relaxed[0].what == "rectilinear"
    assert solution.relaxed, "without a price the bound would be no bound for this monitor"
    (said,) = (text for text in solution.certificate.warnings if f"The bound of {BOUND:g} degrees" in text)
    assert solution.status in (em.Status.RELAXED, em.Status.COMPLETED)
    assert said in solution.message


@pytest.mark.parametrize("name", ["auto", "weight"])
def test_the_problem_of_a_bounded_solution_is_solved_as_it_is(name: str) -> None:
    problem = bounded(name).problem
    assert em.solve(problem).problem.monitor == problem.monitor


def test_a_uniform_mesh_that_a_bound_leaves_is_not_laid_on_the_monitor() -> None:
    problem = em.Problem(monitor=em.ArcLength(u=STEEP, orthogonality=0.02), grid=em.Grid(n_xi=9, n_eta=9))
    (said,) = (text for text in em.solve(problem).certificate.warnings if "is uniform" in text)
    assert "the bound of 0.02 degrees of non-orthogonality leaves next to nothing" in said
    assert said.endswith("Raise orthogonality.")


def test_a_round_of_a_solver_keeps_the_bound() -> None:
    nodes = em.Mesh.uniform(em.Grid(n_xi=17, n_eta=17))
    values = STEEP.evaluate(nodes.x, nodes.y)[0]
    u = em.NodalField(mesh=nodes, values=values)
    free, bounded = solved(em.NodalSolution(u=u)), solved(em.NodalSolution(u=u, orthogonality=BOUND))
    assert free.faces.non_orthogonality > BOUND >= bounded.faces.non_orthogonality
    assert bounded.estimate == free.estimate
    assert [text for text in bounded.certificate.warnings if f"The bound of {BOUND:g} degrees" in text]


def test_a_bound_that_holds_changes_nothing() -> None:
    for free in (em.ArcLength(u=em.Expression("tanh(5*(x - y))")), em.LeastError(u=em.Expression("exp(x*y)"))):
        plain = solved(free)
        bounded = solved(type(free)(u=free.u, orthogonality=plain.faces.non_orthogonality + 0.1))
        assert np.array_equal(bounded.mesh.x, plain.mesh.x)
        assert bounded.relaxed == plain.relaxed == ()
        assert bounded.status is plain.status


def test_it_holds_with_subdomains_and_on_a_bent_domain() -> None:
    front = em.Expression("tanh(20*(hypot(x, y) - 1.5 + 0.2*sin(5*x)))")
    arc = em.ArcLength(u=front, orthogonality=BOUND)
    for schwarz in (None, em.Schwarz(subdomains=(2, 1))):
        solution = solved(arc, schwarz, domain=em.AnnulusSector())
        assert 0.8 * BOUND < solution.faces.non_orthogonality <= BOUND
        assert solution.relaxed[0].what == "a"
        assert 0.0 < solution.relaxed[0].reached < solution.relaxed[0].asked
        assert solution.status is em.Status.RELAXED


def test_a_given_mesh_with_larger_angles_is_not_kept() -> None:
    free = solved(em.LeastError(u=STEEP))
    assert free.faces.non_orthogonality > BOUND
    for name in ("least_error", "arc_length"):
        assert solved(MONITORS[name], initial=free.reference).faces.non_orthogonality <= BOUND


@pytest.mark.everything
def test_a_target_reaches_its_error_within_the_bound() -> None:
    monitor = em.LeastError(u=em.Expression("tanh(9*(x - y*y))"), orthogonality=BOUND)
    aimed = em.solve_to(em.Target(error=2e-3), monitor=monitor)
    assert aimed.faces.non_orthogonality <= BOUND
    assert aimed.certificate.target.reached <= 2e-3


def test_a_domain_whose_uniform_mesh_is_beyond_the_bound_is_refused() -> None:
    sheared = em.Quadrilateral(
        bottom=em.Curve.through([[0, 0], [1, 0]]),
        right=em.Curve.through([[1, 0], [2, 1]]),
        top=em.Curve.through([[1, 1], [2, 1]]),
        left=em.Curve.through([[0, 0], [1, 1]]),
    )
    with pytest.raises(em.InputError, match="45 degrees on this domain already") as caught:
        solved(em.ArcLength(u=em.Expression("x*y"), orthogonality=40.0), domain=sheared)
    assert caught.value.field == "monitor.orthogonality"
    assert solved(em.ArcLength(u=em.Expression("x*y"), orthogonality=50.0), domain=sheared).status.succeeded


@pytest.mark.parametrize("bad", [0.0, -1.0, 91.0, float("nan"), True, "50"])
def test_a_bound_that_is_no_angle_is_refused(bad: Any) -> None:
    for make in (em.ArcLength, em.Curvature, em.LeastError, em.Auto):
        with pytest.raises(em.InputError, match="angle of non-orthogonality") as caught:
            make(u=STEEP, orthogonality=bad)
        assert caught.value.field == "orthogonality"


DIAGONAL = em.Expression("tanh(25*(x + 0.7*y - 0.1))")


@pytest.mark.parametrize("bound", [60.0, 45.0])
def test_on_blocks_oblique_corners_become_dearer_until_the_bound_holds(bound: float) -> None:
    domain = l_shape(1000)
    free = em.solve(em.Problem(monitor=em.LeastError(u=DIAGONAL), domain=domain))
    assert free.faces.non_orthogonality > 60.0
    monitor = em.LeastError(u=DIAGONAL, orthogonality=bound)
    solution = em.solve(em.Problem(monitor=monitor, domain=domain))
    assert solution.faces.non_orthogonality <= bound
    assert any("oblique corners" in text for text in solution.certificate.warnings)
    assert 1.5 < solution.interpolation.gain_l2 < free.interpolation.gain_l2
    assert solution.angles.share_within > 0.99
    assert free.angles.share_within < 0.95


def test_on_blocks_the_initial_mesh_is_left_where_no_weight_is_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(orthogonality, "OBLIQUENESS_TRIALS", ())
    monitor = em.LeastError(u=DIAGONAL, orthogonality=45.0)
    solution = em.solve(em.Problem(monitor=monitor, domain=l_shape(300)))
    assert solution.mesh is solution.initial
    assert "left no mesh but the initial one" in solution.note
