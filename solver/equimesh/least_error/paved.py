"""Descent on meshes without blocks to coarsen: by smooth displacements from coarse to fine, then of all nodes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from equimesh.least_error.background import Background, Boundary, background_counts
from equimesh.least_error.block_levels import COARSEST_CELLS
from equimesh.least_error.cells import Cells
from equimesh.least_error.charts import CurveChart
from equimesh.least_error.descent import descend
from equimesh.least_error.objective import Evaluation, Objective
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.numerics.types import Array

FEWEST_POINTS = 300
"""Points of a mesh, at least: fewer need no displacements that are smooth."""
FIRST_GRID = 4
"""Cells along the longer side of the coarsest background grid."""
FEWEST_NODES = 9.0
"""Nodes in a cell of the finest background grid."""
GRID_STEPS = 12
"""Steps of descent on each background grid, at most."""
NODE_STEPS = 20
"""Steps of descent of the nodes, at most."""


def is_paved(mesh: QuadMesh) -> bool:
    """Whether the blocks of a mesh are too small for coarser meshes: fewer cells than these have in the mean."""
    few = len(mesh.cells) < COARSEST_CELLS**2 * len(mesh.blocks)
    return few and len(mesh.points) > FEWEST_POINTS and not mesh.ties.size


def paved_steps(nodes: int, more: float) -> int:
    """The largest number of steps of :func:`descend_paved`, with ``more`` times the usual steps."""
    grids = background_counts(nodes, FIRST_GRID, FEWEST_NODES)
    return round(GRID_STEPS * more) * len(grids) + round(NODE_STEPS * more)


def descend_paved(
    objective: Objective, chart: CurveChart, initial: Array, first: Array, min_decrease: float, more: float
) -> Iterator[tuple[Array, Evaluation]]:
    """The meshes of the descent, as :func:`~equimesh.least_error.descent.descend` has them."""
    points = np.stack(chart.nodes(initial))
    boundary = Boundary(chart, initial, objective.cells.corners)
    now, is_first = first, True
    for cells in background_counts(points.shape[1], FIRST_GRID, FEWEST_NODES):
        smooth = Smooth(objective, Background(boundary, points, cells), now)
        steps = descend(smooth, smooth.zero, round(GRID_STEPS * more), min_decrease)
        for number, (coefficients, then) in enumerate(steps):
            now = smooth.unknowns(coefficients)
            if number > 0 or is_first:
                yield now, then
        is_first = False
    for number, found in enumerate(descend(objective, now, round(NODE_STEPS * more), min_decrease)):
        if number > 0 or is_first:
            yield found


class Smooth:
    """An objective as a function of the coefficients of a ``background``, which move the nodes from ``start``."""

    def __init__(self, objective: Objective, background: Background, start: Array) -> None:
        self._objective, self._background, self._start = objective, background, start
        self.zero = start[:, : background.count] * 0.0
        """The coefficients of ``start``, shape ``(2, count)``."""

    @property
    def cells(self) -> Cells:
        """The cells of the mesh."""
        return self._objective.cells

    @property
    def length(self) -> float:
        """As many spacings of the background as the domain has cells along a side."""
        return float(self._background.spacing * self.cells.count**0.5)

    def unknowns(self, coefficients: Array) -> Array:
        """The unknowns of the mesh."""
        return self._start + self._background.moves(coefficients)

    def cut(self, mesh: Array) -> bool:
        """Cut triangles anew; whether the cuts are others than before."""
        return self._objective.cut(self.unknowns(mesh))

    def tie(self, direction: Array) -> None:
        """Nothing: no nodes are tied."""

    def smallest_share(self, mesh: Array) -> float:
        """The smallest Jacobian of a corner over that of the start; not positive for a folded mesh."""
        return self._objective.smallest_share(self.unknowns(mesh))

    def evaluate(self, mesh: Array) -> Evaluation | None:
        """The objective with its derivatives by the coefficients; ``None`` where it has none."""
        found = self._objective.evaluate(self.unknowns(mesh))
        if found is None:
            return None
        background = self._background
        return replace(found, gradient=background.pulled_back(found.gradient), blocks=background.blocks(found.blocks))
