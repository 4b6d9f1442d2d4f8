"""Whether the integrals of interpolation errors are resolved, and finer ones where they are not.

A rule with few points a cell misses a layer that lies between the points. A second rule, with other points, is tried on
the cells with the largest errors and on a sample of all cells. Where the two differ, the second rule takes the place
of the first, and cells are divided where it changes the result, up to a bounded cost.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

import numpy as np

from equimesh.fields.expression import Field
from equimesh.meshes.rows import Rows
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array, BoolArray, IntArray
from equimesh.quality.cell_maps import locate
from equimesh.quality.cells import CellPoints, Cells, ChosenCells
from equimesh.quality.tally import add_errors

# Pieces of cells, on which the error of interpolation is integrated more finely than on the whole cell.
#
# A part of a bilinear cell, from halving its edges, is a bilinear cell itself, and the interpolant of u is bilinear on
# it, too. So a piece is known by its corners and by the values of the interpolant there.

GAUSS_POINTS = 4
"""Gauss points per direction of a piece."""
RIM = CellPoints(
    np.array([0.0, 0.5, 1.0, 1.0, 1.0, 0.5, 0.0, 0.0]),
    np.array([0.0, 0.0, 0.0, 0.5, 1.0, 1.0, 1.0, 0.5]),
    np.full(8, 0.125),
)
"""The corners and the middles of the edges, counter-clockwise from the first corner."""
BLOCK_PIECES = 1 << 10
"""Pieces of a block: its intermediate arrays stay in the cache."""
_QUARTERS = (
    np.array([[4, 0, 0, 0], [2, 2, 0, 0], [1, 1, 1, 1], [2, 0, 0, 2]]) / 4.0,
    np.array([[2, 2, 0, 0], [0, 4, 0, 0], [0, 2, 2, 0], [1, 1, 1, 1]]) / 4.0,
    np.array([[1, 1, 1, 1], [0, 2, 2, 0], [0, 0, 4, 0], [0, 0, 2, 2]]) / 4.0,
    np.array([[2, 0, 0, 2], [1, 1, 1, 1], [0, 0, 2, 2], [0, 0, 0, 4]]) / 4.0,
)  # the corners of the four parts of a piece, as means of its own corners


@dataclass(frozen=True, eq=False)
class Pieces:
    """Bilinear pieces of cells: ``corners`` of shape ``(8, n)``, x and then y, counter-clockwise.

    ``values`` of shape ``(4, n)`` are those of the interpolant at the corners; ``u`` is that of u there if it is known,
    as on a whole cell, where both are one.
    """

    corners: Array
    values: Array
    u: Array | None = None

    @classmethod
    def of(cls, cells: Cells, numbers: IntArray, values: Array) -> Pieces:
        """Whole cells with these ``numbers``, and the ``values`` of u at their corners, of shape ``(4, n)``."""
        return cls(cells.corners(numbers), values, values)

    @property
    def count(self) -> int:
        """Number of pieces."""
        return int(self.corners.shape[1])

    def some(self, chosen: IntArray | BoolArray) -> Pieces:
        """The chosen pieces."""
        return Pieces(self.corners[:, chosen], self.values[:, chosen])

    def quarters(self) -> Pieces:
        """Four parts of every piece; part ``q`` of piece ``k`` has the number ``q * count + k``."""
        x, y = self.corners[:4], self.corners[4:]
        corners = np.concatenate([np.concatenate([part @ x, part @ y]) for part in _QUARTERS], axis=1)
        return Pieces(corners, np.concatenate([part @ self.values for part in _QUARTERS], axis=1))

    def errors(self, u: Field) -> Array:
        """Integrals over every piece, of shape ``(3, n)``.

        The first two are those of the squares of ``e = u_h - u`` and of its gradient. The third is what the gradient of
        u at the Gauss points has missed: the mean of ``grad e`` over a piece equals an integral of e over its rim, in
        which no derivative occurs. It is the squared difference of the two times the area, in the unit of the second.
        """
        result = np.empty((3, self.count))
        for start in range(0, self.count, BLOCK_PIECES):
            block = slice(start, start + BLOCK_PIECES)
            corners, values = (np.ascontiguousarray(part[:, block]) for part in (self.corners, self.values))
            found = _block_errors(u, corners, values, _ALL_POINTS if self.u is None else _UNKNOWN_POINTS)
            if self.count <= BLOCK_PIECES:
                return found
            result[:, block] = found
        return result


_INSIDE = CellPoints.gauss(GAUSS_POINTS)
_ALL_POINTS = CellPoints(*(np.concatenate(pair) for pair in zip(_INSIDE, RIM, strict=True)))
_UNKNOWN_POINTS = CellPoints(*(np.delete(part, range(_INSIDE.s.size, part.size, 2)) for part in _ALL_POINTS))
"""The points without the corners."""


def _block_errors(u: Field, corners: Array, values: Array, points: CellPoints) -> Array:
    """As :meth:`Pieces.errors`, with u at these ``points``: not at the corners where it is the interpolant there."""
    inside, n = _INSIDE.s.size, corners.shape[1]
    x, y = np.empty((2, points.s.size, n))
    locate(corners, points.s, points.t, x, y)
    there, u_x, u_y = (np.ascontiguousarray(part) for part in u.evaluate(x, y, order=1)[:3])
    sums = np.zeros((5, n))
    add_errors(corners, values, there[:inside], (u_x[:inside], u_y[:inside]), _INSIDE, sums[:4], sums[4], 0)
    replace_by_missed(corners, values, there[inside:], sums)
    return sums[:3]


@compiled
def replace_by_missed(corners: Array, values: Array, rim: Array, sums: Array) -> None:
    """Replace the third of the ``sums`` of every piece by the gradient that the rule has missed.

    That is the square of the third and the fourth one, which are those of :func:`~equimesh.quality.tally.add_errors`,
    minus the integral of ``e n`` over the rim, by the area of the piece. ``rim`` of shape ``(8, n)`` holds u at the
    points :data:`RIM`, or ``(4, n)`` in the middles alone, where e is 0 at the corners. The integral along
    an edge is by Simpson's rule.
    """
    for k in range(corners.shape[1]):
        total_x, total_y, area, first, last = sums[2, k], sums[3, k], 0.0, 0.0, 0.0
        for side in range(4):
            after, place = (side + 1) % 4, side
            dx, dy = corners[after, k] - corners[side, k], corners[4 + after, k] - corners[4 + side, k]
            if len(rim) > 4:
                place = 2 * side + 1
                first, last = values[side, k] - rim[2 * side, k], values[after, k] - rim[(2 * side + 2) % 8, k]
            middle = 0.5 * (values[side, k] + values[after, k]) - rim[place, k]
            along = (first + 4.0 * middle + last) / 6.0
            total_x -= along * dy
            total_y += along * dx
            area += 0.5 * (corners[side, k] * corners[4 + after, k] - corners[after, k] * corners[4 + side, k])
        sums[2, k] = (total_x * total_x + total_y * total_y) / area


# Which cells to look at more closely, chosen among those of the whole mesh.
#
# Numbers are compared by their bits, and only whole numbers are added. So the choice does not depend on how the cells
# are shared out.

MIX = (0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB)
"""Factors that mix the bits of a number: G. L. Steele, D. Lea, C. H. Flood, *Fast splittable pseudorandom number
generators* (OOPSLA 2014)."""
DIGIT_BITS = 8
"""Bits of a number that are compared at a time."""
MAX_SENT = 4096
"""So many values of all rows are joined and compared as they are; any number where all rows are here."""
COARSE_BITS = 47
"""Bits that a rough comparison leaves out: the last of the 52 that are stored of a number's digits."""


