"""Messages between parts."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
import pytest

from equimesh_cluster.messages import (
    ALONE,
    TAG,
    Channel,
    Counted,
    PeerFailedError,
    PeerLostError,
    ThreadChannels,
    Traffic,
    gathered,
    joined,
    summed,
)


def test_messages_arrive_in_order_and_by_tag() -> None:
    def work(channel: Channel) -> list[float]:
        if channel.number == 0:
            for k in range(3):
                channel.send(1, "sums", [np.full(2, float(k))])
            channel.send(1, "halo", [np.full(1, 7.0), np.full(1, 8.0)])
            return []
        halo = channel.receive(0, "halo")
        return [*(float(array[0]) for array in halo), *(float(channel.receive(0, "sums")[0][1]) for _ in range(3))]

    assert ThreadChannels(2).run(work)[1] == [7.0, 8.0, 0.0, 1.0, 2.0]


def test_a_message_is_a_copy() -> None:
    changed = threading.Event()

    def work(channel: Channel) -> float:
        if channel.number == 1:
            assert changed.wait(timeout=60)
            return float(channel.receive(0, "row")[0][0])
        row = np.zeros(4)
        channel.send(1, "row", [row[::2]])
        row[:] = 5.0
        changed.set()
        return 0.0

    assert ThreadChannels(2).run(work) == [0.0, 0.0]


def test_the_error_of_a_part_reaches_the_caller_and_its_peers() -> None:
    seen: list[BaseException] = []

    def work(channel: Channel) -> None:
        if channel.number == 2:
            raise ValueError("u is not finite")
        try:
            channel.receive((channel.number + 1) % 3, "never sent")
        except PeerFailedError as error:
            seen.append(error)
            raise

    with pytest.raises(ValueError, match="u is not finite"):
        ThreadChannels(3).run(work)
    assert [str(error) for error in seen] == 2 * ["part 2 failed: u is not finite"]


def test_who_waits_for_a_part_that_has_ended_is_told() -> None:
    def work(channel: Channel) -> Any:
        return channel.receive(0, "sums") if channel.number else None

    with pytest.raises(PeerLostError, match="part 0 ended without sending 'sums'"):
        ThreadChannels(2).run(work)


def test_messages_and_bytes_are_counted_by_tag() -> None:
    def work(channel: Channel) -> list[dict[str, Traffic]]:
        counted = Counted(channel)
        if channel.number == 1:
            for tag in ("halo", "halo", "sums", "halo"):
                counted.receive(0, tag)
            return []
        counted.send(1, "halo", [np.zeros((2, 5)), np.zeros(5)])
        counted.send(1, "halo", [np.zeros(3)])
        counted.send(1, "sums", [np.zeros(1)])
        first = counted.taken()
        counted.send(1, "halo", [np.zeros(2)])
        return [first, counted.taken(), counted.taken()]

    (found, _) = ThreadChannels(2).run(work)
    assert found == [{"halo": Traffic(2, 144), "sums": Traffic(1, 8)}, {"halo": Traffic(1, 16)}, {}]


def test_a_part_sends_to_others_only() -> None:
    for to in (-1, 0, 2):
        with pytest.raises(ValueError, match=f"part 0 of 2 cannot send to part {to}"):
            ThreadChannels(2).channels[0].send(to, "row", [np.zeros(1)])
    with pytest.raises(AssertionError, match="sends nothing"):
        ALONE.send(1, "row", [np.zeros(1)])
    with pytest.raises(AssertionError, match="receives nothing"):
        ALONE.receive(0, "row")
    assert (ALONE.number, ALONE.count) == (0, 1)


# What parts tell all others: the same for each of them, in few messages.


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
