"""The nested meshes of a domain in blocks: their charts, their cells, places of their nodes, and first meshes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from equimesh.blocks.blocks import Blocks
from equimesh.blocks.curves import Line
from equimesh.fields.expression import Field
from equimesh.least_error import kernels
from equimesh.least_error.block_levels import (
    COARSEST_POINTS,
    COARSEST_REGULAR_POINTS,
    BlockLevel,
    Families,
    block_levels,
    only_level,
)
from equimesh.least_error.cells import Cells, cells_of_mesh
from equimesh.least_error.charts import CurveChart
from equimesh.least_error.kernels import Norm
from equimesh.least_error.lifting import SMALLEST_SHARE, Lifting, along, mended
from equimesh.least_error.objective import Objective
from equimesh.least_error.paved import is_paved
from equimesh.least_error.restricted import owners
from equimesh.least_error.starts import Patch, equidistributed, resampled
from equimesh.meshes.cell_edges import originals_of
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array, IntArray
from equimesh.schwarz.settings import Schwarz
from equimesh_coupling.parts import cuts_at_corners

MAX_TRIED_POINTS = 257 * 257
"""Points of a mesh, at most, for which several meshes from a coarser one are compared."""


@dataclass(frozen=True, kw_only=True, eq=False)
class BlockMesh:
    """A level of a ``domain``."""

    domain: Blocks
    level: BlockLevel
    chart: CurveChart
    cells: Cells

    @classmethod
    def of(cls, domain: Blocks, level: BlockLevel) -> BlockMesh:
        """The mesh of a level, with its chart and its cells."""
        nodes = level.nodes
        chart = CurveChart(domain.curves, domain.node_curve[nodes], domain.node_parameter[nodes], domain.area)
        cells = cells_of_mesh(level.cells, chart.free, level.ties)
        return cls(domain=domain, level=level, chart=chart, cells=cells)

    @cached_property
    def first(self) -> Place:
        """The initial mesh of the domain."""
        return self._place(self.domain.mesh.points, self.domain.node_parameter)

    @cached_property
    def quad_mesh(self) -> Mesh:
        """The cells and blocks, which all meshes of the level have, at the nodes of the initial mesh."""
        level, finest = self.level, self.domain.mesh
        if level.is_finest:
            return finest
        points, names = finest.points[level.nodes], finest.block_names
        return Mesh(points=points, cells=level.cells, sides={}, blocks=level.blocks, block_names=names, ties=level.ties)

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


@dataclass(frozen=True, eq=False)
class Place:
    """Where the nodes of a ``mesh`` are."""

    mesh: BlockMesh
    unknowns: Array
    """The unknowns of the chart, shape ``(2, nodes)``."""

    @property
    def points(self) -> Array:
        """The nodes, shape ``(2, nodes)``."""
        return self.mesh.chart.at(self.unknowns)

    @property
    def parameters(self) -> Array:
        """The parameters of nodes on curves, shape ``(nodes,)``."""
        return self.mesh.chart.parameters(self.unknowns)

    def lifted(self, first: Place, there: Place, objective: Objective, *, is_regular: bool = False) -> Place:
        """This place on a finer mesh: its displacements from ``first`` by cubic interpolation, added to ``there``.

        Where these fold, by the smallest share of a corner, they are mended. Linear interpolation of displacements,
        mended, too, and that of positions are tried then, and the mesh with the smallest error is taken. It is the
        mesh ``there`` where all of them fold even so. Meshes that cut too much off the domain are moved back. On a
        regular domain, and on a fine mesh, the first of the three that does not fold is taken, as on a grid.
        """
        fine, tried, lifting = there.mesh, list[Array](), Lifting(self.mesh.level, there.mesh.level)
        for share, cubic in ((1.0, True), (1.0, False), (0.0, False)):
            unknowns = objective.held(self._interpolated(lifting, first, there, share, cubic=cubic))
            smallest = objective.smallest_share(unknowns)
            is_mended = share > 0.0 and smallest <= SMALLEST_SHARE and not is_regular
            if is_mended:
                unknowns = objective.held(mended(fine.chart, fine.cells, there.unknowns, unknowns))
                smallest = objective.smallest_share(unknowns)
            if smallest > 0.0:
                tried.append(unknowns)
                if is_regular or fine.level.points > MAX_TRIED_POINTS or (cubic and not is_mended):
                    break
        if not tried:
            return there
        return Place(mesh=fine, unknowns=tried[0] if len(tried) == 1 else min(tried, key=objective.error))

    def _interpolated(self, lifting: Lifting, first: Place, there: Place, share: float, *, cubic: bool) -> Array:
        """The unknowns of a finer mesh, from the positions less ``share`` times those of the first mesh."""
        moves = lifting.lifted(self.points - share * first.points, cubic=cubic)
        along = lifting.lifted_along_sides(self.parameters - first.parameters, cubic=cubic)
        return there.mesh.chart.unknowns(share * there.points + moves, there.parameters + along)

    @property
    def quad_mesh(self) -> Mesh:
        """A mesh of its nodes; on the finest level it has the cells, sides and blocks of the domain."""
        return self.mesh.quad_mesh.moved(np.ascontiguousarray(self.points.T))


@dataclass(frozen=True, kw_only=True, eq=False)
class BlockStart:
    """The first meshes on the levels of a domain in blocks."""

    name: str
    lines: tuple[Array, ...] | None = None
    """The positions, 0 to 1, of the straight lines of each family; ``None`` for those of the initial mesh."""
    starts: dict[int, Array] = field(default_factory=dict, repr=False)
    """First meshes that are known, by the numbers of their levels."""

    @property
    def is_uniform(self) -> bool:
        """Whether the first meshes are the initial ones, but for those that are known."""
        return self.lines is None


@dataclass(frozen=True, kw_only=True, eq=False)
class BlockNest:
    """The nested meshes of a ``domain`` in blocks, as a :class:`~equimesh.least_error.nest.Nest`."""

    domain: Blocks
    is_nested: bool = False
    """Whether coarser meshes are taken even where blocks are too small for good ones."""
    _meshes: dict[int, BlockMesh] = field(default_factory=dict, init=False, repr=False)

    @cached_property
    def levels(self) -> list[BlockLevel]:
        """The nested meshes."""
        if self.is_paved:
            return [only_level(self.domain.mesh)]
        coarsest = COARSEST_REGULAR_POINTS if self.is_regular else COARSEST_POINTS
        return block_levels(self.domain.mesh, self.families, coarsest)

    @cached_property
    def families(self) -> Families:
        """The families of lines."""
        return Families(self.domain.mesh)

    @cached_property
    def is_paved(self) -> bool:
        """Whether the blocks are too small for coarser meshes. Smooth displacements are in their place then."""
        return not self.is_nested and is_paved(self.domain.mesh)

    @property
    def finest_cells(self) -> int:
        """Cells of the domain."""
        return len(self.domain.mesh.cells)

    @cached_property
    def is_regular(self) -> bool:
        """Whether sides are straight, and lines run on to them: nodes inside have four cells, others at most two."""
        if any(not isinstance(curve, Line) for curve in self.domain.curves):
            return False
        mesh, count = self.domain.mesh, len(self.domain.mesh.points)
        original = originals_of(count, mesh.ties)
        used = np.bincount(original[mesh.cells.reshape(-1)], minlength=count)
        # Edges inside a block have two cells of it.
        lines = [line for nodes in mesh.blocks for line in (nodes[0], nodes[-1], nodes[:, 0], nodes[:, -1])]
        edges = np.sort(original[np.concatenate([np.stack([line[:-1], line[1:]], axis=1) for line in lines])], axis=1)
        numbers, counts = np.unique(edges[:, 0] * count + edges[:, 1], return_counts=True)
        on_side = np.zeros(count, dtype=bool)
        for ends in np.divmod(numbers[counts == 1], count):
            on_side[ends] = True
        return bool((used[on_side] <= 2).all() and np.isin(used[~on_side], (0, 4)).all())

    def on(self, level: BlockLevel) -> BlockMesh:
        """Chart, cells and initial mesh of a level."""
        if level.number not in self._meshes:
            self._meshes[level.number] = BlockMesh.of(self.domain, level)
        return self._meshes[level.number]

    def chart(self, level: BlockLevel) -> CurveChart:
        """Nodes slide on the curves of the domain."""
        return self.on(level).chart

    def cells(self, level: BlockLevel, *, are_cut: bool) -> Cells:
        """The cells; ``are_cut`` tells whether triangles of them are used."""
        cells = self.on(level).cells
        return replace(cells, corner_cuts=cuts_at_corners(cells.corners)) if are_cut else cells

    def initial(self, level: BlockLevel) -> Array:
        """The initial mesh of the domain."""
        return self.on(level).first.unknowns

    def first_mesh(self, origin: BlockStart, level: BlockLevel) -> Array:
        """The first mesh of a start on this level."""
        if level.number not in origin.starts:
            origin.starts[level.number] = (
                self.initial(level) if origin.lines is None else self._straight(origin.lines, level)
            )
        return origin.starts[level.number]

    def uniform(self) -> BlockStart:
        """The start from the initial mesh."""
        return BlockStart(name="initial")

    def rectilinear(self, u: Field, norm: Norm, most: int, floor: float, degree: int = 1) -> BlockStart | None:
        """The start from straight lines of each block, at most ``most`` of each family; none on paved meshes."""
        if self.is_paved:
            return None
        counts = [min(cells + 1, most) for cells in self.families.finest]
        lines = equidistributed(u, self._patches, counts, norm, floor, degree=degree)
        return None if lines is None else BlockStart(name="rectilinear", lines=tuple(lines))

    def given(self, mesh: Mesh) -> BlockStart:
        """The start from a mesh of the finest level."""
        finest = self.levels[-1]
        return BlockStart(name="given", starts={finest.number: self.on(finest).of_points(mesh.points).unknowns})

    def from_coarse(self, mesh: Mesh) -> BlockStart:  # noqa: ARG002
        """The start that continues from such a mesh on a coarse level: distortion is that of the initial mesh."""
        return BlockStart(name="given")

    def sampled(self, mesh: Mesh, level: BlockLevel) -> Array | None:
        """A mesh of the finest level on a coarser one; ``None`` where it is folded there."""
        sampled = self.on(level).of_points(mesh.points).unknowns
        return sampled if self.min_jacobian(level, sampled) > 0.0 else None

    def owners(self, settings: Schwarz) -> IntArray:
        """Subdomains are blocks, or groups of them."""
        return owners(settings, self.domain.mesh)

    def is_folded(self, mesh: Array, level: BlockLevel) -> bool:  # noqa: ARG002
        """False: folded first meshes are no starts."""
        return False

    def lifted(
        self, origin: BlockStart, mesh: Array, coarse: BlockLevel, fine: BlockLevel, objective: Callable[[], Objective]
    ) -> Array:
        """A mesh on a finer level."""
        here, there = self.on(coarse), self.on(fine)
        first, start = Place(here, self.first_mesh(origin, coarse)), Place(there, self.first_mesh(origin, fine))
        return Place(here, mesh).lifted(first, start, objective(), is_regular=self.is_regular).unknowns

    def grid(self, level: BlockLevel) -> None:  # noqa: ARG002
        """``None``: the meshes have no grid."""
        return

    def mesh(self, level: BlockLevel, mesh: Array) -> Mesh:
        """A mesh of these unknowns; on the finest level it has the cells, sides and blocks of the initial one."""
        return Place(mesh=self.on(level), unknowns=mesh).quad_mesh

    def min_jacobian(self, level: BlockLevel, mesh: Array) -> float:
        """The smallest Jacobian of a corner over that of the same corner of the initial mesh."""
        here, corners = self.on(level), self.on(level).cells.corners.reshape(-1)
        now, first = (kernels.Nodes(*here.chart.nodes(one), corners) for one in (mesh, here.first.unknowns))
        return float(kernels.smallest_share(now, first))

    @cached_property
    def _patches(self) -> list[Patch]:
        """The blocks, on which the initial mesh is the map of straight lines."""
        return [
            Patch(Bilinear(self.domain.mesh.points[nodes]).places, families, turned, share)
            for nodes, families, turned, share in zip(
                self.domain.mesh.blocks, self.families.of_blocks, self.families.turned, self._shares(), strict=True
            )
        ]

    def _shares(self) -> Iterator[float]:
        """The share of the domain that each block is."""
        areas = self.domain.mesh.cell_areas()
        return (float(areas[cells].sum()) / self.domain.area for cells in self.domain.mesh.block_cells)

    def _straight(self, lines: Sequence[Array], level: BlockLevel) -> Array:
        """The initial mesh with its lines at other places, by cubic interpolation on each block."""
        mesh, parameters, here = self.domain.mesh, self.domain.node_parameter[level.nodes].copy(), self.on(level)
        every = [resampled(line, cells + 1) for line, cells in zip(lines, self.families.finest, strict=True)]
        moved = tuple(
            ((nodes.shape[0] - 1) * i[rows], (nodes.shape[1] - 1) * j[columns])
            for (i, j), (rows, columns), nodes in zip(
                self.families.in_blocks(every), level.lines, mesh.blocks, strict=True
            )
        )
        lifting = Lifting(self.levels[-1], replace(level, lines=moved))
        points = lifting.lifted(np.ascontiguousarray(mesh.points.T), cubic=True, alone=True)
        for finest, nodes, places in zip(mesh.blocks, level.blocks, moved, strict=True):
            for edge, axis in ((np.s_[0], 1), (np.s_[-1], 1), (np.s_[:, 0], 0), (np.s_[:, -1], 0)):
                known = self._parameters.get(tuple(finest[edge][:2].tolist()))
                if known is not None:
                    parameters[nodes[edge][1:-1]] = along(known, places[axis])[1:-1]
        fixed = ~here.chart.free.any(axis=0)
        points[:, fixed] = here.first.unknowns[:, fixed]
        return here.chart.unknowns(points, parameters)

    @cached_property
    def _parameters(self) -> dict[tuple[int, ...], Array]:
        """The parameters of the nodes of each edge on a curve, by the first two nodes from either end."""
        found = {}
        for edge in (*self.domain.boundary_edges, *self.domain.fixed_edges):
            found[tuple(edge.nodes[:2].tolist())] = edge.parameters
            found[tuple(edge.nodes[:-3:-1].tolist())] = edge.parameters[::-1]
        return found


@dataclass(frozen=True, eq=False)
class Bilinear:
    """The bilinear map of the unit square to the ``points`` of a block, shape ``(n, m, 2)``."""

    points: Array

    @cached_property
    def _values(self) -> Array:
        """``x, y, x_s, x_t, y_s, y_t`` at the nodes."""
        found = []
        for q in np.moveaxis(self.points, -1, 0):
            order = [min(2, size - 1) for size in q.shape]
            found.append(
                (q, *((size - 1) * np.gradient(q, axis=k, edge_order=order[k]) for k, size in enumerate(q.shape)))
            )
        (x, x_s, x_t), (y, y_s, y_t) = found
        return np.stack([x, y, x_s, x_t, y_s, y_t])

    def places(self, s: Array, t: Array) -> Sequence[Array]:
        """``x, y, x_s, x_t, y_s, y_t`` at places of the square."""
        found = np.empty((len(self._values), s.size))
        between_nodes(self._values, np.ascontiguousarray(s).reshape(-1), np.ascontiguousarray(t).reshape(-1), found)
        return tuple(found.reshape(-1, *s.shape))


@compiled
def between_nodes(values: Array, s: Array, t: Array, out: Array) -> None:
    """Bilinear interpolation of ``values`` at the nodes of a block, shape ``(k, n, m)``, at places of the square."""
    rows, columns = values.shape[1] - 1, values.shape[2] - 1
    for place in range(s.size):
        i, j = min(max(int(s[place] * rows), 0), rows - 1), min(max(int(t[place] * columns), 0), columns - 1)
        p, q = s[place] * rows - i, t[place] * columns - j
        for k in range(values.shape[0]):
            low = (1.0 - p) * values[k, i, j] + p * values[k, i + 1, j]
            high = (1.0 - p) * values[k, i, j + 1] + p * values[k, i + 1, j + 1]
            out[k, place] = (1.0 - q) * low + q * high
