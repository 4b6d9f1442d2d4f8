"""Schwarz: rates, records, statuses, and the endings that are not a success."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

import equimesh as em
from cases import problem
from equimesh.schwarz.records import estimated, observed_rate

PAPER = problem("paper", 24, 20)


def assert_same(solution: em.Solution, other: em.Solution, tolerance: float) -> None:
    """Node positions on the reference square differ by less than ``tolerance``."""
    pairs = ((solution.reference.x, other.reference.x), (solution.reference.y, other.reference.y))
    assert max(float(abs(one - two).max()) for one, two in pairs) < tolerance


def test_classical_rate_is_the_predicted_one() -> None:
    """alpha (1 - beta) / (beta (1 - alpha)) for two strips and two parallel iterations."""
    settings = em.Schwarz(
        overlap=2,
        transmission=em.Classical(),
        ordering=em.Ordering.PARALLEL,
        compare_single_domain=True,
        tolerance=None,
        max_iterations=60,
    )
    case = problem("paper", 12, boundary=em.Boundary.EQUIDISTRIBUTED_1D)
    solution = em.solve(case, settings, initial=em.Initial.UNIFORM)
    alpha, beta = 5 / 11, 6 / 11
    assert solution.predicted_rate == pytest.approx(math.sqrt(alpha * (1 - beta) / (beta * (1 - alpha))), abs=1e-12)
    assert solution.rate == pytest.approx(solution.predicted_rate, abs=0.005)


@pytest.mark.parametrize("ordering", em.Ordering)
@pytest.mark.parametrize(("subdomains", "overlap"), [((2, 1), 3), ((1, 3), 4), ((4, 1), 4), ((3, 2), 4)], ids=str)
def test_predicted_rates_hold_for_strips_and_blocks(
    subdomains: tuple[int, int], overlap: int, ordering: em.Ordering
) -> None:
    settings = em.Schwarz(
        subdomains=subdomains,
        overlap=overlap,
        transmission=em.Classical(),
        ordering=ordering,
        compare_single_domain=True,
        tolerance=1e-7,
        max_iterations=150,
    )
    solution = em.solve(PAPER, settings)
    assert solution.rate == pytest.approx(solution.predicted_rate, abs=0.01)


def test_wider_overlap_and_robin_conditions_take_fewer_iterations() -> None:
    counts = {}
    for condition, overlap in [(em.Classical(), 2), (em.Classical(), 4), (em.Classical(), 8), (em.LinearRobin(), 2)]:
        settings = em.Schwarz(
            overlap=overlap,
            transmission=condition,
            ordering=em.Ordering.ALTERNATING,
            tolerance=1e-8,
            max_iterations=150,
        )
        counts[condition.name, overlap] = len(em.solve(PAPER, settings).iterations) - 1
    assert counts == {("classical", 2): 74, ("classical", 4): 25, ("classical", 8): 12, ("linear_robin", 2): 4}


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


def test_estimate_by_hand() -> None:
    assert math.isnan(estimated([math.nan], 1e-15))
    assert math.isnan(estimated([math.nan, 0.1], 1e-15))
    assert estimated([math.nan, 0.0], 1e-15) == 0.0
    assert estimated([math.nan, 0.1, 0.09], 1e-15) == pytest.approx(0.09 * 9)
    assert estimated([math.nan, 0.1, 0.01, 0.001], 1e-15) == pytest.approx(0.001)  # never less than the change
    assert estimated([math.nan, 0.1, 0.2], 1e-15) == math.inf
    assert estimated([math.nan, 0.4, 0.0, 0.1], 1e-15) == pytest.approx(0.1)
    assert estimated([math.nan, 1e-3, 1e-16, 2e-16], 1e-15) == 2e-16
    assert estimated([math.nan, 0.0, 1e-3], 1e-15) == math.inf  # after an iteration in which all stalled
    assert estimated([math.nan, 0.0, 1e-3, 1e-4], 1e-15) == math.inf


def test_what_meets_a_tolerance() -> None:
    """Each of the demands by itself: a small estimate, agreement, no subdomain left unsolved, no fold."""
    settings = em.Schwarz(transmission=em.LinearRobin(), tolerance=1e-6)
    last = em.solve(PAPER, settings).iterations[-1]
    assert last.meets(1e-6)
    assert not last.meets(None)
    assert not replace(last, estimate=2e-6).meets(1e-6)
    assert not replace(last, estimate=math.nan).meets(1e-6)
    assert not replace(last, mismatch=3e-6).meets(1e-6)
    assert not replace(last, min_jacobian=0.0).meets(1e-6)
    first, *others = last.subdomains
    unsolved = replace(last, subdomains=(replace(first, stalled=True), *others))
    assert not unsolved.meets(1e-6)
    assert replace(unsolved, deviation=1e-8).meets(1e-6)  # the equations were tested on the whole mesh


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


def test_not_converged_says_so_and_keeps_what_there_is() -> None:
    settings = em.Schwarz(transmission=em.Classical(), max_iterations=3)
    with pytest.raises(em.SolveError, match="within the allowed iterations") as caught:
        em.solve(PAPER, settings)
    partial = caught.value.solution
    assert partial.status is em.Status.NOT_CONVERGED
    assert len(partial.iterations) == 4
    assert not partial.mesh.is_folded


def test_a_fixed_number_of_iterations_is_a_success() -> None:
    settings = em.Schwarz(transmission=em.Classical(), tolerance=None, max_iterations=3)
    solution = em.solve(PAPER, settings)
    assert (solution.status, len(solution.iterations)) == (em.Status.COMPLETED, 4)


def test_a_folded_mesh_is_never_a_success(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where the asked number of iterations was run; the merged mesh of good subdomains is made to fold here."""
    settings = em.Schwarz(tolerance=None, max_iterations=1)

    def folding(*arguments: object, threads: int) -> Iterator[em.Iteration]:
        for record in em.iterate(*arguments, threads=threads):  # type: ignore[arg-type]
            yield replace(record, mesh=em.Mesh(record.mesh.x[::-1].copy(), record.mesh.y))

    monkeypatch.setattr("equimesh.solving.schwarz.iterate", folding)
    with pytest.raises(em.SolveError, match=r"inverted cell\. Run more iterations, lower a") as caught:
        em.solve(PAPER, settings)
    assert caught.value.solution.status is em.Status.FOLDED


