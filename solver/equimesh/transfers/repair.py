"""Bounds and an integral at once: what is beyond a bound is given to neighbours that have room."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from equimesh.meshes.cell_edges import QuadLinks
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array, IntArray, Pair
from equimesh.transfers.integrals import Cells, QuadCells, total

# What is beyond a bound goes to the neighbours, on a mesh of quadrilaterals.


@compiled
def give_around(values: Array, weights: Array, bounds: Pair, links: QuadLinks) -> bool:
    """Move what is beyond a bound to the nodes of the cells around; returns whether something was beyond.

    All arrays have the shape ``(n,)``. Each neighbour gets a share in proportion to its room. What finds none stays.
    """
    lowest, highest = bounds
    beyond, some = np.zeros(values.size), False
    for node in range(values.size):
        u = values[node]
        kept = min(max(u, lowest[node]), highest[node])
        if kept != u:
            beyond[node], values[node], some = weights[node] * (u - kept), kept, True
    if not some:
        return False
    seen = np.full(values.size, -1, dtype=np.int64)
    ring = np.empty(values.size, dtype=np.int64)
    for node in range(values.size):
        amount = beyond[node]
        if amount == 0.0:
            continue
        count = nodes_around(node, links, seen, ring)
        ends = highest if amount > 0.0 else lowest
        whole = 0.0
        for k in range(count):
            whole += weights[ring[k]] * (ends[ring[k]] - values[ring[k]])
        share = 0.0 if whole == 0.0 else min(amount / whole, 1.0)
        if share > 0.0:
            for k in range(count):
                values[ring[k]] += share * (ends[ring[k]] - values[ring[k]])
        values[node] += (amount - share * whole) / weights[node]
    return True


@compiled
def nodes_around(node: int, links: QuadLinks, seen: IntArray, ring: IntArray) -> int:
    """The nodes of the cells around a node, itself included, in ``ring``; returns how many there are."""
    count = 0
    for at in range(links.starts[node], links.starts[node + 1]):
        for corner in range(4):
            other = links.cells[links.places[at] // 4, corner]
            if seen[other] != node:
                seen[other] = node
                ring[count] = other
                count += 1
    return count


# How far, in cells, the neighbours are that take an excess, in the rounds of a repair.
REACHES = (1, 1, 2, 2)
# Rounds that share out what rounding or a full cell leaves.
MAX_ROUNDS = 4


Giving: TypeAlias = Callable[[Array, Array, Array, Array, int], bool]
"""Moves what is beyond a bound to values at most so far away; returns whether something was beyond."""


def repair(values: Array, weights: Array, lowest: Array, highest: Array, give: Giving | None = None) -> None:
    """Bring values, shape ``(rows, columns)``, between their bounds, and keep the sum of weights times values.

    On a mesh that is no grid the values are flat, and ``give`` knows the neighbours: see :func:`giving_of`.

    What is beyond a bound moves to the neighbours, in proportion to the room that they have. What does not find room
    there is shared out among all values (:func:`share_out`). The repair of M. Kucharik, M. Shashkov and B. Wendroff,
    J. Comput. Phys. 188 (2003).
    """
    if np.all((values >= lowest) & (values <= highest)):
        return
    aim = total(weights.reshape(-1), values.reshape(-1))
    give = give_to_neighbours if give is None else give
    for reach in REACHES:
        if not give(values, weights, lowest, highest, reach):
            break
    np.clip(values, lowest, highest, out=values)
    share_out(values, weights, lowest, highest, aim)


def share_out(values: Array, weights: Array, lowest: Array, highest: Array, aim: float) -> None:
    """Change values within their bounds, each by the same share of its room, so that their weighted sum is ``aim``.

    Where the bounds leave too little room, the values end at the bounds.
    """
    for _ in range(MAX_ROUNDS):
        missing = aim - total(weights.reshape(-1), values.reshape(-1))
        room = (highest if missing > 0.0 else lowest) - values
        whole = total(weights.reshape(-1), room.reshape(-1))
        if missing == 0.0 or whole == 0.0:
            return
        values += min(missing / whole, 1.0) * room
        np.clip(values, lowest, highest, out=values)


def giving_of(cells: Cells | QuadCells) -> Giving:
    """The way from the nodes of a mesh to their neighbours."""
    if isinstance(cells, Cells):
        return give_to_neighbours
    cells_of_nodes = cells.links

    def give(values: Array, weights: Array, lowest: Array, highest: Array, reach: int) -> bool:
        was_beyond = False
        for _ in range(reach):
            was_beyond = give_around(values, weights, (lowest, highest), cells_of_nodes) or was_beyond
        return was_beyond

    return give


@compiled
def give_to_neighbours(values: Array, weights: Array, lowest: Array, highest: Array, reach: int) -> bool:
    """Move what is beyond a bound to values at most ``reach`` away; returns whether something was beyond."""
    rows, columns = values.shape
    beyond = np.zeros((rows, columns))
    some = False
    for i in range(rows):
        for j in range(columns):
            u = values[i, j]
            kept = min(max(u, lowest[i, j]), highest[i, j])
            if kept != u:
                beyond[i, j], values[i, j], some = weights[i, j] * (u - kept), kept, True
    if not some:
        return False
    for i in range(rows):
        for j in range(columns):
            amount = beyond[i, j]
            if amount == 0.0:
                continue
            whole = 0.0
            for r in range(max(i - reach, 0), min(i + reach + 1, rows)):
                for c in range(max(j - reach, 0), min(j + reach + 1, columns)):
                    end = highest[r, c] if amount > 0.0 else lowest[r, c]
                    whole += weights[r, c] * (end - values[r, c])
            share = 0.0 if whole == 0.0 else min(amount / whole, 1.0)
            if share > 0.0:
                for r in range(max(i - reach, 0), min(i + reach + 1, rows)):
                    for c in range(max(j - reach, 0), min(j + reach + 1, columns)):
                        end = highest[r, c] if amount > 0.0 else lowest[r, c]
                        values[r, c] += share * (end - values[r, c])
            values[i, j] += (amount - share * whole) / weights[i, j]
    return True
