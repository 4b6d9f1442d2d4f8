"""Interpolation of nodal values from one uniform grid to another: products of one-dimensional rules."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from equimesh.meshes.folding import largest_difference
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array, IntArray

# Coarse points in a rule. A linear rule has two weights that are zero.
WIDTH = 4


class Rule(NamedTuple):
    """For every fine point, the ``first`` coarse point, ``(fine,)``, and Lagrange ``weights``, ``(WIDTH, fine)``."""

    first: npt.NDArray[np.uint64]
    weights: Array


def interpolated_values(values: Array, shape: tuple[int, ...], *, cubic: bool = True) -> Array:
    """Nodal ``values`` of shape ``(n_xi, n_eta)`` on a grid of another shape, by cubic or linear interpolation."""
    fine = np.empty(shape)
    interpolate(np.ascontiguousarray(values), *rules(values.shape, shape, cubic=cubic), (0, shape[0]), fine, True)
    return fine


def rules(coarse: tuple[int, ...], fine: tuple[int, ...], *, cubic: bool = True) -> tuple[Rule, Rule]:
    """The rules along xi and along eta."""
    return rule(coarse[0], fine[0], cubic=cubic), rule(coarse[1], fine[1], cubic=cubic)


@lru_cache(maxsize=64)
def rule(coarse: int, fine: int, *, cubic: bool = True) -> Rule:
    """The rule from ``coarse`` points of a uniform grid of [0, 1], four or more, to ``fine`` points."""
    place = np.arange(fine) * (coarse - 1) / (fine - 1)
    cell = np.minimum(place.astype(np.int64), coarse - 2)
    first = np.clip(cell - 1, 0, coarse - WIDTH)
    at, weights = (cell - first) + (place - cell), np.zeros((WIDTH, fine))
    if cubic:
        weights[:] = lagrange(at)
    else:
        every = np.arange(fine)
        weights[cell - first, every], weights[cell - first + 1, every] = 1.0 - (place - cell), place - cell
    return fixed_rule(first, weights)


def fixed_rule(first: IntArray | npt.NDArray[np.uint64], weights: Array) -> Rule:
    """A rule that nobody can change. All rules are such: for others the loops would be compiled once more."""
    found = Rule(first.astype(np.uint64), weights)
    for array in found:
        array.setflags(write=False)
    return found


def rule_on_rows(whole: Rule, rows: tuple[int, int], begin: int) -> Rule:
    """A rule for some fine rows alone, whose coarse rows are counted from ``begin``."""
    if (*rows, begin) == (0, whole.first.size, 0):
        return whole
    here = slice(*rows)
    return fixed_rule(whole.first[here] - np.uint64(begin), np.array(whole.weights[:, here], order="C"))


def rows_needed(coarse: int, fine: int, rows: tuple[int, int]) -> tuple[int, int]:
    """The first coarse row that the rules for some fine rows read, and the one after the last."""
    first = rule(coarse, fine).first
    return int(first[rows[0]]), int(first[rows[1] - 1]) + WIDTH


def lagrange(at: Array) -> Array:
    """The weights of the cubic through the values at 0, 1, 2 and 3."""
    weights = np.ones((WIDTH, at.size))
    for k in range(WIDTH):
        for other in range(WIDTH):
            if other != k:
                weights[k] *= (at - other) / (k - other)
    return weights


@compiled
def interpolate(
    coarse: Array, along_xi: Rule, along_eta: Rule, rows: tuple[int, int], fine: Array, write: bool
) -> float:
    """Nodal values on the rows ``rows[0]`` to ``rows[1] - 1`` of a finer grid, in ``fine``.

    Without ``write`` the values of ``fine`` are kept, and the largest difference to them is returned; NaN where one of
    them is not a number.
    """
    columns = fine.shape[1]
    lines, row, ready, largest = np.empty((WIDTH, columns)), np.empty((1, columns)), 0, 0.0
    at, weights = along_xi
    for i in range(rows[0], rows[1]):
        first = int(at[i])
        for r in range(max(ready, first), first + WIDTH):
            interpolate_line(coarse[r], along_eta, lines[r % WIDTH])
        ready = first + WIDTH
        one, two, three, four = lines[first % 4], lines[(first + 1) % 4], lines[(first + 2) % 4], lines[(first + 3) % 4]
        a, b, c, d = weights[0, i], weights[1, i], weights[2, i], weights[3, i]
        target = fine[i] if write else row[0]
        for j in range(columns):
            target[j] = a * one[j] + b * two[j] + c * three[j] + d * four[j]
        if not write:
            found = largest_difference(row, fine[i : i + 1])
            if found > largest or found - found != 0.0:
                largest = found
    return largest


@compiled
def extrapolate(values: Array, before: Array, share: float, rows: tuple[int, int]) -> None:
    """Replace some rows of ``before`` by ``values`` plus ``share`` of the differences ``values - before``."""
    for i in range(rows[0], rows[1]):
        here, there = values[i], before[i]
        for j in range(here.size):
            there[j] = here[j] + share * (here[j] - there[j])


@compiled
def interpolate_line(source: Array, along_eta: Rule, line: Array) -> None:
    """The values of one row of the coarse grid at all fine points along eta."""
    first, weights = along_eta
    a, b, c, d = weights[0], weights[1], weights[2], weights[3]
    for j in range(line.size):
        at = first[j]  # without a sign, so that the compiler need not allow for an index from the end
        line[j] = (
            a[j] * source[at]
            + b[j] * source[at + np.uint64(1)]
            + c[j] * source[at + np.uint64(2)]
            + d[j] * source[at + np.uint64(3)]
        )
