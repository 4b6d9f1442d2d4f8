"""The sum, the largest and the smallest of the edges of every xi-line, from processes that hold some of its rows.

Sums are added up the tree of :mod:`equimesh.meshes.strips`: they do not depend on the number of processes, to the last
bit. Each process sends one message, with the sums of a few nodes of the tree.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from equimesh.meshes.strips import Node, nodes_inside
from equimesh.numerics.channel import Channel
from equimesh.numerics.gather import joined
from equimesh.numerics.types import Array

TAG = "lines"
"""The tag of the messages."""


def line_extremes(channel: Channel, strips: Array) -> Array | None:
    """The sums, the largest and the smallest numbers of all strips, of shape ``(3, n)``, in the first process.

    ``strips`` of shape ``(strips, 3, n)`` are those of the own strips. The other processes get ``None``.
    """
    counts = joined(channel, np.array([float(len(strips))])).astype(np.int64)
    ends, number = [0, *np.cumsum(counts).tolist()], channel.number
    whole, first = ends[-1], ends[number]
    known = {(first + k, first + k + 1): strip for k, strip in enumerate(strips[:, 0])}
    high, low = strips[:, 1].max(axis=0, initial=-np.inf), strips[:, 2].min(axis=0, initial=np.inf)
    step = 1
    while step < channel.count:
        last = ends[min(number + step, channel.count)]
        if number % (2 * step):
            sums = [_sum(known, node) for node in nodes_inside(whole, first, last)]
            channel.send(number - step, TAG, [*sums, high, low])
            return None
        if number + step < channel.count:
            *sums, others_high, others_low = channel.receive(number + step, TAG)
            nodes = nodes_inside(whole, last, ends[min(number + 2 * step, channel.count)])
            known |= _by_ends(nodes, sums)
            high, low = np.maximum(high, others_high), np.minimum(low, others_low)
        step *= 2
    return np.stack([_sum(known, Node.of(0, whole)), high, low])


def _by_ends(nodes: Iterable[Node], sums: Iterable[Array]) -> dict[tuple[int, int], Array]:
    return {(node.first, node.last): found for node, found in zip(nodes, sums, strict=True)}


def _sum(known: dict[tuple[int, int], Array], node: Node) -> Array:
    """The sum of a node, from the ``known`` ones inside."""
    found = known.get((node.first, node.last))
    if found is not None:
        return found
    return _sum(known, Node.of(node.first, node.middle)) + _sum(known, Node.of(node.middle, node.last))
