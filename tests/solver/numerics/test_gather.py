"""What parts tell all others: the same for each of them, in few messages."""

from __future__ import annotations

import numpy as np
import pytest

from equimesh.numerics.channel import ALONE, TAG, Channel, Counted, ThreadChannels, gathered, joined, summed


@pytest.mark.parametrize("count", [1, 2, 3, 5, 8])
def test_all_parts_know_all_in_the_order_of_the_parts(count: int) -> None:
    def work(channel: Channel) -> tuple[np.ndarray, np.ndarray, int]:
        counted = Counted(channel)
        rows = joined(counted, np.full((channel.number, 2), float(channel.number)))
        total = summed(counted, np.array([1.0, 10.0**channel.number]))
        return rows, total, counted.sent[TAG].messages

    expected = np.repeat(np.arange(count, dtype=float), np.arange(count))
    for rows, total, messages in ThreadChannels(count).run(work):
        assert np.array_equal(rows, np.column_stack([expected, expected]))
        assert total.tolist() == [count, float("1" * count)]
        assert messages == 2 * (count - 1).bit_length()


def test_one_part_sends_nothing_and_keeps_its_array() -> None:
    array = np.arange(3.0)
    assert gathered(ALONE, array) == [array]
    assert joined(ALONE, array) is array
    assert summed(ALONE, array) is array
