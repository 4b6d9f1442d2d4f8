"""Parts of one computation that run at the same time, and what they agree on.

The parts are the threads of this process, and other processes behind a channel. Threads share all arrays, so that a
part reads the rows of its neighbours where they are. A part must not write rows that another one reads in the same call
of :meth:`Communicator.each`. Processes share nothing; each of them makes the same calls in the same order.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np

from equimesh.numerics.channel import ALONE, Channel
from equimesh.numerics.threads import run_on_threads
from equimesh.numerics.types import Array

T = TypeVar("T")


class Communicator:
    """``size`` parts, each on its own thread, and the other processes of ``channel``."""

    def __init__(self, size: int, channel: Channel = ALONE) -> None:
        self.size, self.channel = size, channel

    def each(self, work: Callable[[int], T]) -> list[T]:
        """The results of ``work(k)`` for every part k of this process, in their order, when all parts are done."""
        if self.size == 1:
            return [work(0)]
        results: dict[int, T] = {}
        run_on_threads(self.size, lambda k: results.update({k: work(k)}))
        return [results[k] for k in range(self.size)]

    def largest(self, work: Callable[[int], float]) -> float:
        """The largest of the numbers of all parts, of all processes; NaN where one of them is NaN."""
        found = work(0) if self.size == 1 else float(np.max(self.each(work)))
        return found if self.channel.count == 1 else agree(self.channel, found)[0]

    def smallest(self, work: Callable[[int], float]) -> float:
        """The smallest of the numbers of all parts, of all processes; NaN where one of them is NaN."""
        found = work(0) if self.size == 1 else float(np.min(self.each(work)))
        return found if self.channel.count == 1 else -agree(self.channel, -found)[0]


def agree(channel: Channel, *numbers: float) -> tuple[float, ...]:
    """The largest of each of the numbers over all processes, the same for all; NaN where one of them is NaN.

    In round r every process tells the one 2^r further what it knows so far. After the logarithm of their number, all
    know all.
    """
    known, step = np.array(numbers, dtype=np.float64), 1
    while step < channel.count:
        channel.send((channel.number + step) % channel.count, "agree", [known])
        (others,) = channel.receive((channel.number - step) % channel.count, "agree")
        known, step = np.maximum(known, others), 2 * step
    return tuple(known.tolist())


def gather(channel: Channel, tag: str, arrays: Sequence[Array]) -> list[list[Array]]:
    """The arrays of every process, in the order of the processes, the same for all.

    Every process sends to the one 2^r further what it has so far, without what that one has already.
    """
    number, count = channel.number, channel.count
    known, step = [list(arrays)], 1  # those of this process, of the one before it, and so on around
    while step < count:
        new = known[: count - step]
        channel.send((number + step) % count, tag, [array for one in new for array in one])
        received = channel.receive((number - step) % count, tag)
        known += [list(received[k : k + len(arrays)]) for k in range(0, len(received), len(arrays))]
        step *= 2
    return [known[(number - k) % count] for k in range(count)]
