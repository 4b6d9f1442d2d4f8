"""The Schwarz iteration: honest estimates, records of every iteration, stalls, and conditions that take over."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import pytest

import equimesh as em
from cases import problem
from solver.schwarz.runs import HOPELESS, LINEAR_ROBIN, PAPER, assert_same


def test_the_estimate_is_honest() -> None:
    """Where convergence is claimed, the error against the single-domain mesh is below the tolerance."""
    for condition, tolerance in itertools.product(
        [em.Classical(), em.LinearRobin(), em.NonlinearRobin(), em.Optimized()], [1e-4, 1e-7]
    ):
        settings = em.Schwarz(
            transmission=condition,
            tolerance=tolerance,
            compare_single_domain=True,
            max_iterations=150,
        )
        last = em.solve(PAPER, settings).iterations[-1]
        assert last.error is not None
        assert last.error < 1.1 * tolerance
        assert last.estimate <= tolerance


def test_iterate_belongs_to_its_caller() -> None:
    start = em.Mesh.uniform(PAPER.grid)
    first = list(itertools.islice(em.iterate(PAPER, em.Schwarz(), start), 3))
    assert [record.iteration for record in first] == [0, 1, 2]
    assert first[0].mesh is start
    assert first[0].error is None
    assert math.isnan(first[0].change)
    assert first[2].change == pytest.approx(
        max(abs(first[2].mesh.x - first[1].mesh.x).max(), abs(first[2].mesh.y - first[1].mesh.y).max())
    )
    assert [r.subdomain for r in first[1].subdomains] == [0, 1]
    assert first[1].work > 3 * PAPER.grid.points  # the line corrections alone


def test_errors_are_per_subdomain_and_coordinate() -> None:
    settings = em.Schwarz(subdomains=(3, 1), transmission=em.Classical(), compare_single_domain=True, tolerance=1e-3)
    reference = em.solve(PAPER, mode=em.Mode.TIGHT).mesh
    solution = em.solve(PAPER, settings)
    start = solution.iterations[0]
    decomposition = solution.decomposition
    assert decomposition is not None
    for part, record in zip(decomposition.parts, start.subdomains, strict=True):
        columns = list(part.columns)
        assert record.error_x == pytest.approx(abs(start.mesh.x[columns] - reference.x[columns]).max(), abs=1e-9)
        assert record.error_y == pytest.approx(abs(start.mesh.y[columns] - reference.y[columns]).max(), abs=1e-9)
    assert start.error == max(max(r.error_x, r.error_y) for r in start.subdomains)  # type: ignore[type-var]


def test_subdomains_that_stall_for_good_end_the_iteration() -> None:
    """Three times in a row, with Newton steps on the whole grid in between that lead nowhere."""
    settings = em.Schwarz(overlap=2, transmission=em.Classical(), max_iterations=40, fallback=False)
    with pytest.raises(em.SolveError, match="subdomain 0, 1 stalled for good") as caught:
        em.solve(HOPELESS, settings)
    partial = caught.value.solution
    assert partial.status is em.Status.NEWTON_FAILED
    assert [record.failed for record in partial.iterations] == [False] * 3 + [True]
    assert [record.global_step for record in partial.iterations] == [False] + [True] * 3
    assert all(r.stalled for r in partial.iterations[-1].subdomains)
    assert math.isinf(partial.residual)
    assert not partial.mesh.is_folded
    statuses = {r["status"] for r in partial.convergence()["iterations"][-1]["subdomains"]}
    assert statuses == {"stalled"}


def test_a_false_fixed_point_is_not_a_solution() -> None:
    """On blocks, and on strips in eta, it then comes to rest where the subdomains differ by 0.17."""
    settings = replace(LINEAR_ROBIN, fallback=False, max_iterations=30)
    solution = em.solve(problem("paper", 17), settings, check=False)
    last = solution.iterations[-1]
    assert solution.status is em.Status.NOT_CONVERGED
    assert last.estimate < 1e-9
    assert last.mismatch > 0.1
    assert not last.meets(1e-3)
    assert {record.transmission for record in solution.iterations} == {"linear_robin"}


@pytest.mark.parametrize("ordering", em.Ordering)
@pytest.mark.parametrize("subdomains", [(2, 2), (1, 2)])
def test_the_optimized_condition_takes_over_where_another_stalls(
    subdomains: tuple[int, int], ordering: em.Ordering
) -> None:
    case = problem("paper", 17)
    solution = em.solve(case, replace(LINEAR_ROBIN, subdomains=subdomains, ordering=ordering))
    names = [record.transmission for record in solution.iterations]
    first = names.index("optimized")
    assert names == ["linear_robin"] * first + ["optimized"] * (len(names) - first)
    assert first <= 15
    assert f"from iteration {first} on the optimized one took its place" in solution.message
    assert any("took its place" in warning for warning in solution.certificate.warnings)
    assert_same(solution, em.solve(case, mode=em.Mode.TIGHT), 2e-9)


@pytest.mark.parametrize("tolerance", [1e-5, 1e-8])
def test_a_slow_iteration_is_tested_before_it_is_believed(tolerance: float) -> None:
    """Some errors of this one hardly change from iteration to iteration, nor under line corrections."""
    case = problem("sine", 31, a=1.0, b=0.0)  # with 33 points the mesh of one domain is relaxed on some processors
    single = em.solve(case, mode=em.Mode.TIGHT)
    assert single.status is em.Status.CONVERGED
    solution = em.solve(case, em.Schwarz(subdomains=(2, 2), overlap=2, tolerance=tolerance))
    assert solution.status is em.Status.CONVERGED
    assert_same(solution, single, tolerance)
    assert "a Newton step was taken on the whole grid" in solution.message


def test_u_far_from_zero_has_the_accuracy_that_is_left() -> None:
    """Large beside its variation; rounding is then no stall, and no reason to give way."""
    case = replace(PAPER, monitor=em.ArcLength(u=em.Expression("1e6 + (1-exp(15*(x-1)))*sin(pi*y)")))
    single = em.solve(PAPER, mode=em.Mode.TIGHT)
    for condition in (em.Optimized(), em.LinearRobin()):
        settings = em.Schwarz(overlap=8, transmission=condition, ordering=em.Ordering.ALTERNATING)
        solution = em.solve(case, settings)
        assert solution.status is em.Status.CONVERGED
        assert {record.transmission for record in solution.iterations} == {condition.name}
        assert solution.algebraic_error is not None
        assert_same(solution, single, max(solution.algebraic_error, 1e-9))
