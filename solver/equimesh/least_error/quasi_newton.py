"""Quasi-Newton directions: L-BFGS on flat arrays, from 2 x 2 blocks of each node.

J. Nocedal and S. J. Wright, *Numerical Optimization* (Springer, 2006), algorithm 7.4. The loops take the place of the
linear algebra of NumPy. That shares a product of long arrays among all processors, whose threads wait for each other
longer than they work.
"""

from __future__ import annotations

import math

import numpy as np

from equimesh.numerics.compiled import vectorised
from equimesh.numerics.types import Array, Pair

MIN_CURVATURE = 1e-12
"""The smallest cosine between a move and the change of the gradient for which the pair is kept."""


class History:
    """The last moves and changes of the gradient: an approximation of the inverse of the second derivatives."""

    def __init__(self, unknowns: int, pairs: int) -> None:
        # One pair more than is used: it is written before it is known whether it counts.
        self._moves, self._changes = np.empty((pairs + 1, unknowns)), np.empty((pairs + 1, unknowns))
        self._products = np.empty(pairs + 1)
        self._added = 0

    @property
    def is_empty(self) -> bool:
        """Whether no pair is known."""
        return self._added == 0

    def add(self, before: Array, after: Array, slope: Array, slope_then: Array) -> None:
        """Keep the move and the change of the gradient, if their curvature is positive, in place of the oldest pair."""
        slot = self._added % len(self._moves)
        given = (np.ascontiguousarray(part).reshape(-1) for part in (before, after, slope, slope_then))
        mixed, of_move, of_change = keep_pair((self._moves[slot], self._changes[slot]), *given)
        if mixed > MIN_CURVATURE * math.sqrt(of_move * of_change):
            self._products[slot] = mixed
            self._added += 1

    def clear(self) -> None:
        """Forget all pairs."""
        self._added = 0

    def direction(self, gradient: Array, blocks: Array) -> Array:
        """The approximate inverse times the ``gradient``."""
        out, pairs = np.empty(gradient.shape), (self._moves, self._changes, self._products)
        slopes = np.ascontiguousarray(gradient).reshape(-1)
        quasi_newton_direction(*pairs, self._added, np.ascontiguousarray(blocks), slopes, out.reshape(-1))
        return out


@vectorised
def solve_blocks(blocks: Array, right: Array, out: Array) -> None:
    """The solutions of 2 x 2 systems with the matrices ``(ss, st, tt)`` of every node.

    ``right`` and ``out`` have shape ``(2 nodes,)``: first those along s.
    """
    count = blocks.shape[1]
    for k in range(count):
        a, b, d = blocks[0, k], blocks[1, k], blocks[2, k]
        one, other, det = right[k], right[count + k], a * d - b * b
        out[k] = (d * one - b * other) / det
        out[count + k] = (a * other - b * one) / det


@vectorised
def product(one: Array, other: Array) -> float:
    """The inner product of two flat arrays."""
    total = 0.0
    for k in range(one.size):
        total += one[k] * other[k]
    return total


@vectorised
def add_multiple(factor: float, added: Array, out: Array, other: Array) -> float:
    """Add ``factor`` times ``added`` to ``out``, all of them flat; the inner product of the result with ``other``."""
    total = 0.0
    for k in range(out.size):
        out[k] += factor * added[k]
        total += out[k] * other[k]
    return total


@vectorised
def slope_along(gradient: Array, direction: Array) -> tuple[float, float]:
    """The inner product of two flat arrays, and the largest size of a number in the second one."""
    total, longest = 0.0, 0.0
    for k in range(gradient.size):
        total += gradient[k] * direction[k]
        longest = max(longest, abs(direction[k]))
    return total, longest


@vectorised
def keep_pair(pair: Pair, before: Array, after: Array, slope: Array, slope_then: Array) -> tuple[float, float, float]:
    """The move from ``before`` to ``after`` and the change of the gradient, in the ``pair`` of flat arrays.

    Returns their inner product, and that of each with itself.
    """
    move, change = pair
    mixed, of_move, of_change = 0.0, 0.0, 0.0
    for k in range(move.size):
        m, c = after[k] - before[k], slope_then[k] - slope[k]
        move[k], change[k] = m, c
        mixed += m * c
        of_move += m * m
        of_change += c * c
    return mixed, of_move, of_change


@vectorised
def quasi_newton_direction(
    moves: Array, changes: Array, products: Array, added: int, blocks: Array, gradient: Array, out: Array
) -> None:
    """The approximate inverse of the second derivatives times the ``gradient``, of shape ``(2 nodes,)`` as ``out``.

    The two loops of L-BFGS over the last of ``added`` pairs, in turn in the rows of ``moves`` and ``changes``, with
    their ``products``. All rows but one are used. The first matrix is that of the ``blocks``, scaled by the last pair.
    """
    kept = moves.shape[0]
    pairs, rest, shares = min(added, kept - 1), gradient.copy(), np.empty(kept)
    if pairs == 0:
        solve_blocks(blocks, rest, out)
        return
    last = (added - 1) % kept
    along = product(moves[last], rest)
    for k in range(pairs):
        row, older = (added - 1 - k) % kept, (added - 2 - k) % kept
        shares[k] = along / products[row]
        along = add_multiple(-shares[k], changes[row], rest, moves[older])
    solve_blocks(blocks, changes[last], out)
    scale, oldest = products[last] / product(changes[last], out), (added - pairs) % kept
    solve_blocks(blocks, rest, out)
    for k in range(out.size):
        out[k] *= scale
    along = product(changes[oldest], out)
    for k in range(pairs - 1, -1, -1):
        row, newer = (added - 1 - k) % kept, (added - k) % kept
        along = add_multiple(shares[k] - along / products[row], moves[row], out, changes[newer])
