"""Every solve tells its observer how far it is, and what it does."""

from __future__ import annotations

import math
from typing import Any

import pytest

import equimesh as em
from equimesh.least_error.nest import nested_levels
from equimesh.single_domain.continuation import Relaxation
from equimesh.solving.status import Announcer, DescentProgress, IterationProgress, SweepProgress, approach, level_share

U = em.Expression("tanh(8*(x-y))")
GRID = em.Grid(n_xi=17, n_eta=17)
STEP = em.Step(level=0, levels=1, grid=GRID, step=5, residual=0.5, mesh=em.Mesh.uniform(GRID))


def told_by(problem: em.Problem, schwarz: em.Schwarz | None = None, **options: Any) -> list[em.Event]:
    told: list[em.Event] = []
    em.solve(problem, schwarz, threads=1, check=False, observe=told.append, **options)
    return told


CASES: dict[str, tuple[em.Monitor, em.Schwarz | None, str]] = {
    "arc length": (em.ArcLength(u=U), None, "sweeping the 33 x 33 grid"),
    "gradient map": (em.Weight(rho=em.Expression("1 + x"), map="gradient"), None, "solving for the map on the 17 x 17"),
    "least error": (em.LeastError(u=U), None, "descending, step "),
    "auto": (em.Auto(u=U), None, "descending, step "),
    "schwarz": (em.ArcLength(u=U), em.Schwarz(overlap=2, tolerance=None, max_iterations=4), "iteration 4 of 4"),
    "finite volumes": (em.Auto(u=U, purpose="finite_volume"), None, "candidate 22 of 22: sweeping the 9 x 9 grid"),
}


@pytest.mark.parametrize("name", CASES)
def test_the_share_never_falls_and_the_words_say_what_is_done(name: str) -> None:
    monitor, schwarz, words = CASES[name]
    n = {"arc length": 33, "finite volumes": 9}.get(name, 17)
    told = told_by(em.Problem(monitor=monitor, grid=em.Grid(n_xi=n, n_eta=n)), schwarz)
    known = [event.fraction for event in told if event.fraction is not None]
    assert known == sorted(known)
    assert 0.0 <= known[0] < 0.5 < known[-1] <= 1.0
    assert told[-1].phase.startswith(words)
    assert all(event.phase for event in told)


class NowAndThen:
    """An observer that is due at every third record."""

    def __init__(self) -> None:
        self.asked, self.told = 0, list[em.Event]()

    def is_due(self) -> bool:
        self.asked += 1
        return self.asked % 3 == 0

    def __call__(self, event: em.Event) -> None:
        self.told.append(event)


def test_an_observer_that_says_when_it_is_due_gets_the_same_records_but_only_those() -> None:
    problem, seldom = em.Problem(monitor=em.ArcLength(u=U), grid=GRID), NowAndThen()
    em.solve(problem, threads=1, observe=seldom)
    told = told_by(problem)
    assert seldom.asked == len(told) > 6
    assert [(one.fraction, one.phase) for one in seldom.told] == [(one.fraction, one.phase) for one in told[2::3]]


def test_the_comparison_of_monitors_is_told() -> None:
    told = told_by(em.Problem(monitor=em.Auto(u=U), grid=GRID))
    first = [event.phase.split(":")[0] for event in told if event.phase.startswith("comparing")]
    # The second candidate, straight lines, is left out.
    assert list(dict.fromkeys(first)) == [f"comparing monitors, {number} of 3" for number in (1, 3)]


def test_relaxed_equations_are_told_without_a_share() -> None:
    steep = em.Expression("tanh(200*((x-0.5)**2 + (y-0.5)**2 - 0.09))")
    told = told_by(em.Problem(monitor=em.ArcLength(u=steep, a=1.0, b=0.0), grid=GRID))
    relaxing = [event for event in told if event.phase.startswith("relaxing, step ")]
    assert [event.phase for event in relaxing[:3]] == [f"relaxing, step {number}" for number in (1, 2, 3)]
    assert {event.fraction for event in relaxing} == {None}


def test_the_start_of_an_iteration_to_a_tolerance_has_no_share() -> None:
    told = told_by(em.Problem(monitor=em.ArcLength(u=U), grid=GRID), em.Schwarz(overlap=2))
    start = [event for event in told if event.phase.startswith("for the start: ")]
    assert start
    assert {event.fraction for event in start} == {None}


def test_the_solution_is_the_same_with_an_observer() -> None:
    problem = em.Problem(monitor=em.Auto(u=U), grid=GRID)
    seen: list[em.Event] = []
    watched, alone = em.solve(problem, observe=seen.append, threads=1), em.solve(problem, threads=1)
    assert watched.mesh.distance(alone.mesh) == 0.0
    assert seen


def test_parts_of_parts_lie_in_the_whole() -> None:
    told: list[em.Event] = []
    whole = Announcer.of(told.append)
    assert Announcer.of(whole) is whole
    inner = whole.part(0.5, 1.0, "outer").part(0.0, 0.5, "inner")
    assert (inner.begin, inner.end) == (0.5, 0.75)
    inner.announce(STEP)
    whole.part(0.0, 0.1, course=SweepProgress()).announce(STEP)  # less than what was told: the share stays
    whole.part(None).announce(STEP)
    assert [event.phase for event in told][:2] == [
        "outer: inner: sweeping the 17 x 17 grid",
        "sweeping the 17 x 17 grid",
    ]
    assert [event.fraction for event in told] == [0.625, 0.625, None]


