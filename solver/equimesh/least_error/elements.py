"""Elements on which the error is measured: bilinear quadrilaterals, or the triangles of a cut mesh."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Literal, TypeAlias

import numpy as np

from equimesh.least_error.kernels import Element, Nodes
from equimesh.numerics.types import IntArray
from equimesh.quality.cells import CellPoints
from equimesh_coupling.parts import ANYWHERE, CUTS, better_cuts

Norm: TypeAlias = Literal["l2", "h1"]
CellKind: TypeAlias = Literal["quad", "triangle"]

TRIANGLE_RULE = (
    (0.445948490915964886, 0.223381589678011466),
    (0.091576213509770743, 0.109951743655321868),
)
"""Two orbits of the rule of degree 4 with six points: the barycentric coordinate that occurs twice, and the weight.

D. A. Dunavant, *High degree efficient symmetrical Gaussian quadrature rules for the triangle*, Int. J. Numer. Meth.
Eng. 21 (1985). The rule is exact for the squared error of a quadratic u.
"""


@dataclass(frozen=True, kw_only=True)
class Rule:
    """The norm of the error, the cells on which it is measured, and Gauss points a direction on quadrilaterals."""

    norm: Norm = "l2"
    cells: CellKind = "quad"
    points: int = 3

    @cached_property
    def element(self) -> Element:
        """The reference element with its quadrature."""
        return quadrilateral(self.points) if self.cells == "quad" else triangle()

    @property
    def points_per_cell(self) -> int:
        """Quadrature points of a quadrilateral."""
        return self.element.weights.size * (1 if self.cells == "quad" else 2)

    def elements(self, count: int, nodes: Nodes | None = None, through: Mapping[int, int] = ANYWHERE) -> IntArray:
        """The corners, ``4 cell + corner``, of the elements of ``count`` cells, shape ``(elements, 4 or 3)``.

        Triangles are those of the better cut of the cells with ``nodes``, or of the first. The cells in ``through``
        have the cut given there.
        """
        if self.cells == "quad":
            return np.arange(4 * count).reshape(count, 4)
        cuts = (
            np.zeros(count, dtype=np.int64)
            if nodes is None
            else better_cuts(np.stack([nodes.x, nodes.y], axis=-1)[nodes.corners].reshape(-1, 4, 2), through)
        )
        triangles: IntArray = CUTS[cuts] + 4 * np.arange(count)[:, None, None]
        return triangles.reshape(-1, 3)


@cache
def quadrilateral(points: int) -> Element:
    """The bilinear element with the Gauss rule of this many ``points`` a direction."""
    s, t, weights = CellPoints.gauss(points)
    return Element(
        shape=np.stack([(1 - s) * (1 - t), s * (1 - t), s * t, (1 - s) * t], axis=1),
        along_s=np.stack([t - 1, 1 - t, t, -t], axis=1),
        along_t=np.stack([s - 1, -s, s, 1 - s], axis=1),
        weights=weights,
    )


@cache
def triangle() -> Element:
    """The linear element with the rule of degree 4."""
    shape, weights = [], []
    for twice, weight in TRIANGLE_RULE:
        for k in range(3):
            shape.append([1.0 - 2.0 * twice if corner == k else twice for corner in range(3)])
            weights.append(0.5 * weight)
    return Element(
        shape=np.array(shape),
        along_s=np.tile([-1.0, 1.0, 0.0], (len(weights), 1)),
        along_t=np.tile([-1.0, 0.0, 1.0], (len(weights), 1)),
        weights=np.array(weights),
    )
