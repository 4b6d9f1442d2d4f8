"""Copies of iterates: the newest one that is known as a whole is found, wherever its windows are."""

from __future__ import annotations

import numpy as np

import equimesh as em
from equimesh_cluster.messages import Channel, ThreadChannels
from equimesh_cluster.parts.checkpoints import Checkpoints, keep, resumed
from equimesh_cluster.parts.holding import OnChannel

STRIPS = em.Decomposition(grid=em.Grid(n_xi=20, n_eta=6), subdomains=(5, 1), overlap=2)


def mesh(iteration: int) -> em.Mesh:
    uniform = em.Mesh.uniform(STRIPS.grid)
    return em.Mesh(uniform.x + iteration, uniform.y - iteration)


def kept_by(parts: int, iterations: int) -> list[Checkpoints]:
    def work(channel: Channel) -> Checkpoints:
        holding, kept = OnChannel(channel, STRIPS), Checkpoints()
        for iteration in range(1, iterations + 1):
            keep(holding, kept, iteration, holding.cut(mesh(iteration)))
        return kept

    return ThreadChannels(parts).run(work)


def found(kept: list[Checkpoints], most: int = 99) -> int | None:
    """The iteration that is found; every part gets its windows of it."""

    def work(channel: Channel) -> int | None:
        holding = OnChannel(channel, STRIPS)
        here = resumed(holding, kept[channel.number], most)
        if here is None:
            return None
        expected = holding.cut(mesh(here[0]))
        assert np.array_equal(here[1].x, expected.x)
        assert np.array_equal(here[1].y, expected.y)
        return here[0]

    results = ThreadChannels(len(kept)).run(work)
    assert len(set(results)) == 1
    return results[0]


def test_two_iterates_are_kept_here_and_at_the_partner() -> None:
    kept = kept_by(4, 3)
    assert {iteration for iteration, _ in kept[0].known} == {2, 3}
    assert {k for _, k in kept[0].known} == {0, 1, 3}, "its own two, and the one of the part two further"


def test_any_part_may_be_lost() -> None:
    for lost in range(4):
        kept = [one for number, one in enumerate(kept_by(4, 3)) if number != lost]
        assert found(kept) == 3
        assert found(kept, most=2) == 2
        assert found(kept, most=1) is None


def test_partners_that_are_both_lost_take_their_windows_with_them() -> None:
    kept = kept_by(4, 3)
    assert found([kept[0], kept[1]]) == 3
    assert found([kept[0], kept[2]]) is None
    assert found([Checkpoints(), Checkpoints()]) is None


def test_an_iterate_that_not_all_have_kept_is_left_for_the_one_before() -> None:
    kept = kept_by(2, 3)
    kept[0].put(4, 0, [np.zeros((2, 2)), np.zeros((2, 2))])
    assert found(kept) == 3
