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
from equimesh.numerics.types import Array, BoolArray, IntArray
from equimesh.quality.pieces import Pieces

MAX_DIFFERENCE = 0.1
"""Largest difference of two integrals of squared errors, as a share of them: 5 % of the norms."""
MAX_LEFT_DIFFERENCE = 0.02
"""The same where cells are divided: the last division changes the integrals by no more, if the cost allows it."""
CHECKED = 37
"""The second rule is tried on one cell of this many, and on as many cells with the largest errors."""
CHECKED_SHIFT = 11
"""The shift of the sample from row to row."""
MIN_CHECKED_CELLS = 512
"""On at most this many cells the second rule is tried on all."""
MAX_ROUNDS = 12
"""Divisions of a cell."""
MAX_PIECES_PER_CELL = 6
"""Pieces that are measured, for each cell, at most; and :data:`MAX_PIECES`."""
MAX_PIECES = 20_000
"""Pieces that are measured in addition."""


@dataclass(frozen=True)
class Integrals:
    """Integrals of the squared errors of u (first) and of its gradient (second), and whether they are ``resolved``."""

    squares: tuple[float, float]
    resolved: tuple[bool, bool]


def resolved_integrals(
    pieces: Callable[[IntArray], Pieces],
    shape: tuple[int, int],
    numbers: IntArray,
    first: Array,
    u: Field,
    noise: tuple[float, float],
) -> Integrals:
    """The sums over cells, of the ``first`` rule where a second one agrees.

    ``pieces`` gives the cells at some positions. The cells have these ``numbers`` on a grid with ``shape`` cells.
    ``first`` of shape ``(2, n)`` are the integrals over each cell by the first rule. Integrals of at most ``noise`` are
    rounding, and are not refined.
    """
    totals = first.sum(axis=1)
    chosen, weights = _checked(shape, numbers, first, totals)
    second = pieces(chosen).errors(u)
    before, after = first[:, chosen] @ weights, second[:2] @ weights
    missed = float(second[2] @ weights)
    small = (np.maximum(totals, after) <= noise, bool(max(totals[1], after[1], missed) <= noise[1]))
    agree = (np.abs(after - before) <= MAX_DIFFERENCE * np.maximum(after, before)) | small[0]
    agree[1] &= missed <= MAX_DIFFERENCE * max(after[1], before[1]) or small[1]
    if agree.all() or not np.isfinite(totals).all():
        return Integrals((float(totals[0]), float(totals[1])), (True, True))
    return _refined(pieces(np.arange(numbers.size)), first, u, np.asarray(noise))


def _checked(shape: tuple[int, int], numbers: IntArray, first: Array, totals: Array) -> tuple[IntArray, Array]:
    """Positions of the cells on which the second rule is tried, and how many cells each stands for."""
    if numbers.size <= MIN_CHECKED_CELLS:
        return np.arange(numbers.size), np.ones(numbers.size)
    sampled = _lattice(shape)[numbers]
    share = (first / np.where(totals > 0.0, totals, 1.0)[:, None]).sum(axis=0)
    count = numbers.size // CHECKED
    largest = np.argpartition(share, numbers.size - count)[-count:]
    sampled[largest] = False
    rest = np.flatnonzero(sampled)
    weights = np.ones(count + rest.size)
    weights[count:] = (numbers.size - count) / max(rest.size, 1)
    return np.concatenate([largest, rest]), weights


@lru_cache(maxsize=4)
def _lattice(shape: tuple[int, int]) -> BoolArray:
    """Whether a cell belongs to the sample, which meets every row and column; for all cells, flat."""
    row, column = np.ogrid[: shape[0], : shape[1]]
    return np.asarray((column + CHECKED_SHIFT * row) % CHECKED == 0).reshape(-1)


def _refined(pieces: Pieces, first: Array, u: Field, noise: Array) -> Integrals:
    """The integrals from pieces that are divided where the last division has changed the result most."""
    errors = pieces.errors(u)
    sums, differences = errors[:2], np.abs(errors[:2] - first)
    differences[1] += errors[2]
    kept, kept_differences = np.zeros(2), np.zeros(2)
    budget = MAX_PIECES + MAX_PIECES_PER_CELL * pieces.count
    for _ in range(MAX_ROUNDS):
        totals, doubt = kept + sums.sum(axis=1), kept_differences + differences.sum(axis=1)
        if np.all((doubt <= MAX_LEFT_DIFFERENCE * totals) | (np.maximum(totals, doubt) <= noise)):
            break
        divided = _doubtful(differences, totals, kept_differences)
        if 4 * int(divided.sum()) > budget:
            break
        kept += sums[:, ~divided].sum(axis=1)
        kept_differences += differences[:, ~divided].sum(axis=1)
        parents, pieces = sums[:, divided], pieces.some(divided).quarters()
        budget -= pieces.count
        errors = pieces.errors(u)
        sums = errors[:2]
        differences = _shared(parents, sums)
        differences[1] += errors[2]
    totals, doubt = kept + sums.sum(axis=1), kept_differences + differences.sum(axis=1)
    resolved = (doubt <= MAX_DIFFERENCE * totals) | (np.maximum(totals, doubt) <= noise)
    return Integrals((float(totals[0]), float(totals[1])), (bool(resolved[0]), bool(resolved[1])))


def _doubtful(differences: Array, totals: Array, kept: Array) -> BoolArray:
    """The pieces to divide: without the others the doubt about each integral is half of what is allowed."""
    divided = np.zeros(differences.shape[1], dtype=np.bool_)
    for difference, total, before in zip(differences, totals, kept, strict=True):
        order = np.argsort(difference)
        allowed = max(0.5 * MAX_LEFT_DIFFERENCE * total - before, 0.0)
        divided[order[np.cumsum(difference[order]) > allowed]] = True
    return divided


def _shared(parents: Array, sums: Array) -> Array:
    """How much the integrals over four parts differ from that over their piece: to each part in equal shares."""
    together = sums.reshape(2, 4, -1).sum(axis=1)
    return np.tile(np.abs(together - parents) / 4.0, (1, 4))
