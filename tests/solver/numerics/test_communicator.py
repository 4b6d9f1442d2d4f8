"""Parts that run at the same time and hand their results to each other."""

from __future__ import annotations

import math
import threading

import pytest

from equimesh.numerics.channel import Communicator


@pytest.mark.parametrize("size", [1, 2, 5])
def test_results_come_in_the_order_of_the_parts(size: int) -> None:
    """Although the last part is the first to end: each waits for the one after it."""
    done = [threading.Event() for _ in range(size + 1)]
    done[size].set()

    def work(k: int) -> tuple[int, int]:
        assert done[k + 1].wait(timeout=60)
        done[k].set()
        return k, threading.get_ident()

    found = Communicator(size).each(work)
    assert [k for k, _ in found] == list(range(size))
    assert len({thread for _, thread in found}) == size, "every part has its own thread"


def test_parts_agree_on_extremes() -> None:
    parts, numbers = Communicator(3), (2.0, -1.0, 5.0)
    assert parts.largest(numbers.__getitem__) == 5.0
    assert parts.smallest(numbers.__getitem__) == -1.0


@pytest.mark.parametrize("bad", range(3))
def test_what_is_not_a_number_is_not_overlooked(bad: int) -> None:
    def work(k: int) -> float:
        return math.nan if k == bad else float(k)

    assert math.isnan(Communicator(3).largest(work))
    assert math.isnan(Communicator(3).smallest(work))


@pytest.mark.parametrize("bad", range(2))
def test_the_error_of_a_part_reaches_the_caller(bad: int) -> None:
    def work(k: int) -> int:
        if k == bad:
            raise ValueError(f"part {k}")
        return k

    with pytest.raises(ValueError, match=f"part {bad}"):
        Communicator(2).each(work)
