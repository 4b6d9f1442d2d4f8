"""Sums along the xi-lines: the same for any number of parts, to the last bit, with few messages."""

from __future__ import annotations

import numpy as np
import pytest

from equimesh.meshes.parts import Parts
from equimesh.numerics.channel import Channel, Counted, ThreadChannels, Traffic
from equimesh.sweeps.kernels import Lines
from equimesh.sweeps.line_sums import LineSums

SHAPE = (1030, 2100)  # 65 strips
STRIPS = np.random.default_rng(7).random((65, SHAPE[1]))
FIRST, LEFT, RIGHT = np.random.default_rng(8).random((3, SHAPE[1]))
ENDS = SHAPE[0] - 1
NONE = np.zeros((2, SHAPE[1]))


def solved(channel: Channel) -> tuple[LineSums, float, dict[str, Traffic]]:
    counted = Counted(channel)
    parts = Parts.of(SHAPE, 1, counted)
    sums = LineSums(parts, ENDS)
    sums.strips[:] = STRIPS[parts.own.strips.start : parts.own.strips.stop]
    if channel.number == 0:
        sums.first[:], sums.pushes[0] = FIRST, LEFT
    if channel.number == channel.count - 1:
        sums.pushes[1] = RIGHT
    found = sums.solve(Lines(0, ENDS, NONE, (0.0, 0.0), NONE))
    return sums, found, counted.taken()


def test_the_lines_are_those_of_sums_in_order() -> None:
    ((sums, deviation, _),) = ThreadChannels(1).run(solved)
    inner = slice(1, -1)
    total = FIRST + STRIPS.sum(axis=0)
    rows = np.array([last - first for first, last in Parts.of(SHAPE).strips])
    assert rows.sum() + 1 == ENDS
    mean, shift = total / ENDS, (RIGHT - LEFT) / ENDS
    assert sums.levels.mean[inner] == pytest.approx(mean[inner], rel=1e-13)
    assert sums.levels.shift[inner] == pytest.approx(shift[inner], rel=1e-13)
    start = LEFT + FIRST - mean + shift
    for k in range(65):
        expected = start + STRIPS[:k].sum(axis=0) + rows[:k].sum() * (shift - mean)
        assert sums.starts[k][inner] == pytest.approx(expected[inner], rel=1e-11, abs=1e-11)
    assert deviation == pytest.approx((abs(FIRST - mean) / mean)[inner].max(), rel=1e-13)


@pytest.mark.parametrize("count", [2, 3, 4, 5, 6, 7, 8, 16])
def test_parts_find_the_same_to_the_last_bit(count: int) -> None:
    ((whole, deviation, _),) = ThreadChannels(1).run(solved)
    found = ThreadChannels(count).run(solved)
    starts = np.concatenate([sums.starts for sums, _, _ in found])
    assert np.array_equal(starts[:, 1:-1], whole.starts[:, 1:-1])
    for sums, _, _ in found:
        assert all(np.array_equal(one, other) for one, other in zip(sums.levels, whole.levels, strict=True))
    assert [own for _, own, _ in found] == [deviation] + (count - 1) * [0.0]


@pytest.mark.parametrize("count", [2, 4, 8, 16])
def test_sums_go_up_and_starts_down_once_for_every_cut(count: int) -> None:
    sent = [traffic for _, _, traffic in ThreadChannels(count).run(solved)]
    row = 8 * SHAPE[1]
    totals = {tag: [sum(one[tag].bytes for one in sent if tag in one)] for tag in ("sums", "starts", "push")}
    assert totals == {"sums": [row * (count - 1)], "starts": [3 * row * (count - 1)], "push": [row]}
    most = max(sum(traffic.messages for traffic in one.values()) for one in sent)
    assert most <= count.bit_length() + 1, "the logarithm of the number of parts"


def test_a_line_that_is_not_a_number_is_no_convergence() -> None:
    sums = LineSums(Parts.of(SHAPE), ENDS)
    sums.strips[:] = STRIPS
    sums.strips[40, 77] = np.nan
    sums.first[:] = FIRST
    assert sums.solve(Lines(0, ENDS, NONE, (0.0, 0.0), NONE)) == np.inf
