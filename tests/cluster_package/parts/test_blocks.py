"""Blocks in parts: the solution of one process, bit for bit, with its records, also where weights are chosen."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.numerics.channel import Channel, ThreadChannels
from equimesh.solving.announcer import Event
from equimesh.testing.geometries import obstacle
from equimesh_cluster.parts.schwarz import BlocksResult, plain, solve_part_of_blocks

FRONT = em.Expression("tanh(12*((x + 0.2)**2 + (y - 0.1)**2 - 0.5))")
DOMAIN = obstacle(1200)
SETTINGS = em.BlockSchwarz(groups=[[0, 1, 2], [3], [4, 5], [6, 7]])


MONITORS = {
    "given": em.LeastError(u=FRONT, smoothness=0.3),
    "chosen": em.Auto(u=FRONT),
    "bounded": em.LeastError(u=FRONT, orthogonality=50.0),
}


@pytest.mark.parametrize("monitor", MONITORS.values(), ids=MONITORS)
def test_the_solution_is_that_of_one_process(monitor: em.LeastError | em.Auto) -> None:
    problem = em.BlockProblem(monitor=monitor, domain=DOMAIN)
    alone = em.solve(problem, SETTINGS, threads=1)
    events: list[Event] = []

    def work(channel: Channel) -> BlocksResult | None:
        observe = events.append if channel.number == 0 else None
        return solve_part_of_blocks(channel, problem, SETTINGS, observe=observe)

    found, *others = ThreadChannels(3).run(work)
    assert others == [None, None]
    assert found is not None
    solution = found.solution(problem)
    assert np.array_equal(solution.mesh.points, alone.mesh.points)
    assert solution.descent == alone.descent
    assert solution.comparison == alone.comparison
    assert solution.schwarz == SETTINGS
    told = [plain(event) for event in events if isinstance(event, em.Descent)]
    assert told[-1]["points"] == DOMAIN.points
    assert 0.0 < (told[-1]["fraction"] or 1.0) <= 1.0
    assert "mesh" not in told[-1]


def test_an_error_of_the_leader_ends_the_parts_that_follow() -> None:
    problem = em.BlockProblem(monitor=em.LeastError(u=FRONT), domain=DOMAIN)

    def fail(_: Event) -> None:
        raise RuntimeError("the observer is tired")

    def work(channel: Channel) -> BlocksResult | None:
        return solve_part_of_blocks(channel, problem, SETTINGS, observe=fail if channel.number == 0 else None)

    with pytest.raises(RuntimeError, match="tired"):
        ThreadChannels(2).run(work)
