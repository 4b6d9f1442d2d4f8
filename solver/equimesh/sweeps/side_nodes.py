"""The positions of the nodes along the four sides, in full, also where many processes hold the rows of a grid."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from equimesh.meshes.parts import Parts
from equimesh.numerics.communicator import gather
from equimesh.numerics.types import Array


class SideNodes(NamedTuple):
    """Positions along the sides: y on the left and right, ``(2, n_eta)``; x on the bottom and top, ``(2, n_xi)``."""

    along_eta: Array
    along_xi: Array

    @classmethod
    def of(cls, x: Array, y: Array) -> SideNodes:
        """The sides of a whole mesh."""
        n_xi, n_eta = x.shape
        return cls(y[:: n_xi - 1].copy(), x.T[:: n_eta - 1].copy())

    @classmethod
    def gathered(cls, x: Array, y: Array, parts: Parts) -> SideNodes:
        """The sides of a mesh, of which every process holds some rows; each of them sends its own to all."""
        first, last = parts.own.first - parts.begin, parts.own.last - parts.begin
        left = y[0] if parts.begin == 0 else np.empty(0)
        right = y[-1] if parts.end == parts.shape[0] else np.empty(0)
        bottom, top = x[first:last, 0], x[first:last, -1]
        pieces = zip(*gather(parts.channel, "sides", [left, right, bottom, top]), strict=True)
        left, right, bottom, top = (np.concatenate(piece) for piece in pieces)
        return cls(np.stack([left, right]), np.stack([bottom, top]))

    def moved(self, along_eta: Array, along_xi: Array) -> SideNodes:
        """The positions after these moves."""
        return SideNodes(self.along_eta + along_eta, self.along_xi + along_xi)
