"""Parts of one computation that run at the same time, and what they hand to each other.

The parts are threads here. They share all arrays, so that a part reads the rows of its neighbours where they are. A
part must not write rows that another one reads in the same call of :meth:`Communicator.each`.
"""

from collections.abc import Callable
from typing import TypeVar

import numpy as np

from equimesh.numerics.threads import run_on_threads

T = TypeVar("T")


class Communicator:
    """``size`` parts, each on its own thread."""

    def __init__(self, size: int) -> None:
        self.size = size

    def each(self, work: Callable[[int], T]) -> list[T]:
        """The results of ``work(k)`` for every part k, in their order, when all parts are done."""
        if self.size == 1:
            return [work(0)]
        results: dict[int, T] = {}
        run_on_threads(self.size, lambda k: results.update({k: work(k)}))
        return [results[k] for k in range(self.size)]

    def largest(self, work: Callable[[int], float]) -> float:
        """The largest of the numbers of all parts; NaN where one of them is NaN."""
        return work(0) if self.size == 1 else float(np.max(self.each(work)))

    def smallest(self, work: Callable[[int], float]) -> float:
        """The smallest of the numbers of all parts; NaN where one of them is NaN."""
        return work(0) if self.size == 1 else float(np.min(self.each(work)))
