"""Least error in subdomains that several parts of a computation hold: the first one leads, the others follow.

The leader solves the coarse meshes and measures. The others wait until the finest mesh is reached, and descend in their
subdomains.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from equimesh.least_error.cells import Region
from equimesh.least_error.objective import Objective
from equimesh.least_error.restricted import RestrictedDescent, Subdomains
from equimesh.numerics.types import Array, IntArray
from equimesh.solving.solve import MinimiseError
from equimesh_cluster.messages import Channel, gather, joined

LEADER = 0
"""The number of the part that leads."""
BEGIN = "begin"
"""The tag of a message with which a descent begins: the weights, and two meshes; none of them is the end."""


def holders(regions: Sequence[Region], parts: int) -> list[int]:
    """The part that holds each region: consecutive ones, with about as many cells for each part."""
    cells = np.array([region.own_cells for region in regions], dtype=float)
    middle = np.cumsum(cells) - 0.5 * cells
    found = np.minimum((middle * parts / cells.sum()).astype(int), parts - 1)
    # Every part holds a region where there are enough of them.
    for k in range(len(regions)):
        found[k] = min(max(found[k], parts - len(regions) + k, 0), k if k < parts else parts - 1)
    return [int(part) for part in np.maximum.accumulate(found)]


class PartDescent(RestrictedDescent):
    """The regions of a mesh that one part holds.

    All parts of ``channel`` make the same calls in the same order. Each has an array of the whole mesh, in which the
    nodes of its own regions are right. The meshes do not depend on the number of parts.
    """

    def __init__(self, objective: Objective, regions: Sequence[Region], threads: int, channel: Channel) -> None:
        self._channel, self._holders = channel, holders(regions, channel.count)
        here = [k for k, part in enumerate(self._holders) if part == channel.number]
        super().__init__(objective, regions, threads, here)

    def whole(self, mesh: Array) -> Array:
        """The mesh with all nodes right, in every part."""
        if self._channel.count == 1:
            return mesh
        whole, owned = mesh.copy(), [self._owned(k) for k in range(len(self._regions))]
        mine = [mesh[:, owned[k]] for k in self._here] or [np.empty((2, 0))]
        every = gather(self._channel, "nodes", [np.concatenate(mine, axis=1)])
        for part, (nodes,) in enumerate(every):
            numbers = [owned[k] for k, holder in enumerate(self._holders) if holder == part]
            if numbers:
                whole[:, np.concatenate(numbers)] = nodes
        return whole

    def _joined(self, found: Array) -> Array:
        return joined(self._channel, found)

    def _complete(self, moves: Array) -> None:
        """Send the moves that other parts need of nodes owned here, and receive theirs."""
        others = [part for part in range(self._channel.count) if part != self._channel.number]
        for part in others:
            numbers = self._shared(self._channel.number, part)
            if numbers.size:
                self._channel.send(part, "moves", [moves[:, numbers]])
        for part in others:
            numbers = self._shared(part, self._channel.number)
            if numbers.size:
                moves[:, numbers] = self._channel.receive(part, "moves")[0]

    def _shared(self, owner: int, reader: int) -> IntArray:
        """The nodes that regions of one part own and regions of another one read, in ascending order."""
        owned = [self._owned(k) for k, part in enumerate(self._holders) if part == owner]
        read = [self._regions[k].nodes for k, part in enumerate(self._holders) if part == reader]
        if not (owned and read):
            return np.empty(0, dtype=np.int64)
        return np.intersect1d(np.concatenate(owned), np.unique(np.concatenate(read)))


@dataclass(frozen=True, kw_only=True)
class PartSubdomains(Subdomains):
    """Subdomains that the parts of ``channel`` hold."""

    channel: Channel

    def begin(self, weights: Sequence[float], start: Array, first: Array) -> None:
        """Let the other parts begin a descent, where this one leads."""
        if self.channel.number == LEADER:
            self._tell(np.array(weights), start, first)

    def dismiss(self) -> None:
        """Let the other parts end."""
        self._tell(np.empty(0), np.empty(0), np.empty(0))

    def orders(self) -> Iterator[tuple[list[float], Array, Array]]:
        """The weights of each descent that the leader begins, what it is relative to, and its first mesh."""
        while True:
            weights, start, first = self.channel.receive(LEADER, BEGIN)
            if not first.size:
                return
            yield weights.tolist(), np.ascontiguousarray(start), np.ascontiguousarray(first)

    def _restricted(self, objective: Objective, regions: Sequence[Region], threads: int) -> RestrictedDescent:
        return PartDescent(objective, regions, threads, self.channel)

    def _tell(self, *arrays: Array) -> None:
        for part in range(self.channel.count):
            if part != LEADER:
                self.channel.send(part, BEGIN, list(arrays))


@dataclass(frozen=True, kw_only=True)
class PartMinimiseError(MinimiseError):
    """Descent on the error in subdomains that the parts of ``channel`` hold."""

    channel: Channel

    @property
    def subdomains(self) -> Subdomains | None:
        """The subdomains of the finest mesh."""
        return None if self.schwarz is None else PartSubdomains(settings=self.schwarz, channel=self.channel)
