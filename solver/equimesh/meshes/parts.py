"""The rows of a grid, cut into strips, and the strips shared out among parts that run at the same time.

A strip is a block of rows whose intermediate arrays stay in the cache. Strips depend on the grid alone. A part has
consecutive strips. Where a sum runs over all rows, each strip gives its own sum, and these are added in the order of
the strips. So no result depends on the number of parts, to the last bit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeVar

from equimesh.numerics.communicator import Communicator

T = TypeVar("T")

# Nodes of a strip of rows: its intermediate arrays stay in the cache.
STRIP_NODES = 32_768
# Rows of a strip, at least: each strip also reads one row beyond either end.
MIN_STRIP_ROWS = 16
# Fewer nodes are not worth a second thread.
MIN_SHARED_NODES = 16_384


@dataclass(frozen=True)
class Part:
    """The node rows ``first`` to ``last - 1``, and the numbers of the ``strips`` inside.

    Every row of the grid belongs to one part. The first and the last row of the grid are in no strip.
    """

    first: int
    last: int
    strips: range

    @property
    def ends(self) -> tuple[int, int]:
        """The first row, and the one after the last."""
        return self.first, self.last

    @property
    def rows(self) -> slice:
        """The rows of the part."""
        return slice(self.first, self.last)

    @property
    def rows_and_next(self) -> slice:
        """The rows of the part and the first one of the next part: those of the cells that begin in the part."""
        return slice(self.first, self.last + 1)


@dataclass(frozen=True)
class Parts:
    """All rows of a grid of ``shape`` points.

    ``strips`` are the first row and the row after the last one of each strip.
    """

    shape: tuple[int, ...]
    strips: tuple[tuple[int, int], ...]
    parts: tuple[Part, ...]
    communicator: Communicator

    @classmethod
    def of(cls, shape: tuple[int, ...], threads: int = 1) -> Parts:
        """A part for each of ``threads`` threads, or fewer where the grid is too small to be shared."""
        return _cut(shape, threads if shape[0] * shape[1] >= MIN_SHARED_NODES else 1)

    @property
    def is_whole(self) -> bool:
        """Whether there is only one part, the whole grid."""
        return len(self.parts) == 1

    def each(self, work: Callable[[Part], T]) -> list[T]:
        """The results of ``work`` for every part, in the order of the rows."""
        return self.communicator.each(lambda k: work(self.parts[k]))

    def largest(self, work: Callable[[Part], float]) -> float:
        """The largest number of a part; NaN where one of them is NaN."""
        return self.communicator.largest(lambda k: work(self.parts[k]))

    def smallest(self, work: Callable[[Part], float]) -> float:
        """The smallest number of a part; NaN where one of them is NaN."""
        return self.communicator.smallest(lambda k: work(self.parts[k]))


@lru_cache(maxsize=256)
def _cut(shape: tuple[int, ...], most: int) -> Parts:
    rows, columns = shape
    height = max(MIN_STRIP_ROWS, -(-STRIP_NODES // columns))
    strips = tuple((first, min(first + height, rows - 1)) for first in range(1, rows - 1, height))
    count = max(1, min(most, len(strips)))
    ends = [k * len(strips) // count for k in range(count + 1)]
    firsts = [0, *(strips[end][0] for end in ends[1:-1]), rows]
    parts = tuple(Part(firsts[k], firsts[k + 1], range(ends[k], ends[k + 1])) for k in range(count))
    return Parts(shape, strips, parts, Communicator(count))
