"""How far a solve is, from the records of its steps."""

import math

import pytest

import equimesh as em
from equimesh.least_error.nest import nested_levels
from equimesh.single_domain.continuation import Relaxation
from equimesh.solving.status import DescentProgress, IterationProgress, SweepProgress, approach, level_share

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