def test_a_small_part_of_unknown_length_tells_its_begin() -> None:
    told: list[em.Event] = []
    whole = Announcer.of(told.append)
    assert whole is not None
    relaxed = em.Step(**{**STEP.__dict__, "relaxation": type(STEP.relaxation)(strength=0.5)})
    for begin, end in ((0.3, 0.4), (0.4, 1.0)):
        whole.part(begin, end).announce(relaxed)
    assert [event.fraction for event in told] == [0.3, None]


GRIDS = [em.Grid(n_xi=n, n_eta=n) for n in (9, 17, 33)]
MESHES = [em.Mesh.uniform(grid) for grid in GRIDS]


def step(level: int, number: int, **more: object) -> em.Step:
    return em.Step(
        level=level, levels=3, grid=GRIDS[level], step=number, residual=0.5, mesh=MESHES[level], **more # type: ignore[arg-type]
    )  # fmt: skip


def iteration(number: int, change: float) -> em.Iteration:
    u = em.Expression("x*y")
    problem = em.Problem(monitor=em.ArcLength(u=u), grid=GRIDS[0])
    return em.Iteration(
        iteration=number,
        problem=problem,
        min_jacobian=1.0,
        change=change,
        estimate=change,
        mismatch=0.0,
        subdomains=(),
        transmission="classical",
        mesh=MESHES[0],
        reference=MESHES[0],
    )


def test_the_finest_of_three_grids_is_three_quarters_of_the_work() -> None:
    assert level_share(0, 3, 0.0) == 0.0
    assert level_share(2, 3, 0.0) == pytest.approx(5 / 21)
    assert level_share(2, 3, 1.0) == 1.0


def test_more_steps_than_expected_never_fill_the_share() -> None:
    shares = [approach(number, 4.0) for number in range(1, 9)]
    assert shares[:2] == [0.25, 0.5]
    assert shares == sorted(shares)
    assert shares[-1] == 8 / 9


def test_a_finer_grid_is_expected_to_take_as_many_sweeps_as_the_one_before() -> None:
    course = SweepProgress()
    for number in range(1, 5):
        course.look(step(0, number))
    share, phase = course.look(step(1, 1))
    assert phase == "sweeping the 17 x 17 grid"
    assert share == pytest.approx((1 + 4 * 0.25) / 21)


def test_the_end_of_a_tight_solve_follows_from_its_contraction() -> None:
    course = SweepProgress(mode=em.Mode.TIGHT)
    share, _ = course.look(step(2, 5, contraction=0.1))
    assert share == pytest.approx(level_share(2, 3, 5 / (5 + math.log10(0.5e10))))


def test_of_relaxed_equations_nobody_knows_the_end() -> None:
    course, relaxed = SweepProgress(), Relaxation(strength=0.5)
    assert course.look(step(0, 7)) == (level_share(0, 3, 0.7), "sweeping the 9 x 9 grid")
    told = [course.look(step(0, number, relaxation=relaxed)) for number in (1, 2, 1)]
    assert told == [(None, f"relaxing, step {number}") for number in (1, 2, 3)]


def test_a_solve_that_begins_again_on_other_grids_has_no_share() -> None:
    course = SweepProgress()
    course.look(step(1, 1))
    assert course.look(step(0, 1))[0] is None
    assert course.look(step(1, 1))[0] is None


def test_a_descent_of_two_starts_fills_its_share() -> None:
    levels = nested_levels(em.Grid(n_xi=33, n_eta=33))
    course, shares = DescentProgress(levels, 2, 1), []

    def look(level: int, start: str, number: int) -> None:
        record = em.Descent(
            level=level, levels=3, grid=GRIDS[level], step=number, steps=levels[level].steps, error=0.1, gain=None,
            distortion=0.0, min_jacobian=1.0, mesh=MESHES[level], start=start,
        )  # fmt: skip
        share, phase = course.look(record)
        assert phase == f"descending, step {number} of {levels[level].steps}"
        shares.append(share)

    for start in ("uniform", "rectilinear"):
        for level in (0, 1):
            look(level, start, 0)
            look(level, start, levels[level].steps)
    look(2, "uniform", 0)
    look(2, "uniform", levels[2].steps)
    assert shares == sorted(shares)
    assert (shares[0], shares[-1]) == (0.0, 1.0)
    assert shares[3] == shares[4] == pytest.approx(shares[-2] / 2)


def test_iterations_of_a_steady_rate_tell_how_many_they_will_be() -> None:
    course = IterationProgress(1e-8, 100)
    told = [course.look(iteration(number, math.nan if number == 0 else 10.0**-number)) for number in range(9)]
    assert [share for share, _ in told[:4]] == [None] * 4
    assert told[4:8] == [(number / 8, f"iteration {number} of about 8") for number in range(4, 8)]
    assert told[8] == (1.0, "iteration 8")


def test_changes_that_do_not_fall_have_no_share() -> None:
    course = IterationProgress(1e-8, 100)
    for number in range(1, 8):
        assert course.look(iteration(number, 0.1)) == (None, f"iteration {number}")


def test_a_number_of_iterations_that_jumps_is_not_told() -> None:
    course = IterationProgress(1e-8, 100)
    changes = [math.nan, 1e-1, 1e-2, 1e-3, 1e-4, 0.9e-4, 0.85e-4]
    shares = [course.look(iteration(number, change))[0] for number, change in enumerate(changes)]
    assert shares[4] == 0.5
    assert shares[5] is None


def test_a_slow_iteration_is_measured_by_its_limit() -> None:
    course = IterationProgress(1e-8, 20)
    told = [course.look(iteration(number, 0.99**number)) for number in range(1, 6)]
    assert told[-1] == (0.25, "iteration 5 of at most 20")


def test_without_a_tolerance_the_number_of_iterations_is_known() -> None:
    assert IterationProgress(None, 20).look(iteration(5, 0.1)) == (0.25, "iteration 5 of 20")
