"""How the squared metric lengths of the edges of a mesh change with its nodes."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from equimesh.equations.boundary import Boundary, SideLine, sides
from equimesh.equations.mesh_equations import EDGES, Cells
from equimesh.equations.problem import Problem
from equimesh.meshes.mesh import Mesh

Array: TypeAlias = npt.NDArray[np.float64]
Pair: TypeAlias = tuple[Array, Array]


class EdgeSlopes:
    """The derivative of the squared metric length of every edge of ``mesh``, exact for the discrete metric."""

    def __init__(self, problem: Problem, mesh: Mesh) -> None:
        equations = problem.equations()
        self._cells = Cells(equations.window(equations.vector(mesh)))
        self._spacing = problem.grid.d_xi, problem.grid.d_eta
        self._sides = []
        # An orthogonal side follows the interior: the lengths of its edges are nobody's data.
        if problem.boundary is not Boundary.ORTHOGONAL:
            for side in sides(problem.boundary).values():
                line = SideLine.of(side, problem.metric, side.line((mesh.x, mesh.y)[1 - side.axis]))
                self._sides.append((side, line.flux_derivatives))

    def along(self, change: Pair) -> Pair:
        """Of the xi-edges, shape ``(n_xi - 1, n_eta)``, and of the eta-edges, when the nodes move by ``change``."""
        n_xi, n_eta = change[0].shape
        found = np.zeros((n_xi - 1, n_eta)), np.zeros((n_xi, n_eta - 1))
        halves = [self._half(edge, change) for edge in range(len(EDGES))]
        found[0][:, 1:-1] = self._spacing[0] ** 2 * (halves[1][:, :-1] + halves[0][:, 1:])
        found[1][1:-1] = self._spacing[1] ** 2 * (halves[3][:-1] + halves[2][1:])
        for side, (by_first, by_second) in self._sides:
            moved = side.line(change[1 - side.axis])
            side.line(found[1 - side.axis])[:] = by_first * moved[:-1] + by_second * moved[1:]
        return found

    def _half(self, edge: int, change: Pair) -> Array:
        """The change of the fluxes through one edge of every cell."""
        found = np.zeros_like(self._cells.centre[0])
        for corner, by_node in enumerate(self._cells.flux_derivatives[edge]):
            for by, moved in zip(by_node, change, strict=True):
                found += by * self._cells.corner(moved, corner)
        return found
