"""The cells of a mesh as bilinear quadrilaterals, the images of the unit square."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from equimesh.mesh import Mesh

Array: TypeAlias = npt.NDArray[np.float64]
Indices: TypeAlias = npt.NDArray[np.int64]

BLOCK = 1 << 16
"""Cells are visited in blocks of about this many points, to bound memory."""


@dataclass(frozen=True, eq=False)
class CellPoints:
    """Points (s, t) of the unit square with weights, and the four shape functions there: ``(points, 4)``.

    The corners run counter-clockwise from (0, 0).
    """

    s: Array
    t: Array
    weights: Array

    @classmethod
    def gauss(cls, count: int) -> CellPoints:
        """The tensor-product Gauss rule with ``count`` points per direction; the weights sum to 1."""
        nodes, weights = np.polynomial.legendre.leggauss(count)
        s, t = np.meshgrid((1.0 + nodes) / 2.0, (1.0 + nodes) / 2.0, indexing="ij")
        return cls(s.ravel(), t.ravel(), np.outer(weights, weights).ravel() / 4.0)

    @classmethod
    def samples(cls) -> CellPoints:
        """The four corners and the 2 x 2 Gauss points, where pointwise measures of a cell are taken."""
        inner = cls.gauss(2)
        s, t = np.append(inner.s, [0.0, 1.0, 1.0, 0.0]), np.append(inner.t, [0.0, 0.0, 1.0, 1.0])
        return cls(s, t, np.full(s.size, 1.0 / s.size))

    @cached_property
    def shape(self) -> Array:
        """The shape functions."""
        s, t = self.s, self.t
        return np.stack([(1 - s) * (1 - t), s * (1 - t), s * t, (1 - s) * t], axis=1)

    @cached_property
    def shape_s(self) -> Array:
        """Their derivatives along s, which runs with xi."""
        return np.stack([self.t - 1, 1 - self.t, self.t, -self.t], axis=1)

    @cached_property
    def shape_t(self) -> Array:
        """Their derivatives along t, which runs with eta."""
        return np.stack([self.s - 1, -self.s, self.s, 1 - self.s], axis=1)


@dataclass(frozen=True, eq=False)
class CellMap:
    """The bilinear map at points of some cells: position, Jacobian matrix and its determinant.

    All of shape ``(points, cells)``.
    """

    x: Array
    y: Array
    x_s: Array
    y_s: Array
    x_t: Array
    y_t: Array
    det: Array


@dataclass(frozen=True, eq=False)
class BilinearCells:
    """All cells of a mesh, numbered as in :class:`~equimesh.mesh.Mesh`."""

    mesh: Mesh

    @staticmethod
    def corners(nodal: Array) -> Array:
        """Nodal values at the corners of every cell, counter-clockwise, shape ``(4, cells)``."""
        return np.stack([nodal[:-1, :-1], nodal[1:, :-1], nodal[1:, 1:], nodal[:-1, 1:]]).reshape(4, -1)

    @property
    def shape(self) -> tuple[int, int]:
        """Cells along xi and along eta."""
        return (self.mesh.x.shape[0] - 1, self.mesh.x.shape[1] - 1)

    @property
    def count(self) -> int:
        """Number of cells."""
        return self.shape[0] * self.shape[1]

    @cached_property
    def x(self) -> Array:
        """x of the corners, shape ``(4, cells)``."""
        return self.corners(self.mesh.x)

    @cached_property
    def y(self) -> Array:
        """y of the corners, shape ``(4, cells)``."""
        return self.corners(self.mesh.y)

    @cached_property
    def dets(self) -> Array:
        """Determinant of the Jacobian matrix at the corners, shape ``(4, cells)``."""
        scaled: Array = self.mesh.corner_jacobians().reshape(4, -1)
        return scaled / self.count

    @cached_property
    def area(self) -> Array:
        """Signed area, shape ``(cells,)``."""
        mean: Array = self.dets.mean(axis=0)
        return mean

    @cached_property
    def valid(self) -> npt.NDArray[np.bool_]:
        """Whether the map is one to one, shape ``(cells,)``: a cell with a corner that is not is folded."""
        return np.asarray(self.dets.min(axis=0) > 0, dtype=np.bool_)

    def blocks(self, points: CellPoints) -> Iterator[Indices]:
        """Numbers of the valid cells, in pieces of about ``BLOCK`` points."""
        cells, size = np.flatnonzero(self.valid), max(1, BLOCK // points.s.size)
        for start in range(0, cells.size, size):
            yield cells[start : start + size]

    def at(self, points: CellPoints, cells: Indices) -> CellMap:
        """The map of ``cells`` at ``points``."""
        x, y = self.x[:, cells], self.y[:, cells]
        return CellMap(
            x=points.shape @ x,
            y=points.shape @ y,
            x_s=points.shape_s @ x,
            y_s=points.shape_s @ y,
            x_t=points.shape_t @ x,
            y_t=points.shape_t @ y,
            det=points.shape @ self.dets[:, cells],
        )
