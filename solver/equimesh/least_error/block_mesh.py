"""One of the nested meshes of a domain in blocks: its chart, its cells, and places of its nodes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from equimesh.blocks.blocks import Blocks
from equimesh.least_error.block_levels import BlockLevel
from equimesh.least_error.cells import Cells
from equimesh.least_error.charts import CurveChart
from equimesh.least_error.lifting import Lifting
from equimesh.least_error.mending import SMALLEST_SHARE, mended
from equimesh.least_error.objective import Objective
from equimesh.least_error.quad_cells import cells_of_mesh
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.numerics.types import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class BlockMesh:
    """A level of a ``domain``."""

    domain: Blocks
    level: BlockLevel
    chart: CurveChart
    cells: Cells

    @classmethod
    def of(cls, domain: Blocks, level: BlockLevel, *, are_cut: bool = False) -> BlockMesh:
        """That of a level; ``are_cut`` tells whether triangles of its cells are used."""
        nodes = level.nodes
        chart = CurveChart(domain.curves, domain.node_curve[nodes], domain.node_parameter[nodes], domain.area)
        cells = cells_of_mesh(level.cells, chart.free, level.ties, are_cut=are_cut)
        return cls(domain=domain, level=level, chart=chart, cells=cells)

    @cached_property
    def first(self) -> Place:
        """The initial mesh of the domain."""
        return self._place(self.domain.mesh.points, self.domain.node_parameter)

    def of_points(self, points: Array) -> Place:
        """The nodes of the level, where those of the finest mesh are at ``points``, shape ``(n, 2)``.

        Nodes of curves are at the nearest points of these; beyond the end of one, as at a periodic join that has
        moved, on its tangent there.
        """
        parameters = self.domain.node_parameter.copy()
        for number, curve in enumerate(self.domain.curves):
            nodes = self.level.nodes[self.domain.node_curve[self.level.nodes] == number]
            if nodes.size:
                first, last = curve.ends
                x, y = points[nodes].T
                nearest = curve.nearest(x, y)
                if self.domain.mesh.ties.size and not curve.closed:
                    at_x, at_y, x_t, y_t = curve.evaluate(nearest)
                    nearest = nearest + ((x - at_x) * x_t + (y - at_y) * y_t) / (x_t**2 + y_t**2)
                moves = nearest - parameters[nodes]
                turns = np.round(moves / (last - first)) if curve.closed else 0.0
                parameters[nodes] += moves - turns * (last - first)
        return self._place(points, parameters)

    def _place(self, points: Array, parameters: Array) -> Place:
        here = np.ascontiguousarray(points[self.level.nodes].T)
        return Place(mesh=self, unknowns=self.chart.unknowns(here, parameters[self.level.nodes]))


@dataclass(frozen=True, kw_only=True, eq=False)
class Place:
    """Where the nodes of a ``mesh`` are."""

    mesh: BlockMesh
    unknowns: Array
    """Those of the chart, shape ``(2, nodes)``."""

    @property
    def points(self) -> Array:
        """The nodes, shape ``(2, nodes)``."""
        return np.stack(self.mesh.chart.nodes(self.unknowns))

    @property
    def parameters(self) -> Array:
        """The parameters of nodes on curves, shape ``(nodes,)``."""
        return self.mesh.chart.parameters(self.unknowns)

    def lifted(self, fine: BlockMesh, objective: Objective) -> Place:
        """The same on a finer mesh: displacements by cubic interpolation.

        Where these fold, by the smallest share of a corner, they are mended. Linear interpolation of displacements,
        mended, too, and that of positions are tried then, and the mesh with the smallest error is taken. It is the
        initial mesh where all of them fold even so. Meshes that cut too much off the domain are moved back.
        """
        there, tried = fine.first, []
        for share, cubic in ((1.0, True), (1.0, False), (0.0, False)):
            unknowns = objective.held(self._interpolated(fine, share, cubic=cubic))
            smallest = objective.smallest_share(unknowns)
            if share > 0.0 and smallest <= SMALLEST_SHARE:
                unknowns = objective.held(mended(fine.chart, fine.cells, there.unknowns, unknowns))
            elif cubic:
                return Place(mesh=fine, unknowns=unknowns)
            if objective.smallest_share(unknowns) > 0.0:
                tried.append(unknowns)
        return Place(mesh=fine, unknowns=min(tried, key=objective.error)) if tried else there

    def _interpolated(self, fine: BlockMesh, share: float, *, cubic: bool) -> Array:
        """The unknowns of a finer mesh, from the positions less ``share`` times those of the initial mesh."""
        lifting, first, there = Lifting(self.mesh.level, fine.level), self.mesh.first, fine.first
        moves = lifting.lifted(self.points - share * first.points, cubic=cubic)
        along = lifting.lifted_along_sides(self.parameters - first.parameters, cubic=cubic)
        return fine.chart.unknowns(share * there.points + moves, there.parameters + along)

    def quad_mesh(self, finest: QuadMesh) -> QuadMesh:
        """As a mesh; that of the finest level has the cells, sides and blocks of ``finest``."""
        level, points = self.mesh.level, np.ascontiguousarray(self.points.T)
        if level.is_finest:
            return finest.moved(points)
        return replace(finest, points=points, cells=level.cells, sides={}, blocks=level.blocks, ties=level.ties)