def largest_of(values: Array, count: int, rows: Rows) -> IntArray:
    """The places of those of the ``count`` largest ``values`` of all rows that are here; increasing.

    Of equal values the first ones are taken. NaN counts as larger than any number. No value is negative.
    """
    keys = np.abs(values).view(np.uint64)
    if rows.are_all and 0 < count < values.size:
        places = np.empty(count, dtype=np.int64)
        find_largest(keys.view(np.int64), places)
        return places
    chosen, candidates, left = np.zeros(values.size, dtype=np.bool_), np.arange(values.size), count
    of_all = int(rows.summed(np.array([float(values.size)]))[0])
    most, shift = of_all if rows.are_all else MAX_SENT, 64
    while of_all > most and shift > 0:
        shift -= DIGIT_BITS
        digits = ((keys[candidates] >> np.uint64(shift)) & np.uint64((1 << DIGIT_BITS) - 1)).astype(np.int64)
        found = rows.summed(np.bincount(digits, minlength=1 << DIGIT_BITS).astype(float))
        at_least = np.append(np.cumsum(found[::-1])[::-1], 0.0)
        last = int(np.flatnonzero(at_least >= left)[-1])  # the digit of the smallest value that is taken
        chosen[candidates[digits > last]] = True
        left, of_all = left - int(at_least[last + 1]), int(found[last])
        candidates = candidates[digits == last]
    if of_all <= most:
        sent = rows.joined(keys[candidates].view(np.float64)).view(np.uint64)
        smallest = np.partition(sent, of_all - left)[of_all - left]
        chosen[candidates[keys[candidates] > smallest]] = True
        left -= int(np.count_nonzero(sent > smallest))
        candidates = candidates[keys[candidates] == smallest]
    parts = rows.joined(np.array([[float(rows.first), float(candidates.size)]]))
    before = int(parts[parts[:, 0] < rows.first, 1].sum())
    chosen[candidates[: max(0, left - before)]] = True
    return np.flatnonzero(chosen)


