"""The rows of a mesh that one process holds: its own, and those next to them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from equimesh.meshes.grid import Grid
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.parts import row_cuts
from equimesh.numerics.channel import Channel
from equimesh.numerics.types import Array


@dataclass(frozen=True, eq=False)
class HeldMesh:
    """The rows ``begin`` to ``end - 1`` of a mesh on ``grid``: ``x`` and ``y`` of shape ``(end - begin, n_eta)``."""

    grid: Grid
    begin: int
    x: Array
    y: Array

    @classmethod
    def of(cls, mesh: Mesh) -> HeldMesh:
        """All rows of a mesh."""
        return cls(mesh.grid, 0, np.ascontiguousarray(mesh.x), np.ascontiguousarray(mesh.y))

    @property
    def end(self) -> int:
        """The row after the last one that is held."""
        return self.begin + len(self.x)

    @property
    def ends(self) -> tuple[int, int]:
        """The first row that is held, and the one after the last."""
        return self.begin, self.end

    @property
    def is_whole(self) -> bool:
        """Whether these are all rows of the grid."""
        return len(self.x) == self.grid.n_xi

    def window(self, begin: int, end: int) -> HeldMesh:
        """The rows ``begin`` to ``end - 1`` of these, in the same memory."""
        rows = slice(begin - self.begin, end - self.begin)
        return HeldMesh(self.grid, begin, self.x[rows], self.y[rows])

    def with_rows(self, wanted: Sequence[tuple[int, int]], channel: Channel) -> HeldMesh:
        """The own rows of this process, and those that it wants, from the processes that own them.

        ``wanted`` are the first row that every process wants, and the one after the last. Every process calls this.
        """
        cuts, here = row_cuts(self.grid.shape, channel.count), channel.number
        own = list(pairwise(cuts))
        ranges = [(min(rows[0], kept[0]), max(rows[1], kept[1])) for rows, kept in zip(wanted, own, strict=True)]
        for other, rows in enumerate(ranges):
            begin, end = max(rows[0], own[here][0]), min(rows[1], own[here][1])
            if other != here and begin < end:
                sent = self.window(begin, end)
                channel.send(other, "rows", [sent.x, sent.y])
        mine, pieces = self.window(*own[here]), list[Sequence[Array]]()
        for other, rows in enumerate(own):
            begin, end = max(ranges[here][0], rows[0]), min(ranges[here][1], rows[1])
            if other == here:
                pieces.append((mine.x, mine.y))
            elif begin < end:
                pieces.append(channel.receive(other, "rows"))
        x, y = (np.concatenate(rows) for rows in zip(*pieces, strict=True))
        return HeldMesh(self.grid, ranges[here][0], x, y)
