"""Bounds and an integral at once: what is beyond a bound is given to neighbours that have room."""

from __future__ import annotations

import numpy as np

from equimesh.meshes.cell_edges import QuadLinks
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array, IntArray, Pair
from equimesh.transfers.integrals import total

# What is beyond a bound goes to the neighbours.


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


# Rounds in which neighbours take an excess.
ROUNDS = 6
# Rounds that share out what rounding or a full cell leaves.
MAX_ROUNDS = 4


def repair(values: Array, weights: Array, lowest: Array, highest: Array, links: QuadLinks) -> None:
    """Bring values at the nodes, shape ``(n,)``, between their bounds, and keep the sum of weights times values.

    What is beyond a bound moves to the neighbours, in proportion to the room that they have. What does not find room
    there is shared out among all values (:func:`share_out`). The repair of M. Kucharik, M. Shashkov and B. Wendroff,
    J. Comput. Phys. 188 (2003). ``links`` has the cells over the nodes.
    """
    if np.all((values >= lowest) & (values <= highest)):
        return
    aim = total(weights, values)
    for _ in range(ROUNDS):
        if not give_around(values, weights, (lowest, highest), links):
            break
    np.clip(values, lowest, highest, out=values)
    share_out(values, weights, lowest, highest, aim)


def share_out(values: Array, weights: Array, lowest: Array, highest: Array, aim: float) -> None:
    """Change values within their bounds, each by the same share of its room, so that their weighted sum is ``aim``.

    Where the bounds leave too little room, the values end at the bounds.
    """
    for _ in range(MAX_ROUNDS):
        missing = aim - total(weights, values)
        room = (highest if missing > 0.0 else lowest) - values
        whole = total(weights, room)
        if missing == 0.0 or whole == 0.0:
            return
        values += min(missing / whole, 1.0) * room
        np.clip(values, lowest, highest, out=values)
