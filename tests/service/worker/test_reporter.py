"""Progress is reported rarely, never falls, and ends the work of a lost attempt."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import pytest

import equimesh
from equimesh_cluster.solving import Progress
from equimesh_service.errors import AttemptLostError
from equimesh_service.worker.reporter import Reporter

U = equimesh.Expression("(1-exp(15*(x-1)))*sin(pi*y)")
PROBLEM = equimesh.Problem(monitor=equimesh.ArcLength(u=U), grid=equimesh.Grid(n_xi=12, n_eta=12))


def told_by(schwarz: equimesh.Schwarz | None, interval: float) -> list[Mapping[str, Any]]:
    told: list[Mapping[str, Any]] = []

    def tell(row: Mapping[str, Any]) -> bool:
        told.append(row)
        return True

    reporter = Reporter(schwarz, tell, interval=interval)
    equimesh.solve(PROBLEM, schwarz, observe=reporter, check=False)
    reporter.writing()
    reporter.measuring()
    return told


@pytest.mark.parametrize(
    "schwarz",
    [
        None,
        equimesh.Schwarz(overlap=2),
        equimesh.Schwarz(overlap=2, tolerance="discretization"),
        equimesh.Schwarz(overlap=2, tolerance=None, max_iterations=3),
    ],
)
def test_the_fraction_grows_to_nearly_one(schwarz: equimesh.Schwarz | None) -> None:
    told = told_by(schwarz, interval=0.0)
    fractions = [row["fraction"] for row in told if row["fraction"] is not None]
    assert fractions == sorted(fractions)
    assert 0.0 <= fractions[0] < fractions[-1] == 0.9
    assert [row["phase"] for row in told[-2:]] == ["writing the files", "measuring the quality"]
    stages = list(dict.fromkeys(row["stage"] for row in told))
    assert stages == (
        ["single_domain", "writing", "measuring"] if schwarz is None else ["start", "schwarz", "writing", "measuring"]
    )


def test_sweeps_of_parts_tell_their_level_and_the_number_of_parts() -> None:
    told: list[Mapping[str, Any]] = []
    reporter = Reporter(None, lambda row: told.append(row) is None, interval=0.0)
    for level, step in itertools.product((2, 3), (1, 2, 9)):
        grid = equimesh.Grid(n_xi=2**level + 1, n_eta=9)
        share, phase = (level + step / 10) / 4, f"sweeping the {grid} grid in 3 parts"
        reporter.part(
            Progress(level=level, levels=4, grid=grid, step=step, residual=0.5, parts=3, fraction=share, phase=phase)
        )
    reporter.writing()
    assert {(row["stage"], row["parts"]) for row in told[:-1]} == {("parts", 3)}
    assert (told[0]["level"], told[0]["levels"], told[0]["grid"], told[0]["iteration"]) == (2, 4, [5, 9], 1)
    assert told[0]["phase"] == "sweeping the 5 x 9 grid in 3 parts"
    assert [row["fraction"] for row in told] == [0.42, 0.44, 0.58, 0.62, 0.64, 0.78, 0.8]


def test_a_descent_tells_its_grid_its_error_and_its_gain() -> None:
    told: list[Mapping[str, Any]] = []
    reporter = Reporter(None, lambda row: told.append(row) is None, interval=0.0)
    problem = equimesh.Problem(monitor=equimesh.LeastError(u=U), grid=equimesh.Grid(n_xi=17, n_eta=17))
    solution = equimesh.solve(problem, observe=reporter, threads=1)
    reporter.writing()
    assert len(told) == len(solution.descent) + 1
    assert {row["stage"] for row in told[:-1]} == {"least_error"}
    fractions = [row["fraction"] for row in told]
    assert fractions == sorted(fractions)
    assert 0.0 <= fractions[0] < fractions[-1] == 0.8
    for row, record in zip(told, solution.descent, strict=False):
        assert row["residual"] is None
        assert row["phase"].startswith("descending, step ") or row["phase"] == "writing the files"
        assert (row["iteration"], row["grid"], row["level"]) == (record["step"], record["grid"], record["level"])
        assert (row["error"], row["gain"]) == (record["error"], record["gain"])


def test_a_report_without_a_share_has_no_fraction_and_later_ones_do_not_fall() -> None:
    told: list[Mapping[str, Any]] = []
    reporter = Reporter(None, lambda row: told.append(row) is None, interval=0.0)
    step = equimesh.Step(
        level=0, levels=1, grid=PROBLEM.grid, step=1, residual=0.5, mesh=equimesh.Mesh.uniform(PROBLEM.grid)
    )
    for fraction, phase in ((0.5, "sweeping"), (None, "relaxing, step 1"), (0.25, "sweeping")):
        reporter(replace(step, fraction=fraction, phase=phase))
    assert [row["fraction"] for row in told] == [0.4, None, 0.4]
    assert told[1]["phase"] == "relaxing, step 1"


def test_nothing_is_told_of_a_solve_that_is_over_in_no_time() -> None:
    assert told_by(equimesh.Schwarz(overlap=2), interval=3600.0) == []


def test_little_is_told_in_little_time(monkeypatch: pytest.MonkeyPatch) -> None:
    ticks = itertools.count()
    # A second goes by between two looks. The clock of the reporter alone: event loops of other tests read the real one.
    monkeypatch.setattr("equimesh_service.worker.reporter.monotonic", lambda: float(next(ticks)))
    schwarz = equimesh.Schwarz(overlap=2, tolerance=None, max_iterations=20)
    every, some = told_by(schwarz, interval=1.0), told_by(schwarz, interval=4.0)
    assert 2 < len(some) <= len(every) * 0.6
    assert some[-1]["stage"] == "measuring"


def test_a_lost_attempt_ends_the_solve() -> None:
    reporter = Reporter(None, lambda _: False, interval=0.0)
    with pytest.raises(AttemptLostError):
        equimesh.solve(PROBLEM, observe=reporter)