@compiled
def find_largest(keys: IntArray, places: IntArray) -> None:
    """Fill ``places``, which are fewer, with those of the largest ``keys``, increasing; of equal ones the first."""
    count, heap = places.size, np.empty(places.size, np.int64)
    for k in range(keys.size):  # keys from ``here`` on that are no larger than those below them
        here, key = max(count - 1 - k, 0), keys[count - 1 - k if k < count else k]
        if k >= count and key <= heap[0]:
            continue
        below = 2 * here + 1
        while below < count:
            if below + 1 < count and heap[below + 1] < heap[below]:
                below += 1
            if heap[below] >= key:
                break
            heap[here] = heap[below]
            here, below = below, 2 * below + 1
        heap[here] = key
    smallest, left, taken = heap[0], 0, 0
    for key in heap:
        left += key == smallest
    for k in range(keys.size):
        if keys[k] > smallest or (keys[k] == smallest and left > 0):
            left -= keys[k] == smallest
            places[taken] = k
            taken += 1


def all_but_the_smallest(values: Array, allowed: float, rows: Rows) -> BoolArray:
    """Which ``values`` are left when the smallest of all rows are taken away, of a sum of about ``allowed``.

    Values that differ by 3 % or less may count as equal. NaN is taken away. No value is negative.
    """
    keys = (np.abs(values).view(np.uint64) >> np.uint64(COARSE_BITS)).astype(np.int64)
    found, counts = np.unique(keys, return_counts=True)
    every = rows.joined(np.column_stack([found, counts]).astype(float))
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
    return np.asarray(_place_of(runs, one_of) == places)


