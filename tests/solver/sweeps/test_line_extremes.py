"""Sums and extremes along lines over processes: of the whole, to the last bit, in one message of each."""

from __future__ import annotations

import numpy as np
import pytest

from equimesh.numerics.channel import ALONE, Channel, Counted, ThreadChannels
from equimesh.sweeps.line_sums import TAG, line_extremes

STRIPS = np.random.default_rng(5).standard_normal((11, 3, 40))


@pytest.mark.parametrize("cuts", [[5], [1, 2], [2, 5, 8], [3, 4, 6, 9], [1, 2, 3, 4, 5, 6, 7]])
def test_processes_find_the_numbers_of_one(cuts: list[int]) -> None:
    whole = line_extremes(ALONE, STRIPS)
    assert whole is not None
    assert whole[0] == pytest.approx(STRIPS[:, 0].sum(axis=0), rel=1e-12)
    assert np.array_equal(whole[1], STRIPS[:, 1].max(axis=0))
    assert np.array_equal(whole[2], STRIPS[:, 2].min(axis=0))
    pieces = np.split(STRIPS, cuts)

    def work(channel: Channel) -> tuple[np.ndarray | None, int, int]:
        counted = Counted(channel)
        found = line_extremes(counted, pieces[channel.number])
        return found, counted.sent[TAG].messages, counted.sent[TAG].bytes

    (first, *traffic), *others = ThreadChannels(len(pieces)).run(work)
    assert np.array_equal(first, whole)
    assert traffic == [0, 0]
    for found, messages, size in others:
        assert found is None
        assert messages == 1
        assert size <= 8 * 40 * (2 + 4)


def test_one_strip_is_its_own_sum_and_a_process_without_strips_adds_nothing() -> None:
    assert np.array_equal(line_extremes(ALONE, STRIPS[:1]), STRIPS[0])
    pieces = STRIPS[:3], STRIPS[:0]
    first, _ = ThreadChannels(2).run(lambda channel: line_extremes(channel, pieces[channel.number]))
    assert np.array_equal(first, line_extremes(ALONE, STRIPS[:3]))
