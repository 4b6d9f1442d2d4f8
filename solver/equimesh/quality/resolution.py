"""Whether the integrals of interpolation errors are resolved, and finer ones where they are not.

A rule with few points a cell misses a layer that lies between the points. A second rule, with other points, is tried on
the cells with the largest errors and on a sample of all cells. Where the two differ, the second rule takes the place
of the first, and cells are divided where it changes the result, up to a bounded cost.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from equimesh.fields.field import Field
from equimesh.meshes.mesh_window import WindowCells
from equimesh.numerics.channel import Channel
from equimesh.numerics.gather import summed
from equimesh.numerics.types import Array, BoolArray, IntArray
from equimesh.quality.pieces import Pieces
from equimesh.quality.selection import all_but_the_smallest, largest_of, scattered

MAX_DIFFERENCES = np.array([0.1, 0.02])
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
"""On at most this many cells the second rule is tried on all."""
MAX_KEPT_CELLS = 1 << 18
"""Cells of which the sample is kept, for the next mesh of the size."""
MAX_ROUNDS = 12
"""Divisions of a cell."""
MAX_PIECES_PER_CELL = 6
"""Pieces that are measured, for each cell, at most; and :data:`MAX_PIECES`."""
MAX_PIECES = 20_000
"""Pieces that are measured in addition."""


@dataclass(frozen=True)
class Integrals:
    """Integrals of the squared errors of u (first) and of its gradient (second), and whether they are ``resolved``.

    They are those over so many ``cells``, of all processes.
    """

    squares: tuple[float, float]
    resolved: tuple[bool, bool]
    cells: int


def resolved_integrals(
    pieces: Callable[[IntArray], Pieces],
    cells: WindowCells,
    first: Array,
    u: Field,
    noise: tuple[float, float],
) -> Integrals:
    """The sums over the ``cells`` of all processes, of the ``first`` rule where a second one agrees.

    Often the two agree on the values and not on the gradients: then the first sum is still that of the ``first`` rule.

    ``pieces`` gives the own cells at some positions. ``first`` of shape ``(2, n)`` are the integrals over each own cell
    by the first rule. Integrals of at most ``noise`` are rounding, and are not refined.
    """
    totals, count, channel = cells.total(first), cells.count(), cells.rows.channel
    chosen, weights = _checked(cells, count, first, totals)
    second = pieces(chosen).errors(u)
    tried = summed(channel, np.concatenate([first[:, chosen], second]) @ weights)
    before, after, missed = tried[:2], tried[2:4], MISSED_WEIGHT * float(tried[4])
    small = (np.maximum(totals, after) <= noise, bool(max(totals[1], after[1], missed) <= noise[1]))
    agree = (np.abs(after - before) <= MAX_DIFFERENCES * np.maximum(after, before)) | small[0]
    agree[1] &= missed <= MAX_DIFFERENCES[1] * max(after[1], before[1]) or small[1]
    if agree.all() or not np.isfinite(totals).all():
        return Integrals((float(totals[0]), float(totals[1])), (True, True), count)
    every = pieces(np.arange(cells.numbers.size))
    found = _Refinement(u, np.asarray(noise), channel).of(every, first, count)
    if not agree[0]:
        return found
    return Integrals((float(totals[0]), found.squares[1]), (True, found.resolved[1]), count)


def _checked(cells: WindowCells, count: int, first: Array, totals: Array) -> tuple[IntArray, Array]:
    """Positions of the cells on which the second rule is tried, and how many cells each stands for.

    ``count`` is the number of ``cells`` of all processes.
    """
    if count <= MIN_CHECKED_CELLS:
        return np.arange(cells.numbers.size), np.ones(cells.numbers.size)
    sampled = _on_lattice(cells)
    share = (first / np.where(totals > 0.0, totals, 1.0)[:, None]).sum(axis=0)
    wanted = count // CHECKED
    largest = largest_of(share, wanted, cells.rows)
    sampled[largest] = False
    rest = np.flatnonzero(sampled)
    in_sample = float(summed(cells.rows.channel, np.array([float(rest.size)]))[0])
    weights = np.ones(largest.size + rest.size)
    weights[largest.size :] = (count - wanted) / max(in_sample, 1.0)
    return np.concatenate([largest, rest]), weights


def _on_lattice(cells: WindowCells) -> BoolArray:
    """Whether a cell belongs to the sample, which meets every row and column."""
    numbers, columns = cells.numbers, cells.columns
    if cells.rows.cells[1] == 1:  # a mesh of blocks
        return scattered(numbers, CHECKED)
    if numbers.size and numbers[-1] - numbers[0] + 1 == numbers.size <= MAX_KEPT_CELLS:
        return _lattice(int(numbers[0]), numbers.size, columns).copy()
    return _lattice_of(numbers, columns)


@lru_cache(maxsize=4)
def _lattice(first: int, count: int, columns: int) -> BoolArray:
    """The lattice of consecutive cells."""
    return _lattice_of(np.arange(first, first + count), columns)


def _lattice_of(numbers: IntArray, columns: int) -> BoolArray:
    return np.asarray((numbers + (CHECKED_SHIFT - columns) * (numbers // columns)) % CHECKED == 0)


@dataclass(frozen=True, eq=False)
class _Refinement:
    """The division of pieces: of those of all processes by one rule, each process those of its own cells."""

    u: Field
    noise: Array
    channel: Channel

    def of(self, pieces: Pieces, first: Array, count: int) -> Integrals:
        """The integrals from pieces that are divided where the last division has changed the result most.

        The pieces are cells at first, ``count`` of them in all processes.
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
        resolved = (doubt <= MAX_DIFFERENCES * totals) | (np.maximum(totals, doubt) <= self.noise)
        return Integrals((float(totals[0]), float(totals[1])), (bool(resolved[0]), bool(resolved[1])), count)

    def _sum(self, numbers: Array) -> Array:
        return summed(self.channel, numbers)

    def _total(self, kept: Array, sums: Array, kept_differences: Array, differences: Array) -> tuple[Array, Array]:
        """The integrals and the doubt about them, of all processes."""
        found = self._sum(np.concatenate([kept + sums.sum(axis=1), kept_differences + differences.sum(axis=1)]))
        return found[:2], found[2:]

    def _doubtful(self, differences: Array, totals: Array, kept: Array) -> BoolArray:
        """The pieces to divide: without the others the doubt about each integral is half of what is allowed."""
        divided = np.zeros(differences.shape[1], dtype=np.bool_)
        for difference, total, before in zip(differences, totals, kept, strict=True):
            allowed = max(0.5 * MAX_LEFT_DIFFERENCE * total - before, 0.0)
            divided |= all_but_the_smallest(difference, allowed, self.channel)
        return divided


def _shared(parents: Array, sums: Array) -> Array:
    """How much the integrals over four parts differ from that over their piece: to each part in equal shares."""
    together = sums.reshape(2, 4, -1).sum(axis=1)
    return np.tile(np.abs(together - parents) / 4.0, (1, 4))