@lru_cache(maxsize=8)
def scattered_between(first: int, last: int, one_of: int, columns: int = 1) -> IntArray:
    """The cells of a sample in the rows from ``first`` to before ``last``, which have so many ``columns``.

    It is one cell of each tile of ``one_of`` cells or somewhat fewer, as many rows as columns of them, at any place of
    it. In one column they are those that are :func:`scattered`, found without a look at the others. Nobody writes into
    them: they are kept for the next mesh of the size.
    """
    width = min(one_of // math.isqrt(one_of), columns)
    height, across = one_of // width, np.arange(-(-columns // width))
    down = np.arange(first // height, -(-last // height))[:, None]
    row, column = np.divmod(_place_of(down * across.size + across, height * width), width)
    row, column = row + down * height, column + across * width
    found = (row * columns + column)[(row >= first) & (row < last) & (column < columns)]
    return np.sort(found)


def _place_of(runs: IntArray, one_of: int) -> IntArray:
    """The place of the cell of the sample in each run, or tile."""
    with np.errstate(over="ignore"):
        mixed = (runs.astype(np.uint64) + np.uint64(1)) * np.uint64(MIX[0])
        mixed = (mixed ^ (mixed >> np.uint64(30))) * np.uint64(MIX[1])
        mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(MIX[2])
    return np.asarray((mixed ^ (mixed >> np.uint64(31))) % np.uint64(one_of)).astype(np.int64)


MAX_DIFFERENCES = (0.1, 0.02)
"""Largest differences of two integrals of squared errors, as shares of them: 5 % of the L2 norm, 1 % of the H1 norm.

A descent moves nodes until the gradient of u changes where its own rule has no points. Rules that are nearly as coarse
then agree to a few percent, and both miss a third of the error.
"""
MISSED_WEIGHT = 10.0
"""How much more the gradient that a rule missed counts than its square.

It is the square of a mean over a cell, and the mean of the squares is larger: that of a layer much larger.
"""
MAX_LEFT_DIFFERENCE = 0.02
"""Largest change of the integrals by the last division of cells, as a share of them, if the cost allows it."""
CHECKED = 37
"""The second rule is tried on one cell of this many, and on as many cells with the largest errors."""
CHECKED_SHIFT = 11
"""The shift of the sample from row to row."""
MIN_CHECKED_CELLS = 1100
"""On at most this many cells the second rule is tried on all, unless it clearly agrees on some."""
MIN_SAMPLED_CELLS = 400
"""On at most this many cells it is tried on all at once."""
MIN_LARGEST = 64
"""So many cells with the largest errors of few cells are some of them."""
CLEAR_SHARE = 0.5
"""On some of few cells two rules agree clearly when they differ by this share of what is allowed."""
MAX_KEPT_CELLS = 1 << 18
"""Cells of which the sample is kept, for the next mesh of the size."""
MAX_ROUNDS = 12
"""Divisions of a cell."""
MAX_PIECES_PER_CELL = 6
"""Pieces that are measured, for each cell, at most; and :data:`MAX_PIECES`."""
MAX_PIECES = 20_000
"""Pieces that are measured in addition."""


class Parts(Protocol):
    """Cells, or parts of them, on which an interpolation error is integrated, as :class:`Pieces` are."""

    def some(self, chosen: IntArray | BoolArray) -> Parts:
        """The chosen ones."""
        ...

    def quarters(self) -> Parts:
        """Four parts of every one; part ``q`` of number ``k`` has the number ``q * count + k``."""
        ...

    def errors(self, u: Field) -> Array:
        """The integrals over every one, of shape ``(3, n)``."""
        ...


@dataclass(frozen=True)
class Integrals:
    """Integrals of the squared errors of u (first) and of its gradient (second), and whether they are ``resolved``.

    They are those over so many ``cells`` of the whole mesh.
    """

    squares: tuple[float, float]
    resolved: tuple[bool, bool]
    cells: int


def resolved_integrals(
    pieces: Callable[[IntArray], Parts],
    cells: ChosenCells,
    first: Array,
    u: Field,
    noise: tuple[float, float],
) -> Integrals:
    """The sums over the ``cells`` of the whole mesh, of the ``first`` rule where a second one agrees.

    Often the two agree on the values and not on the gradients: then the first sum is still that of the ``first`` rule.

    ``pieces`` gives the own cells at some positions. ``first`` of shape ``(2, n)`` are the integrals over each own cell
    by the first rule. Integrals of at most ``noise`` are rounding, and are not refined.
    """
    totals, count = cells.total(first), cells.count()
    is_known, agree = math.isfinite(totals[0]) and math.isfinite(totals[1]), (True, True)
    if is_known and count > MIN_SAMPLED_CELLS:
        some = _largest_and_sampled(cells, count, first, totals)
        share = 1.0 if count > MIN_CHECKED_CELLS else CLEAR_SHARE
        agree = _agree(pieces, cells, first, u, totals, noise, some, share)
    if is_known and (count <= MIN_SAMPLED_CELLS or (count <= MIN_CHECKED_CELLS and not all(agree))):
        agree = _agree(pieces, cells, first, u, totals, noise, _all_of(cells), 1.0)
    if all(agree):
        return Integrals((float(totals[0]), float(totals[1])), (True, True), count)
    every = pieces(np.arange(cells.numbers.size))
    found = _Refinement(u, np.asarray(noise), cells.rows).of(every, first, count)
    if not agree[0]:
        return found
    return Integrals((float(totals[0]), found.squares[1]), (True, found.resolved[1]), count)


def _agree(
    pieces: Callable[[IntArray], Parts],
    cells: ChosenCells,
    first: Array,
    u: Field,
    totals: Array,
    noise: tuple[float, float],
    some: tuple[IntArray, Array],
    share: float,
) -> tuple[bool, bool]:
    """Whether a second rule agrees in values and in gradients, to a ``share`` of what is allowed.

    ``some`` are the positions of the cells on which it is tried, and how many cells each stands for.
    """
    chosen, weights = some
    second = pieces(chosen).errors(u)
    tried = cells.rows.summed(np.concatenate([first[:, chosen], second]) @ weights).tolist()
    missed, agree = MISSED_WEIGHT * tried[4], list[bool]()
    for part, (before, after) in enumerate(zip(tried[:2], tried[2:4], strict=True)):
        allowed = share * MAX_DIFFERENCES[part] * max(after, before)
        is_small = totals[part] <= noise[part] and after <= noise[part]  # not where it is NaN
        agree.append(abs(after - before) <= allowed or is_small)
    agree[1] = agree[1] and (missed <= allowed or (is_small and missed <= noise[1]))
    return agree[0], agree[1]


def _all_of(cells: ChosenCells) -> tuple[IntArray, Array]:
    """All positions; each cell stands for itself."""
    return np.arange(cells.numbers.size), np.ones(cells.numbers.size)


def _largest_and_sampled(cells: ChosenCells, count: int, first: Array, totals: Array) -> tuple[IntArray, Array]:
    """Positions of the cells with the largest errors and of a sample, and how many cells each stands for.

    ``count`` is the number of ``cells`` of the whole mesh.
    """
    wanted, sampled = count // CHECKED if count > MIN_CHECKED_CELLS else MIN_LARGEST, _on_lattice(cells)
    if cells.rows.are_all and 0 < wanted < count:
        places, weights = np.empty(wanted + sampled.size, np.int64), np.empty(wanted + sampled.size)
        size = choose_cells(first, totals, sampled, wanted, places, weights)
        return places[:size], weights[:size]
    share = (first / np.where(totals > 0.0, totals, 1.0)[:, None]).sum(axis=0)
    largest, is_rest = largest_of(share, wanted, cells.rows), np.ones(share.size, dtype=np.bool_)
    is_rest[largest] = False
    rest = sampled[is_rest[sampled]]
    in_sample = float(cells.rows.summed(np.array([float(rest.size)]))[0])
    weights = np.ones(largest.size + rest.size)
    weights[largest.size :] = (count - wanted) / max(in_sample, 1.0)
    return np.concatenate([largest, rest]), weights


@compiled
def choose_cells(first: Array, totals: Array, sampled: IntArray, wanted: int, places: IntArray, weights: Array) -> int:
    """Fill ``places`` with those of the ``wanted`` largest of the ``first`` errors, then those ``sampled``; returns how
    many there are. ``weights`` are how many cells each stands for."""
    share, one, two = np.empty(first.shape[1]), totals[0], totals[1]
    one, two = 1.0 / one if one > 0.0 else 1.0, 1.0 / two if two > 0.0 else 1.0
    for k in range(share.size):
        share[k] = one * first[0, k] + two * first[1, k]
    find_largest(share.view(np.int64), places[:wanted])
    size, before = wanted, 0
    for place in sampled:
        while before < wanted and places[before] < place:
            before += 1
        if before == wanted or places[before] != place:
            places[size] = place
            size += 1
    for k in range(size):
        weights[k] = 1.0 if k < wanted else (share.size - wanted) / (size - wanted)
    return size


def _on_lattice(cells: ChosenCells) -> IntArray:
    """The positions of the cells that belong to the sample, which meets every row and column."""
    numbers, columns = cells.numbers, cells.columns
    if cells.rows.cells[1] == 1:  # a mesh of blocks
        return np.flatnonzero(scattered(numbers, CHECKED))
    if numbers.size and numbers[-1] - numbers[0] + 1 == numbers.size <= MAX_KEPT_CELLS:
        return _lattice(int(numbers[0]), numbers.size, columns)
    return _lattice_of(numbers, columns)


@lru_cache(maxsize=4)
def _lattice(first: int, count: int, columns: int) -> IntArray:
    """The lattice of consecutive cells."""
    return _lattice_of(np.arange(first, first + count), columns)


def _lattice_of(numbers: IntArray, columns: int) -> IntArray:
    return np.flatnonzero((numbers + (CHECKED_SHIFT - columns) * (numbers // columns)) % CHECKED == 0)


@dataclass(frozen=True, eq=False)
class _Refinement:
    """The division of pieces of the own cells, by one rule for the whole mesh."""

    u: Field
    noise: Array
    rows: Rows

    def of(self, pieces: Parts, first: Array, count: int) -> Integrals:
        """The integrals from pieces that are divided where the last division has changed the result most.

        The pieces are cells at first, ``count`` of them in the whole mesh.
        """
        errors = pieces.errors(self.u)
        sums, differences = errors[:2], np.abs(errors[:2] - first)
        differences[1] += MISSED_WEIGHT * errors[2]
        kept, kept_differences = np.zeros(2), np.zeros(2)
        budget = MAX_PIECES + MAX_PIECES_PER_CELL * count
        for _ in range(MAX_ROUNDS):
            totals, doubt = self._total(kept, sums, kept_differences, differences)
            if np.all((doubt <= MAX_LEFT_DIFFERENCE * totals) | (np.maximum(totals, doubt) <= self.noise)):
                break
            divided = self._doubtful(differences, totals, self._sum(kept_differences))
            new = 4 * int(self._sum(np.array([float(divided.sum())]))[0])
            if new > budget:
                break
            kept += sums[:, ~divided].sum(axis=1)
            kept_differences += differences[:, ~divided].sum(axis=1)
            parents, pieces = sums[:, divided], pieces.some(divided).quarters()
            budget -= new
            errors = pieces.errors(self.u)
            sums = errors[:2]
            differences = _shared(parents, sums)
            differences[1] += MISSED_WEIGHT * errors[2]
        totals, doubt = self._total(kept, sums, kept_differences, differences)
        resolved = (doubt <= np.multiply(MAX_DIFFERENCES, totals)) | (np.maximum(totals, doubt) <= self.noise)
        return Integrals((float(totals[0]), float(totals[1])), (bool(resolved[0]), bool(resolved[1])), count)

    def _sum(self, numbers: Array) -> Array:
        return self.rows.summed(numbers)

    def _total(self, kept: Array, sums: Array, kept_differences: Array, differences: Array) -> tuple[Array, Array]:
        """The integrals over the whole mesh, and the doubt about them."""
        found = self._sum(np.concatenate([kept + sums.sum(axis=1), kept_differences + differences.sum(axis=1)]))
        return found[:2], found[2:]

    def _doubtful(self, differences: Array, totals: Array, kept: Array) -> BoolArray:
        """The pieces to divide: without the others the doubt about each integral is half of what is allowed."""
        divided = np.zeros(differences.shape[1], dtype=np.bool_)
        for difference, total, before in zip(differences, totals, kept, strict=True):
            allowed = max(0.5 * MAX_LEFT_DIFFERENCE * total - before, 0.0)
            divided |= all_but_the_smallest(difference, allowed, self.rows)
        return divided


def _shared(parents: Array, sums: Array) -> Array:
    """How much the integrals over four parts differ from that over their piece: to each part in equal shares."""
    together = sums.reshape(2, 4, -1).sum(axis=1)
    return np.tile(np.abs(together - parents) / 4.0, (1, 4))
