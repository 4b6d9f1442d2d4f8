"""Which cells to look at more closely, chosen among those of all processes.

Numbers are compared by their bits, and only whole numbers are added. So the choice does not depend on how the cells
are shared out.
"""

import numpy as np

from equimesh.meshes.mesh_window import WindowRows
from equimesh.numerics.channel import Channel
from equimesh.numerics.gather import joined, summed
from equimesh.numerics.types import Array, BoolArray, IntArray

MIX = (0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB)
"""Factors that mix the bits of a number: G. L. Steele, D. Lea, C. H. Flood, *Fast splittable pseudorandom number
generators* (OOPSLA 2014)."""
DIGIT_BITS = 8
"""Bits of a number that are compared at a time."""
MAX_SENT = 4096
"""So many values of all processes are sent to all and compared as they are; by one process, any number."""
COARSE_BITS = 47
"""Bits that a rough comparison leaves out: the last of the 52 that are stored of a number's digits."""


def largest_of(values: Array, count: int, rows: WindowRows) -> IntArray:
    """The places of those of the ``count`` largest ``values`` of all processes that are here; increasing.

    Of equal values the first ones are taken. NaN counts as larger than any number. No value is negative.
    """
    keys = np.abs(values).view(np.uint64)
    chosen, candidates, left = np.zeros(values.size, dtype=np.bool_), np.arange(values.size), count
    of_all = int(summed(rows.channel, np.array([float(values.size)]))[0])
    most, shift = MAX_SENT if rows.channel.count > 1 else of_all, 64
    while of_all > most and shift > 0:
        shift -= DIGIT_BITS
        digits = ((keys[candidates] >> np.uint64(shift)) & np.uint64((1 << DIGIT_BITS) - 1)).astype(np.int64)
        found = summed(rows.channel, np.bincount(digits, minlength=1 << DIGIT_BITS).astype(float))
        at_least = np.append(np.cumsum(found[::-1])[::-1], 0.0)
        last = int(np.flatnonzero(at_least >= left)[-1])  # the digit of the smallest value that is taken
        chosen[candidates[digits > last]] = True
        left, of_all = left - int(at_least[last + 1]), int(found[last])
        candidates = candidates[digits == last]
    if of_all <= most:
        sent = joined(rows.channel, keys[candidates].view(np.float64)).view(np.uint64)
        smallest = np.partition(sent, of_all - left)[of_all - left]
        chosen[candidates[keys[candidates] > smallest]] = True
        left -= int(np.count_nonzero(sent > smallest))
        candidates = candidates[keys[candidates] == smallest]
    parts = joined(rows.channel, np.array([[float(rows.first), float(candidates.size)]]))
    before = int(parts[parts[:, 0] < rows.first, 1].sum())
    chosen[candidates[: max(0, left - before)]] = True
    return np.flatnonzero(chosen)


def all_but_the_smallest(values: Array, allowed: float, channel: Channel) -> BoolArray:
    """Which ``values`` are left when the smallest of all processes are taken away, of a sum of about ``allowed``.

    Values that differ by 3 % or less may count as equal. NaN is taken away. No value is negative.
    """
    keys = (np.abs(values).view(np.uint64) >> np.uint64(COARSE_BITS)).astype(np.int64)
    found, counts = np.unique(keys, return_counts=True)
    every = joined(channel, np.column_stack([found, counts]).astype(float))
    kinds, where = np.unique(every[:, 0].astype(np.uint64), return_inverse=True)
    middles = ((kinds << np.uint64(COARSE_BITS)) + np.uint64(1 << (COARSE_BITS - 1))).view(np.float64)
    middles[kinds == 0], middles[np.isnan(middles)] = 0.0, np.inf  # zeros, and those beyond the largest number
    sums = np.cumsum(middles * np.bincount(where, every[:, 1], kinds.size))
    too_many = kinds[sums > allowed]
    first = int(too_many[0]) if too_many.size else np.iinfo(np.int64).max
    return np.asarray((keys >= first) & ~np.isnan(values))


def scattered(numbers: IntArray, one_of: int) -> BoolArray:
    """Which cells belong to a sample of one in ``one_of``: one of each run of consecutive numbers, at any place of it.

    A lattice could meet the same rows of all blocks; the places are mixed instead, and are the same each time.
    """
    runs, places = np.divmod(numbers, one_of)
    with np.errstate(over="ignore"):
        mixed = (runs.astype(np.uint64) + np.uint64(1)) * np.uint64(MIX[0])
        mixed = (mixed ^ (mixed >> np.uint64(30))) * np.uint64(MIX[1])
        mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(MIX[2])
    return np.asarray((mixed ^ (mixed >> np.uint64(31))) % np.uint64(one_of) == places.astype(np.uint64))
