"""Quasi-Newton descent: L-BFGS from 2 x 2 blocks of each node, one step after the other.

J. Nocedal and S. J. Wright, *Numerical Optimization* (Springer, 2006), algorithm 7.4. The Armijo condition decides how
far a step goes. A descent never calls its objective: it tells what it needs next, so that compiled code and Python can
both evaluate for it.

The loops take the place of the linear algebra of NumPy. That shares a product of long arrays among all processors,
whose threads wait for each other longer than they work.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

from equimesh.numerics.calls import address_of, called_at
from equimesh.numerics.compiled import compiled, vectorised
from equimesh.numerics.types import Array, IntArray, Pair

PAIRS = 8
"""Moves, and the changes of the gradient by them, that are kept."""
MIN_CURVATURE = 1e-12
"""The smallest cosine between a move and the change of the gradient for which the pair is kept."""
STEPS_A_PRECONDITIONER = 5
"""Steps after which the blocks are renewed."""
SHORTENING = 0.4
"""The factor by which a step that was not accepted is shortened."""
MAX_TRIALS = 9
"""Lengths of a step that are tried."""
MIN_DECREASE_SHARE = 1e-4
"""The share of the expected decrease that a step must reach: the Armijo condition."""
PATIENCE = 3
"""Steps over which the mean decrease is taken that ends the descent."""

RENEW, EVALUATE, TAKEN, OVER = range(4)
"""What a descent needs next: the blocks of its mesh anew, the objective of a trial, nothing as a step was taken, or
nothing any more."""
NEXT, HERE, STEPS, PAIRS_ADDED, TRIAL = range(5)
"""Places of what is counted: the last answer, which of both meshes is that of the descent, and numbers."""
SLOPE, LENGTH = range(2)
"""Places of the slope along the direction, and the length of the trial."""
RESULTS = 3
"""Numbers of a result: the objective, the error, and the distortion."""


class Code(NamedTuple):
    """Where the machine code of the loops is whose sums may be reordered."""

    direction: int
    slope: int
    pair: int


class Way(NamedTuple):
    """A descent: its mesh and the one that is tried, in turn, and what it knows of them."""

    code: Code
    meshes: Array
    """Shape ``(2, 2, nodes)``, as ``gradients``; the ``blocks`` ``(2, 3, nodes)``."""
    gradients: Array
    blocks: Array
    results: Array
    """The objective, the error and the distortion of both, shape ``(2, 3)``."""
    first_blocks: Array
    """Those of the approximation, shape ``(3, nodes)``."""
    direction: Array
    moves: Array
    """The last moves and changes of the gradient, one pair more than is used: a pair is written before it is known
    whether it counts. Shape ``(pairs + 1, 2 nodes)``."""
    changes: Array
    products: Array
    ties: IntArray
    """Pairs of unknowns that move together, a copy and its original, shape ``(ties, 2)``: numbers of a flat array."""
    values: Array
    """The objective after each step, shape ``(steps + 1,)``."""
    numbers: Array
    counts: IntArray
    max_move: float
    """The longest move of an unknown in one step."""
    min_decrease: float
    """The mean decrease of the objective in a step at which the descent ends."""

    @property
    def here(self) -> int:
        """The place of the mesh of the descent."""
        return int(self.counts[HERE])

    @property
    def trial(self) -> Array:
        """The mesh that is tried, or was last."""
        trial: Array = self.meshes[1 - self.here]
        return trial


def way_from(mesh: Array, ties: IntArray, steps: int, max_move: float, min_decrease: float) -> Way:
    """A descent of at most so many steps from a ``mesh`` of shape ``(2, nodes)``; its evaluation is to be written."""
    nodes, rows = mesh.shape[1], max(1, min(PAIRS, steps)) + 1
    way = Way(
        code=machine_code(),
        meshes=np.empty((2, 2, nodes)),
        gradients=np.empty((2, 2, nodes)),
        blocks=np.empty((2, 3, nodes)),
        results=np.empty((2, RESULTS)),
        first_blocks=np.empty((3, nodes)),
        direction=np.empty((2, nodes)),
        moves=np.empty((rows, 2 * nodes)),
        changes=np.empty((rows, 2 * nodes)),
        products=np.empty(rows),
        ties=ties,
        values=np.empty(steps + 1),
        numbers=np.zeros(2),
        counts=np.zeros(5, dtype=np.int64),
        max_move=max_move,
        min_decrease=min_decrease,
    )
    way.meshes[0] = mesh
    return way


@cache
def machine_code() -> Code:
    """The addresses of the loops in this process."""
    line, table = np.zeros(4), np.zeros((2, 4))
    return Code(
        direction=address_of(quasi_newton_direction, table, table, line, 0, table, line, line),
        slope=address_of(slope_along, line, line),
        pair=address_of(keep_pair, (line, line), line, line, line, line),
    )


@compiled
def advance(way: Way, is_known: bool) -> int:
    """What the descent needs next: :data:`RENEW` and the others.

    After :data:`EVALUATE` ``is_known`` tells whether the trial has an objective: then it was written at its place.
    Blocks that are to be renewed are those of the mesh, which were evaluated with it; who cuts triangles anew evaluates
    it again before. Where a direction leads nowhere, the pairs are forgotten, and it is tried once more.
    """
    counts, last = way.counts, way.counts[NEXT]
    if last == EVALUATE:
        if is_known and is_lower(way):
            take(way)
            counts[NEXT] = TAKEN
        else:
            counts[NEXT] = shorten(way)
    elif last == TAKEN:
        if is_over(way):
            counts[NEXT] = OVER
        else:
            counts[NEXT] = RENEW if counts[STEPS] % STEPS_A_PRECONDITIONER == 0 else aim(way)
    elif last == RENEW:
        if counts[STEPS] == 0:
            way.values[0] = way.results[counts[HERE], 0]
        renew(way)
        counts[NEXT] = OVER if way.values.size == 1 else aim(way)
    return int(counts[NEXT])


@compiled
def renew(way: Way) -> None:
    """Take the blocks of the mesh for the approximation."""
    here, out = way.blocks[way.counts[HERE]], way.first_blocks
    for k in range(out.shape[0]):
        for node in range(out.shape[1]):
            out[k, node] = here[k, node]


@compiled
def aim(way: Way) -> int:
    """The first trial along a direction; without pairs where they lead nowhere."""
    counts, direction = way.counts, way.direction.reshape(-1)
    gradient = way.gradients[counts[HERE]].reshape(-1)
    while True:
        known = way.moves, way.changes, way.products, counts[PAIRS_ADDED], way.first_blocks, gradient, direction
        called_at(way.code.direction, quasi_newton_direction, known)
        for k in range(way.ties.shape[0]):
            direction[way.ties[k, 0]] = direction[way.ties[k, 1]]
        slope, longest = called_at(way.code.slope, slope_along, (gradient, direction))
        if slope > 0.0 and np.isfinite(longest):
            counts[TRIAL] = 0
            way.numbers[SLOPE], way.numbers[LENGTH] = slope, min(1.0, way.max_move / longest)
            return place_trial(way)
        if counts[PAIRS_ADDED] == 0:
            return OVER
        counts[PAIRS_ADDED] = 0
        renew(way)


@compiled
def shorten(way: Way) -> int:
    """A shorter trial; after the last one the steepest way, and then the end."""
    counts = way.counts
    counts[TRIAL] += 1
    if counts[TRIAL] < MAX_TRIALS:
        way.numbers[LENGTH] *= SHORTENING
        return place_trial(way)
    if counts[PAIRS_ADDED] == 0:
        return OVER
    counts[PAIRS_ADDED] = 0
    renew(way)
    return aim(way)


@compiled
def place_trial(way: Way) -> int:
    """Place the mesh that is tried."""
    here, there, length = way.meshes[way.counts[HERE]], way.meshes[1 - way.counts[HERE]], way.numbers[LENGTH]
    for axis in range(2):
        for node in range(here.shape[1]):
            there[axis, node] = here[axis, node] - length * way.direction[axis, node]
    return EVALUATE


@compiled
def is_lower(way: Way) -> bool:
    """Whether the trial lowers the objective enough."""
    now, then = way.results[way.counts[HERE], 0], way.results[1 - way.counts[HERE], 0]
    return bool(then <= now - MIN_DECREASE_SHARE * way.numbers[LENGTH] * way.numbers[SLOPE])


@compiled
def take(way: Way) -> None:
    """Make the trial the mesh of the descent. The pair takes the place of the oldest, if its curvature is positive."""
    counts = way.counts
    here, slot = counts[HERE], counts[PAIRS_ADDED] % way.products.size
    before, after = way.meshes[here].reshape(-1), way.meshes[1 - here].reshape(-1)
    slope, slope_then = way.gradients[here].reshape(-1), way.gradients[1 - here].reshape(-1)
    pair = way.moves[slot], way.changes[slot]
    mixed, of_move, of_change = called_at(way.code.pair, keep_pair, (pair, before, after, slope, slope_then))
    if mixed > MIN_CURVATURE * np.sqrt(of_move * of_change):
        way.products[slot] = mixed
        counts[PAIRS_ADDED] += 1
    counts[HERE] = 1 - here
    counts[STEPS] += 1
    way.values[counts[STEPS]] = way.results[1 - here, 0]


@compiled
def is_over(way: Way) -> bool:
    """Whether all steps were taken, or the last ones lowered the objective little."""
    steps, values = way.counts[STEPS], way.values
    if steps + 1 >= values.size:
        return True
    return bool(steps >= PATIENCE and values[steps - PATIENCE] - values[steps] < PATIENCE * way.min_decrease)


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