def test_a_newton_failure_says_where_and_folds_nothing() -> None:
    hopeless = problem("wave", 9, boundary=em.Boundary.EQUIDISTRIBUTED_1D, a=1.0, b=0.0)
    with pytest.raises(em.SolveError, match="and a cross-line term") as caught:
        em.solve(hopeless, allow_relaxed=False)
    assert caught.value.solution.status is em.Status.NEWTON_FAILED
    assert not caught.value.solution.mesh.is_folded


HOPELESS = problem("wave", 9, boundary=em.Boundary.EQUIDISTRIBUTED_1D, a=1.0, b=0.0)


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


def test_where_no_iteration_leads_to_a_mesh_a_single_domain_does() -> None:
    settings = em.Schwarz(overlap=2, transmission=em.Classical(), max_iterations=40)
    solution = em.solve(HOPELESS, settings)
    single = em.solve(HOPELESS, mode=em.Mode.TIGHT)
    assert solution.status is single.status is em.Status.RELAXED
    assert np.array_equal(solution.mesh.x, single.mesh.x)
    names = [record.transmission for record in solution.iterations]
    assert names == ["classical"] * 4 + ["optimized"] * (len(names) - 4)
    assert solution.iterations[-1].failed
    assert "this is the mesh of a single domain" in solution.message
    assert any("of a single domain" in warning for warning in solution.certificate.warnings)
    with pytest.raises(em.SolveError, match="of a single domain"):
        em.solve(HOPELESS, settings, allow_relaxed=False)


LINEAR_ROBIN = em.Schwarz(
    subdomains=(2, 2), transmission=em.LinearRobin(), ordering=em.Ordering.ALTERNATING, tolerance=1e-9
)


def test_robin_that_finds_no_solution_is_rescued_and_reported() -> None:
    """Linear Robin with p = auto has no solution on blocks of the paper's function in the first iteration."""
    solution = em.solve(problem("paper", 17), LINEAR_ROBIN)
    assert any(r.classical for r in solution.iterations[1].subdomains)
    assert "classical data took its place" in solution.message


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


def test_one_subdomain_is_the_single_domain_solve() -> None:
    solution = em.solve(PAPER, em.Schwarz(subdomains=(1, 1)))
    single = em.solve(PAPER, mode=em.Mode.TIGHT).mesh
    assert abs(solution.mesh.x - single.x).max() < 1e-10  # the single-domain solve ends there
    assert len(solution.iterations) - 1 <= 3


def test_observer_sees_newton_steps_and_iterations() -> None:
    seen: list[em.Event] = []
    settings = em.Schwarz(tolerance=1e-6, compare_single_domain=True)
    solution = em.solve(PAPER, settings, observe=seen.append)
    assert [e for e in seen if isinstance(e, em.Iteration)] == list(solution.iterations)
    grids = {e.grid for e in seen if isinstance(e, em.Step)}
    assert grids == {em.Grid(n_xi=13, n_eta=11), PAPER.grid}


@pytest.mark.parametrize("bad", [{"tolerance": 0.0}, {"tolerance": math.nan}, {"max_iterations": 0}])
def test_bad_settings_are_refused(bad: dict[str, float]) -> None:
    with pytest.raises(em.InputError):
        replace(em.Schwarz(), **bad)
    for p in (0.0, -1.0, math.inf, "best"):
        with pytest.raises(em.InputError, match="positive number"):
            em.LinearRobin(p=p)  # type: ignore[arg-type]


