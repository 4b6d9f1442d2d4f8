"""One record for each sweep, from the records of all parts."""

from __future__ import annotations

from equimesh import Grid
from equimesh_cluster.messages import Traffic
from equimesh_cluster.parts.part_solution import PartStep
from equimesh_cluster.solving import PartsProgress, Progress


def record(step: int, sent: int) -> PartStep:
    return PartStep(
        level=1,
        levels=2,
        grid=Grid(n_xi=9, n_eta=9),
        step=step,
        residual=0.5,
        algebraic_error=0.0,
        discretization_error=0.0,
        contraction=0.1,
        converged=False,
        traffic={"halo": Traffic(1, sent), "sums": Traffic(2, 10)},
    )


def test_a_step_is_told_once_all_parts_have_sent_theirs() -> None:
    seen: list[Progress] = []
    gathering = PartsProgress(seen.append)
    gathering.begin(2)
    gathering.add(1, record(0, 100))
    gathering.add(1, record(1, 100))
    assert seen == []
    gathering.add(0, record(0, 200))
    assert [(one.step, one.parts, one.messages, one.bytes, one.attempt) for one in seen] == [(0, 2, 6, 320, 1)]
    gathering.begin(1)  # what the first attempt left is forgotten
    gathering.add(0, record(0, 5))
    assert [(one.step, one.parts, one.messages, one.bytes, one.attempt) for one in seen[1:]] == [(0, 1, 3, 15, 2)]
    assert (seen[0].level, seen[0].levels, seen[0].grid, seen[0].residual) == (1, 2, Grid(n_xi=9, n_eta=9), 0.5)


def test_without_an_observer_nothing_is_told() -> None:
    gathering = PartsProgress(None)
    gathering.begin(1)
    gathering.add(0, record(0, 1))
