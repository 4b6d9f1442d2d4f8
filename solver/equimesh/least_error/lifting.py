"""Values at the nodes of a mesh in blocks, interpolated from a coarser one along lines that run from block to block."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from equimesh.least_error.block_levels import BlockLevel
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array, IntArray

AHEAD = 4
"""Lines from which a value is interpolated with cubic interpolation; two with linear one."""


Around: TypeAlias = tuple[list[list[IntArray | None]], Array]
"""By axis and end the nodes next to the edges of a block on their other sides, and the finest lines to there.

``None`` and 0 where there are none.
"""
NOTHING: Around = ([[None, None], [None, None]], np.zeros((2, 2)))
"""No neighbours."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Line:
    """Places between lines, each with the numbers of the lines around it and their weights, shape ``(places, k)``."""

    numbers: IntArray
    weights: Array


class Lifting:
    """The way from values at the nodes of a ``coarse`` level to those of a ``fine`` one."""

    def __init__(self, coarse: BlockLevel, fine: BlockLevel) -> None:
        self.coarse, self.fine = coarse, fine
        self._around = [_around(coarse, block) for block in range(len(coarse.blocks))]

    def lifted(self, values: Array, *, cubic: bool, alone: bool = False) -> Array:
        """``values`` of shape ``(k, coarse nodes)`` at the fine nodes, exact at nodes that are both.

        ``alone`` tells whether each block is interpolated without its neighbours: lines may have kinks between them.
        """
        out = np.zeros((len(values), self.fine.points))
        for block, around in enumerate([NOTHING] * len(self._around) if alone else self._around):
            out[:, self.fine.blocks[block]] = self._block(values, around, block, cubic=cubic)
        return out

    def lifted_along_sides(self, values: Array, *, cubic: bool) -> Array:
        """As :meth:`lifted` of one value a node, shape ``(coarse nodes,)``, from values along the same edge alone.

        Inside of blocks the values mean nothing.
        """
        out = np.zeros(self.fine.points)
        for block, to in enumerate(self.fine.blocks):
            here = self._block(values[None], NOTHING, block, cubic=cubic)[0]
            for edge in (np.s_[0], np.s_[-1], np.s_[:, 0], np.s_[:, -1]):
                out[to[edge]] = here[edge]
        return out

    def _block(self, values: Array, around: Around, block: int, *, cubic: bool) -> Array:
        """The values at the fine nodes of a block: along i, then along j, with one line more on each side."""
        ghosts, steps = around
        padded = [_padded(self.coarse.lines[block][axis], steps[axis]) for axis in (0, 1)]
        wanted = self.fine.lines[block]
        lines = [_line(padded[axis], wanted[axis], True, cubic=cubic) for axis in (0, 1)]
        beside = _line(padded[0], wanted[0], False, cubic=cubic) if steps[1].any() else lines[0]
        out = np.empty((len(values), wanted[0].size, wanted[1].size))
        inside = self.coarse.blocks[block]
        n, m = inside.shape
        for k in range(len(values)):
            extended = np.zeros((n + 2, m + 2))
            extended[1:-1, 1:-1] = values[k][inside]
            for axis, end in np.ndindex(2, 2):
                nodes = ghosts[axis][end]
                if steps[axis][end] > 0 and nodes is not None:
                    at = (n + 1) * end if axis == 0 else (m + 1) * end
                    target = extended[at, 1:-1] if axis == 0 else extended[1:-1, at]
                    target[:] = values[k][nodes]
            first = np.zeros((wanted[0].size, m + 2))
            _apply(extended, lines[0].numbers, lines[0].weights, first, 1, m + 1)
            # Lines of a neighbour need not run on as those of the block do.
            for column in (0, m + 1):
                _apply(extended, beside.numbers, beside.weights, first, column, column + 1)
            turned = np.zeros((wanted[1].size, wanted[0].size))
            _apply(np.ascontiguousarray(first.T), lines[1].numbers, lines[1].weights, turned, 0, wanted[0].size)
            out[k] = turned.T
        return out


def along(values: Array, places: Array) -> Array:
    """``values`` at the nodes of one line, at other ``places`` on it, counted in nodes, by cubic interpolation."""
    line = _line(_padded(np.arange(values.size), np.zeros(2)), places, False, cubic=True)
    padded = np.concatenate([[0.0], values, [0.0]])
    found: Array = (padded[line.numbers] * line.weights).sum(axis=1)
    return found


def _around(level: BlockLevel, block: int) -> Around:
    """What lies around a block of the level."""
    found: list[list[IntArray | None]] = [[None, None], [None, None]]
    steps = np.zeros((2, 2))
    for axis, end in np.ndindex(2, 2):
        other = level.edges.across(block, axis, end)
        if other is None:
            continue
        nodes, lines = level.blocks[other.block], level.lines[other.block][other.axis]
        inner = 1 if other.end == 0 else -2
        row = nodes[inner] if other.axis == 0 else nodes[:, inner]
        found[axis][end] = row[::-1] if other.is_turned else row
        steps[axis, end] = abs(int(lines[inner] - lines[-other.end]))
    return found, steps


def _padded(lines: IntArray, steps: Array) -> tuple[Array, bool, bool]:
    """The places of lines with those of the neighbours before and after them, and whether these are there."""
    before, after = (float(step) for step in steps)
    places = np.concatenate([[lines[0] - (before or 1.0)], lines, [lines[-1] + (after or 1.0)]]).astype(np.float64)
    return places, before > 0.0, after > 0.0


def _line(padded: tuple[Array, bool, bool], wanted: Array | IntArray, has_ghosts: bool, *, cubic: bool) -> Line:
    """Lagrange interpolation from the lines around each of the ``wanted`` places."""
    places, before, after = padded
    first, last = (0 if before and has_ghosts else 1), places.size - (0 if after and has_ghosts else 1)
    left = np.clip(np.searchsorted(places, wanted, side="right") - 1, 1, places.size - 3)
    size = min(AHEAD, last - first) if cubic else 2
    start = np.clip(left - (size // 2 - 1), first, last - size) if cubic else left
    numbers = start[:, None] + np.arange(size)
    at = places[numbers]
    weights = np.ones_like(at)
    for k in range(size):
        for other in range(size):
            if other != k:
                weights[:, k] *= (wanted - at[:, other]) / (at[:, k] - at[:, other])
    return Line(numbers=numbers, weights=weights)


@compiled
def _apply(values: Array, numbers: IntArray, weights: Array, out: Array, first: int, last: int) -> None:
    """``out[p] = sum of weights[p, k] values[numbers[p, k]]``, in the columns from ``first`` to before ``last``."""
    for p in range(numbers.shape[0]):
        for column in range(first, last):
            total = 0.0
            for k in range(numbers.shape[1]):
                total += weights[p, k] * values[numbers[p, k], column]
            out[p, column] = total