def test_convergence_is_plain_numbers() -> None:
    convergence = em.solve(PAPER, em.Schwarz(tolerance=1e-6)).convergence()
    first, last = convergence["iterations"][0], convergence["iterations"][-1]
    assert first["change"] is None
    assert first["error"] is None
    assert type(last["max_q_eq"]) is float
    assert last["subdomains"][0]["status"] == "converged"
    assert convergence["predicted_rate"] == 0.0


def test_a_spline_of_samples_gives_the_mesh_of_the_function() -> None:
    """Node positions differ by the accuracy of the spline: fourth order in the spacing of the samples."""
    case = problem("paper", 12, boundary=em.Boundary.EQUIDISTRIBUTED_1D)
    exact = em.solve(case, mode=em.Mode.TIGHT).mesh
    differences = []
    for samples in (33, 65, 129):
        axis = np.linspace(0, 1, samples)
        (values,) = case.monitor.u.evaluate(*np.meshgrid(axis, axis, indexing="ij"))
        monitor = replace(case.monitor, u=em.GridSamples(x=axis, y=axis, values=values))
        mesh = em.solve(replace(case, monitor=monitor)).mesh
        differences.append(max(abs(mesh.x - exact.x).max(), abs(mesh.y - exact.y).max()))
    assert differences[0] < 2e-5
    assert differences[2] < 3e-8
    assert differences[1] / differences[2] > 8


def test_the_observed_rate_is_that_of_the_tail_above_rounding() -> None:
    errors = [math.nan, 0.5, *(0.1**k for k in range(1, 9)), 2e-14, 1e-14, 1e-14]
    assert observed_rate(errors, 1e-13) == pytest.approx(0.1)
    assert observed_rate(errors, 1e-16) != pytest.approx(0.1, rel=0.3)  # what rounding leaves says nothing of a rate
    assert observed_rate([math.nan, 1e-3], 1e-13) is None
    assert observed_rate([math.nan, 0.0, 0.0], 1e-13) is None


@pytest.mark.parametrize("tolerance", [1e-5, 1e-8])
def test_a_slow_iteration_is_tested_before_it_is_believed(tolerance: float) -> None:
    """Some errors of this one hardly change from iteration to iteration, nor under line corrections."""
    case = problem("sine", 33, a=1.0, b=0.0)
    single = em.solve(case, mode=em.Mode.TIGHT)
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


@pytest.mark.parametrize(
    "bad",
    [
        {"transmission": "optimized"},
        {"subdomains": 4},
        {"subdomains": (2.5, 1)},
        {"overlap": 2.5},
        {"max_iterations": 2.5},
        {"max_iterations": math.nan},
        {"tolerance": True},
        {"line_correction": 11},
        {"line_correction": True},
        {"acceleration": "newton", "line_correction": 1},
        {"ordering": "backward"},
    ],
    ids=str,
)
def test_settings_of_the_wrong_kind_are_refused(bad: dict[str, object]) -> None:
    with pytest.raises(em.InputError):
        replace(em.Schwarz(), **bad)  # type: ignore[arg-type]


def test_a_solve_may_start_from_a_mesh() -> None:
    """That of a front a little before, with subdomains and without; another shape, or a folded one, is refused."""
    before, now = (
        em.Problem(
            monitor=em.ArcLength(u=em.Expression("tanh(20*(x + y/2 - 0.75 - t))", t=t)), grid=em.Grid(n_xi=33, n_eta=33)
        )
        for t in (0.0, 1e-3)
    )
    start = em.solve(before, mode=em.Mode.TIGHT).reference
    cold = em.solve(now, mode=em.Mode.TIGHT)
    assert_same(em.solve(now, initial=start), cold, 1e-9)
    warm = em.solve(now, em.Schwarz(subdomains=(3, 2)), initial=start)
    assert_same(warm, cold, 1e-9)
    assert len(warm.iterations) - 1 <= 3
    far = em.solve(now, em.Schwarz(subdomains=(3, 2)), initial=em.Mesh.uniform(now.grid))
    assert_same(far, cold, 1e-9)
    assert "too far from the solution to start from" in far.message
    assert repr(far) == f"<Solution: 33 x 33 points, converged, {len(far.iterations)} iterations>"
    for wrong in (em.solve(PAPER).reference, em.Mesh(start.x[::-1].copy(), start.y)):
        with pytest.raises(em.InputError, match="the mesh to start from"):
            em.solve(now, initial=wrong)


@pytest.mark.parametrize("n", [17, 33, 65])
def test_to_the_error_of_the_discretization(n: int) -> None:
    case = problem("tanh20", n)
    solution = em.solve(case, em.Schwarz(subdomains=(2, 2), tolerance="discretization"))
    tight = em.solve(case, mode=em.Mode.TIGHT)
    assert solution.discretization_error is not None
    assert len(solution.iterations) - 1 <= 2
    assert_same(solution, tight, 0.25 * solution.discretization_error)
