"""Every solve tells its observer how far it is, and what it does."""

from __future__ import annotations

from typing import Any

import pytest

import equimesh as em
from equimesh.solving.status import Announcer, SweepProgress

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


def test_the_comparison_of_monitors_is_told() -> None:
    told = told_by(em.Problem(monitor=em.Auto(u=U), grid=GRID))
    first = [event.phase.split(":")[0] for event in told if event.phase.startswith("comparing")]
    assert list(dict.fromkeys(first)) == [f"comparing monitors, {number} of 3" for number in (1, 2, 3)]


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
    assert whole is not None
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
