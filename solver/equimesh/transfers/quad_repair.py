"""What is beyond a bound goes to the neighbours, on a mesh of quadrilaterals."""

import numpy as np

from equimesh.meshes.quad_links import QuadLinks
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array, IntArray, Pair


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
