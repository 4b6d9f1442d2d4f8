"""The Schwarz iteration: honest estimates, records of every iteration, stalls, and conditions that take over."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

import equimesh as em
from cases import problem
from equimesh.schwarz import iteration
from equimesh.schwarz import iteration as module
from equimesh.schwarz.iteration import Claim, Rescue, Stalls, newton_step, subdomains_of, traffic, work
from equimesh.schwarz.merged_mesh import MergedMeshes
from equimesh.schwarz.records import SubdomainRecord
from solver.schwarz.bent import bent, distance
from solver.schwarz.runs import HOPELESS, LINEAR_ROBIN, PAPER, WHOLE, assert_same
from solver.schwarz.solved import solved


def test_the_estimate_is_honest() -> None:
    """Where convergence is claimed, the error against the single-domain mesh is below the tolerance."""
    for condition, tolerance in itertools.product(
        [em.Classical(), em.LinearRobin(), em.NonlinearRobin(), em.Optimized()], [1e-4, 1e-7]
    ):
        settings = em.Schwarz(
            transmission=condition, tolerance=tolerance, compare_single_domain=True, max_iterations=150
        )
        last = em.solve(PAPER, settings).iterations[-1]
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


# Without --everything strips alone: blocks are in test_subdomains.py.
@pytest.mark.parametrize(
    ("subdomains", "ordering"),
    [
        pytest.param((2, 2) if k % 2 == 0 else (1, 2), ordering, marks=() if k % 2 else pytest.mark.everything)
        for k, ordering in enumerate(em.Ordering)
    ],
)
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


@pytest.mark.parametrize("tolerance", [pytest.param(1e-5, marks=pytest.mark.everything), 1e-8])
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


# Slow claims are believed where a Newton step on the whole grid agrees with them.


SOLUTION = bent(PAPER, 0.0)


def claim(size: float) -> Claim:
    return Claim(bent(PAPER, size), estimate=1e-9, change=1e-10, before=em.Mesh.uniform(PAPER.grid))


def test_a_true_claim_is_confirmed_with_what_the_step_still_moved() -> None:
    made = claim(1e-7)
    found = iteration.examine(PAPER, WHOLE, made, 1e-5)
    assert not found.is_refuted
    assert found.mesh is made.mesh
    assert found.change == made.change
    assert found.estimate == pytest.approx(distance(made.mesh, SOLUTION), rel=0.01)


def test_a_false_claim_is_refuted_and_the_step_is_where_it_continues() -> None:
    made = claim(1e-3)
    found = iteration.examine(PAPER, WHOLE, made, 1e-5)
    assert found.is_refuted
    assert distance(found.mesh, SOLUTION) < 0.1 * distance(made.mesh, SOLUTION)
    assert found.estimate == pytest.approx(distance(made.mesh, found.mesh))
    assert found.change == pytest.approx(distance(found.mesh, made.before))


def test_a_claim_is_never_made_bolder() -> None:
    made = Claim(SOLUTION, estimate=1e-6, change=1e-7, before=SOLUTION)
    assert iteration.examine(PAPER, WHOLE, made, 1e-5).estimate == 1e-6


# Newton steps on the whole grid: taken where a subdomain stalled or the mesh folded, and counted in a row.


NEAR = bent(PAPER, 0.001)
FOLDED = em.Mesh(NEAR.x[::-1].copy(), NEAR.y)


def test_without_need_the_merged_mesh_stays() -> None:
    rescue = Rescue(PAPER, WHOLE)
    found = rescue.apply(solved(NEAR), SOLUTION)
    assert found.mesh is NEAR
    assert not found.is_stepped
    assert not rescue.has_stepped
    assert rescue.residuals == []


def test_a_step_starts_from_the_merged_mesh_and_leads_towards_the_solution() -> None:
    rescue = Rescue(PAPER, WHOLE)
    found = rescue.apply(solved(NEAR, stalled=True), SOLUTION)
    assert found.is_stepped
    assert distance(found.mesh, SOLUTION) < 0.1 * distance(NEAR, SOLUTION)
    assert rescue.residuals == [newton_step(PAPER, WHOLE, NEAR)[1]]


def test_a_folded_mesh_is_left_for_the_one_before() -> None:
    found = Rescue(PAPER, WHOLE).apply(solved(FOLDED), NEAR)
    assert found.is_stepped
    assert np.array_equal(found.mesh.x, newton_step(PAPER, WHOLE, NEAR)[0].x)


def test_only_steps_in_a_row_count() -> None:
    rescue = Rescue(PAPER, WHOLE)
    for _ in range(2):
        rescue.apply(solved(NEAR, stalled=True), NEAR)
    assert not rescue.has_failed
    rescue.apply(solved(NEAR), NEAR)
    assert rescue.residuals == []
    for k in range(3):
        assert rescue.has_failed is False, k
        rescue.apply(solved(NEAR, stalled=True), NEAR)
    assert rescue.has_failed
    assert rescue.is_stuck, "three times the same step"


@pytest.mark.parametrize(
    ("residuals", "stuck"),
    [
        ([1.0, 1.0], False),
        ([1.0, 1.0, 0.95], True),
        ([1.0, 1.0, 0.5], False),
        ([9.0, 1.0, 1.0, 1.0], True),
        ([math.inf] * 3, True),
        ([1.0, 1.0, math.nan], True),
    ],
    ids=str,
)
def test_steps_that_do_not_lower_the_residual_lead_nowhere(residuals: list[float], stuck: bool) -> None:
    rescue = Rescue(PAPER, WHOLE)
    rescue.residuals = residuals
    assert rescue.is_stuck is stuck


def test_large_grids_are_not_factorised(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_FACTORISED_POINTS", PAPER.grid.points - 1)
    rescue = Rescue(PAPER, WHOLE)
    found = rescue.apply(solved(NEAR, stalled=True), SOLUTION)
    assert np.array_equal(found.mesh.x, NEAR.x)
    assert found.mesh.x is not NEAR.x, "a copy"
    assert rescue.residuals == [math.inf]


# What says that an iteration leads nowhere: repeated rescues, false fixed points, and changes that fall too slowly.


MESH = em.Mesh.uniform(PAPER.grid)
ROBIN, CLASSICAL = em.LinearRobin(), em.Classical()


def calls(
    changes: Sequence[float],
    *,
    transmission: em.TransmissionCondition = ROBIN,
    rescued: int = 0,
    mismatch: float = 0.0,
    fallback: bool = True,
    rescue: Rescue | None = None,
) -> bool:
    """Whether another condition is called for after these changes, the first ``rescued`` with classical data."""
    stalls = Stalls(em.Schwarz(transmission=transmission, fallback=fallback), 1e-14)
    for k, change in enumerate(changes):
        stalls.note(solved(MESH, classical=k < rescued, mismatch=mismatch), change, 0.0)
    return stalls.call_for_another_condition(rescue or Rescue(PAPER, WHOLE))


def falling(factor: float, count: int) -> list[float]:
    return [0.1 * factor**k for k in range(count)]


def test_an_iteration_that_converges_calls_for_nothing() -> None:
    assert not calls([])
    assert not calls(falling(0.3, 20))
    assert not calls(falling(1.0, 8)), "too few to be sure"


def test_changes_that_fall_too_slowly() -> None:
    assert calls(falling(0.8, 9))
    assert not calls(falling(0.7, 9))
    assert not calls(falling(0.8, 9), transmission=CLASSICAL), "slow by nature"
    assert calls(falling(1.0, 9), transmission=CLASSICAL)
    assert not calls([1e-15] * 20), "rounding is no stall"


def test_subdomains_that_do_not_agree_where_the_mesh_rests() -> None:
    assert calls([0.1, 1e-5], mismatch=0.1)
    assert not calls([0.1, 1e-3], mismatch=0.1)
    assert not calls([0.1, 1e-17], mismatch=1e-13), "a mismatch of rounding"


@pytest.mark.parametrize(("rescued", "expected"), [(2, False), (3, True)])
def test_classical_data_in_three_iterations(rescued: int, expected: bool) -> None:
    assert calls(falling(0.3, 5), rescued=rescued) is expected


def test_steps_on_the_whole_grid_in_a_row() -> None:
    rescue = Rescue(PAPER, WHOLE)
    rescue.residuals = [1.0, 0.5, 0.1]
    assert calls(falling(0.3, 3), rescue=rescue)
    assert not calls(falling(0.3, 3), rescue=rescue, fallback=False)
    assert not calls(falling(1.0, 30), transmission=em.Optimized()), "nothing is left to take over"


def test_the_estimate_is_that_of_the_records() -> None:
    stalls = Stalls(em.Schwarz(transmission=ROBIN), 1e-14)
    assert math.isnan(stalls.estimate(0.1))
    stalls.note(solved(MESH), 0.1, 0.0)
    assert stalls.estimate(0.05) == pytest.approx(0.05)
    assert stalls.estimate(0.09) == pytest.approx(0.09 * 9)


def test_eight_iterations_are_not_slow() -> None:
    stalls = Stalls(em.Schwarz(transmission=ROBIN), 1e-14)
    found = []
    for change in falling(0.5, 10):
        found.append(stalls.was_slow)
        stalls.note(solved(MESH), change, 0.0)
    assert found == [False] * 8 + [True] * 2


@pytest.mark.parametrize(
    ("settings", "deviations", "expected"),
    [
        (em.Schwarz(), [0.3, 0.05], True),
        (em.Schwarz(), [0.3, math.nan], True),
        (em.Schwarz(), [0.05, 1e-3], False),
        (em.Schwarz(), [0.3], False),
        (em.Schwarz(), [0.3, 0.05, 0.05], False),
        (em.Schwarz(acceleration=em.Acceleration.ANDERSON), [0.3, 0.05], False),
        (em.Schwarz(line_correction=2), [0.3, 0.05], False),
        (em.Schwarz(ordering=em.Ordering.SYMMETRIC), [0.3, 0.05], False),
        (em.Schwarz(transmission=ROBIN), [0.3, 0.05], False),
    ],
)
def test_newton_takes_over_after_two_iterations_that_came_no_nearer(
    settings: em.Schwarz, deviations: list[float], expected: bool
) -> None:
    stalls = Stalls(settings, 1e-14)
    for deviation in deviations:
        stalls.note(solved(MESH), 0.1, deviation)
    assert stalls.call_for_newton is expected


# Work and traffic of an iteration, counted by hand.


SETTINGS = em.Schwarz(transmission=em.Classical(), subdomains=(2, 1), overlap=4)
STRIPS = SETTINGS.decompose(PAPER.grid)
SUBDOMAINS = subdomains_of(
    PAPER, MergedMeshes(STRIPS), SETTINGS, enough=0.0, threads=1
)  # of 14 columns each, of 20 points


def test_nodes_are_counted_as_often_as_they_were_corrected() -> None:
    records = [
        SubdomainRecord(subdomain=0, newton_steps=3, residual=0.0),
        SubdomainRecord(subdomain=1, newton_steps=0, residual=0.0, sweeps=5),
    ]
    assert work(PAPER.grid, SUBDOMAINS, records, 0) == 14 * 20 * (3 + 5)
    assert work(PAPER.grid, SUBDOMAINS, records, 2) == 14 * 20 * (3 + 5) + 2 * 24 * 20


def test_each_strip_receives_two_coordinates_of_a_line_and_the_nodes_of_its_overlap() -> None:
    data, nodes = 2 * (2 * 20), 2 * (4 * 20)  # of the four columns that both have, the first belongs to the first strip
    assert traffic(STRIPS, SETTINGS, SUBDOMAINS, [[0, 1]], 0) == 8 * (data + nodes)
    assert traffic(STRIPS, SETTINGS, SUBDOMAINS, [[0], [1]], 0) == 8 * (data + nodes)
    there_and_back = 8 * (data + 2 * 20 + nodes + 2 * 1 * 20)
    assert traffic(STRIPS, SETTINGS, SUBDOMAINS, [[0], [1], [0]], 0) == there_and_back


def test_a_line_correction_takes_one_line_of_nodes_and_two_numbers_of_each_line_both_ways() -> None:
    without = traffic(STRIPS, SETTINGS, SUBDOMAINS, [[0, 1]], 0)
    assert traffic(STRIPS, SETTINGS, SUBDOMAINS, [[0, 1]], 3) == without + 3 * 8 * 2 * (2 * 20 + 2 * 20)


def test_a_robin_condition_sends_classical_data_too_and_reads_one_line_more() -> None:
    robin = em.Schwarz(transmission=em.LinearRobin(), subdomains=(2, 1), overlap=4)
    subdomains = subdomains_of(PAPER, MergedMeshes(STRIPS), robin, enough=0.0, threads=1)
    assert traffic(STRIPS, robin, subdomains, [[0, 1]], 0) == 8 * (2 * (4 * 20) + 2 * (6 * 20))


def test_an_optimized_condition_sends_a_sum_for_each_line() -> None:
    optimized = em.Schwarz(subdomains=(2, 1), overlap=4)
    subdomains = subdomains_of(PAPER, MergedMeshes(STRIPS), optimized, enough=0.0, threads=1)
    assert traffic(STRIPS, optimized, subdomains, [[0, 1]], 0) == 8 * (2 * 20 + 2 * (6 * 20))
