"""A domain of blocks: its initial mesh, and the curves on which the nodes of its boundary slide."""

from __future__ import annotations

import copy
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from equimesh.blocks.checks import check_connected, check_not_folded, check_not_overlapping
from equimesh.blocks.counts import plan_of
from equimesh.blocks.curve_entries import entries, mapping
from equimesh.blocks.curves import BoundaryCurve, Line
from equimesh.blocks.description import Description
from equimesh.blocks.fixed_rectangle import between_fixed_lines, fixed_rectangle
from equimesh.blocks.initial import block_points, edge_lines, resampled
from equimesh.blocks.layout import BOTTOM, LEFT, RISES_WITH_BLOCK_ON_LEFT, Layout
from equimesh.blocks.recovery.boundary import Corner, with_places
from equimesh.blocks.recovery.recovered import RecoveredBlocks, recover
from equimesh.blocks.sides import fixed_edges, side_edges, sides_of
from equimesh.blocks.sliding import FIXED, BoundaryEdge, slide, with_lines
from equimesh.domains.domain import Box
from equimesh.errors import InputError
from equimesh.io.reading.plain_mesh import PlainMesh
from equimesh.io.reading.read import DESCRIPTIONS, description_format, read_description, read_mesh
from equimesh.meshes.cell_edges import quads_of_block
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.types import Array, BoolArray, IntArray
from equimesh_schema.document import is_number

# Places between two nodes on a curve at which its area is summed.
GAUSS = np.polynomial.legendre.leggauss(5)
# Places between two nodes on a curve in the first search for the ends of the box.
BOX_PLACES = 9
# Places of each closer search, and the number of these searches.
ZOOM_PLACES = 33
ZOOMS = 6

OTHER_CELLS = (
    "the mesh has other cells than the domain: give values on a mesh of this domain, such as domain.mesh or the mesh of"
    " a solution"
)
"""The reason why a mesh of another domain in blocks is refused."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Blocks:
    """A domain of one or more blocks. Build it by :meth:`of`, from a description, or from a mesh by ``of_mesh``.

    - ``mesh``: the initial mesh, a :class:`~equimesh.meshes.mesh.Mesh`, which is not folded.
    - ``layout``: the topology: edges, vertices, counts.
    - ``curves``: the curves of the boundary; straight parts are curves, too.
    - ``boundary_edges``: the edges on the boundary, with the parameters of their nodes on their curve.
    - ``fixed_edges``: the edges between blocks whose nodes slide on a curve, too.
    - ``node_curve``: for every node the number of its curve, -1 where it is free, -2 where it stays, shape ``(n,)``.
    - ``node_parameter``: the parameter of every node on its curve, 0 for others, shape ``(n,)``.
    """

    mesh: Mesh
    layout: Layout
    curves: tuple[BoundaryCurve, ...]
    boundary_edges: tuple[BoundaryEdge, ...]
    node_curve: IntArray
    node_parameter: Array
    fixed_edges: tuple[BoundaryEdge, ...] = ()
    _document: Mapping[str, Any] | None = None

    def __repr__(self) -> str:
        return f"<Blocks: {len(self.mesh.blocks)} blocks, {len(self.mesh.points)} points>"

    @classmethod
    def of(cls, document: Mapping[str, Any], folder: Path | str | None = None) -> Blocks:
        """The domain that a description gives: the object of its JSON, as in the reference of descriptions.

        Files of points lie in ``folder``. Raises :class:`~equimesh.errors.InputError` with the path of the entry, such
        as ``domain.blocks[2].cells``; the message names the edge, the block or the place, and the remedy.
        """
        description = Description.of(document, None if folder is None else Path(folder))
        plan = plan_of(description)
        names, fields = zip(*((block.name, block.field) for block in description.blocks), strict=True)
        check_connected(plan.layout, names, fields)
        lines = edge_lines(description, plan)
        count, blocks = plan.layout.numbering()
        edge_nodes = plan.layout.edge_nodes(blocks)
        mesh = Mesh(
            points=block_points(plan, lines, blocks, count),
            cells=np.concatenate([quads_of_block(block) for block in blocks]),
            sides=side_edges(plan.layout, edge_nodes, sides_of(description, plan)),
            blocks=blocks,
            block_names=names,
            ties=plan.layout.ties(blocks),
        )
        check_not_folded(
            mesh,
            fields,
            "move its corners, put a vertex on a bent edge and cut the block there, or take another grading",
        )
        check_not_overlapping(mesh, plan.layout, fields)
        numbers = {name: k for k, name in enumerate(description.vertices)}
        fixed = fixed_edges(description, plan)
        return cls.assembled(
            mesh,
            plan.layout,
            curves=tuple(description.curves.values()),
            on_curves={
                edge: (lines[edge].curve, lines[edge].parameters)
                for edge in (*map(int, plan.layout.boundary), *fixed)
                if lines[edge].curve >= 0
            },
            corners=[numbers[name] for name in description.corners],
            fixed=fixed,
            document=description.document,
        )

    @classmethod
    def rectangle(
        cls,
        x: tuple[float, float] = (0.0, 1.0),
        y: tuple[float, float] = (0.0, 1.0),
        cells: tuple[int, int] = (32, 32),
        *,
        points: Iterable[tuple[float, float]] | None = None,
        curves: Mapping[str, Any] | None = None,
        layers: Mapping[str, Any] | None = None,
        folder: Path | str | None = None,
    ) -> Blocks:
        """A rectangle of ``cells`` along x and y with nodes that stay.

        A node stays at each of the ``points``. On each of the ``curves``, entries as those of a description by their
        names, which run from a side to the opposite one, nodes slide. ``layers`` are cells along sides, by their names
        ``left``, ``right``, ``bottom`` and ``top``: ``{"first": 0.001, "growth": 1.2, "count": 8}`` has 8 lines, the
        first at the distance 0.001, and each layer 1.2 times as high as the one before. Files of points lie in
        ``folder``.

        Raises :class:`~equimesh.errors.InputError` where these do not fit into the rectangle, or need more lines than
        it has.
        """
        with between_fixed_lines():
            return cls.of(fixed_rectangle(x, y, cells, _listed(points), curves, layers, folder))

    @classmethod
    def of_mesh(
        cls,
        points: object,
        cells: object,
        sides: Mapping[str, Any],
        *,
        corners: Iterable[Corner] = (),
        corner_angle: float | None = None,
        names: Mapping[str, str] | None = None,
    ) -> Blocks:
        """The domain of any mesh of quadrilaterals, cut into blocks by lines from its irregular nodes and corners.

        ``points`` has shape ``(n, 2)``, ``cells`` ``(m, 4)``, ``sides`` the edges of each named side, shape
        ``(k, 2)``, in any direction. Nodes and cells keep their numbers; clockwise cells are turned. Edges without a
        name become the sides ``side_1``, ``side_2``, ... from corner to corner; ``names`` renames sides, by their old
        names.

        Between corners the boundary is recognised as straight or as a circle; else it is a spline through its nodes.
        Nodes slide on it. ``corners`` stay: numbers of nodes, or places (x, y) whose nearest node of the boundary is
        one. So do the ends of sides, and nodes at which the boundary turns by more than ``corner_angle`` degrees; by
        default by more than 30, or by at least one degree and five times as much as at both neighbours.

        Raises :class:`~equimesh.errors.InputError` for triangles, cells that are folded or overlap, nodes at the same
        place, cells that share a part of an edge, several pieces, and sides inside the mesh; the message names the
        place and the remedy.
        """
        mapping(sides, "sides")
        mapping({} if names is None else names, "names")
        listed: Any = entries(_listed(corners), "corners", what="a list of numbers of nodes, or places (x, y)")
        return cls._of(recover(points, cells, sides, corners=listed, corner_angle=corner_angle, names=names))

    @classmethod
    def of_plain(
        cls,
        mesh: PlainMesh,
        *,
        corners: Iterable[Corner | str] = (),
        corner_angle: float | None = None,
        names: Mapping[str, str] | None = None,
    ) -> Blocks:
        """The blocks of the mesh of a file, as by :meth:`of_mesh`, with the file's names of points and blocks."""
        return cls._of(
            recover(
                mesh.points,
                mesh.cells,
                mesh.sides,
                corners=with_places(corners, mesh.places),
                corner_angle=corner_angle,
                names=names,
                blocks_of_file=mesh.blocks,
            )
        )

    @classmethod
    def read(
        cls,
        path: str | os.PathLike[str],
        format: str | None = None,
        *,
        corners: Iterable[Corner | str] = (),
        corner_angle: float | None = None,
        names: Mapping[str, str] | None = None,
    ) -> Blocks:
        """The domain of a file: a description (``.json``, ``blockMeshDict``), or a mesh, as :meth:`of_plain` takes it.

        Meshes are ``.msh``, ``.vtu``, ``.vtm``, ``.su2``, ``.cgns``, Plot3D (``.p3d``, ``.xyz``), and the folder of an
        OpenFOAM case or of its ``polyMesh``. The suffix tells the format, unless ``format`` names it: a suffix without
        dot, or ``"blockMeshDict"``. The other arguments are for meshes.

        Raises :class:`~equimesh.errors.InputError` for a file that cannot be read, with the line where there is one.
        """
        kind = format or description_format(path)
        if kind not in DESCRIPTIONS:
            mesh = read_mesh(path, format)
            return cls.of_plain(mesh, corners=corners, corner_angle=corner_angle, names=names)
        if names or corner_angle is not None or tuple(corners):
            message = "corners, corner_angle and names are for meshes: a description has its own corners and sides"
            raise InputError(message, field="corners")
        return cls.of(read_description(path, kind), Path(path).parent)

    @classmethod
    def _of(cls, of: RecoveredBlocks) -> Blocks:
        return cls.assembled(of.mesh, of.layout, curves=of.curves, on_curves=of.on_curves, corners=of.corners.tolist())

    @classmethod
    def assembled(
        cls,
        mesh: Mesh,
        layout: Layout,
        *,
        curves: Sequence[BoundaryCurve],
        on_curves: Mapping[int, tuple[int, Array]],
        corners: Iterable[int] = (),
        fixed: Sequence[int] = (),
        document: Mapping[str, Any] | None = None,
    ) -> Blocks:
        """The domain of a mesh whose blocks fit to ``layout``.

        ``on_curves`` has, by the number of an edge, the number of its curve and the parameters of its nodes from begin
        to end; all other edges on the boundary, and those that are ``fixed`` between blocks, are straight. ``corners``
        are vertices that stay.
        """
        edge_nodes = layout.edge_nodes(mesh.blocks)
        used = sorted({number for number, _ in on_curves.values()})
        place = {number: k for k, number in enumerate(used)}
        placed = {edge: (place[number], t) for edge, (number, t) in on_curves.items()}
        sliding = [*map(int, layout.boundary), *fixed]
        found, edges = with_lines(layout, sliding, mesh.points, edge_nodes, [curves[k] for k in used], placed)
        node_curve, parameter = slide(layout, len(mesh.points), edges, found, edge_nodes, mesh.ties, set(corners))
        return cls(
            mesh=mesh,
            layout=layout,
            curves=found,
            boundary_edges=edges[: len(layout.boundary)],
            fixed_edges=edges[len(layout.boundary) :],
            node_curve=node_curve,
            node_parameter=parameter,
            _document=document,
        )

    def plot(self, axes: Any = None) -> Any:
        """Draw the initial mesh on ``axes`` of matplotlib, or on those of pyplot, and return the axes."""
        return self.mesh.plot(axes)

    def _repr_html_(self) -> str:
        """The picture and the table of the initial mesh, for notebooks."""
        return self.mesh._repr_html_()

    @property
    def points(self) -> int:
        """The number of nodes of the initial mesh."""
        return len(self.mesh.points)

    @cached_property
    def box(self) -> Box:
        """The smallest box ``((x0, x1), (y0, y1))`` that holds the domain, to rounding."""
        found = [[float(line.min()), float(line.max())] for line in (self.mesh.x, self.mesh.y)]
        for edge in self.boundary_edges:
            curve, n = self.curves[edge.curve], len(edge.parameters)
            if isinstance(curve, Line):
                continue
            between = np.interp(np.linspace(0, n - 1, BOX_PLACES * (n - 1) + 1), np.arange(n), edge.parameters)
            for axis, ends in enumerate(found):
                ends[0] = min(ends[0], -_furthest(curve, between, axis, -1.0))
                ends[1] = max(ends[1], _furthest(curve, between, axis, 1.0))
        return (found[0][0], found[0][1]), (found[1][0], found[1][1])

    @cached_property
    def area(self) -> float:
        """The area inside the curves of the boundary, from the areas of the cells and what lies beyond their edges."""
        total = float(self.mesh.cell_areas().sum())
        ways = {int(edge): way for edge, way in zip(self.layout.block_edges.ravel(), self._ways.ravel(), strict=True)}
        for edge in self.boundary_edges:
            t, corners = edge.parameters, self.mesh.points[edge.nodes]
            half, middle = 0.5 * np.diff(t), 0.5 * (t[1:] + t[:-1])
            x, y, x_t, y_t = self.curves[edge.curve].evaluate(middle[:, None] + half[:, None] * GAUSS[0])
            from_x, from_y = corners[:-1, :1], corners[:-1, 1:]
            parts = (half[:, None] * GAUSS[1] * ((x - from_x) * y_t - (y - from_y) * x_t)).sum()
            total += 0.5 * float(parts) * (1.0 if ways[edge.edge] else -1.0)
        return total

    @property
    def _ways(self) -> BoolArray:
        """Whether each edge of a block has the block on its left, shape ``(b, 4)``."""
        return np.asarray(self.layout.forward == np.array(RISES_WITH_BLOCK_ON_LEFT))

    def description(self) -> dict[str, Any]:
        """The description that the domain came from, as JSON; the points of files are in it.

        Raises :class:`~equimesh.errors.InputError` for a domain that came from a mesh.
        """
        if self._document is None:
            raise InputError("this domain came from a mesh, and has no description: keep the file of the mesh")
        return dict(copy.deepcopy(self._document))

    def refined(self, factor: float) -> Blocks:
        """The same domain with ``factor`` times as many cells along each edge, rounded; at least 1 cell stays.

        A domain that came from a description is built from it again. Else nodes stand between those of the mesh, by
        cubic splines, and on the same curves. Raises :class:`~equimesh.errors.InputError` for a factor that is no
        positive number, and where the finer or coarser mesh folds.
        """
        if not (is_number(factor) and 0 < factor < math.inf):
            raise InputError(f"factor = {factor!r}: a positive number", field="factor")
        if self._document is not None:
            document = self.description()
            return Blocks.of(document | {"refine": document.get("refine", 1) * factor})
        return self._resampled(self.layout.coarser(1.0 / factor), "take a factor nearer to 1")

    def with_counts(self, counts: IntArray) -> Blocks:
        """The same domain with other numbers of cells, one for each class of edges, shape ``(c,)``.

        Edges that are opposite in a block, or joined, are a class; ``layout.classes`` has the class of every edge, and
        ``layout.counts`` the numbers of cells now. The mesh is built as by :meth:`refined`. Raises
        :class:`~equimesh.errors.InputError` for counts that are not whole positive numbers, one for each class, and
        where the mesh folds.
        """
        given, now = np.asarray(counts), self.layout.counts
        if given.shape != now.shape or given.dtype.kind not in "iu" or (given < 1).any():
            raise InputError(
                f"counts = {str(counts)[:40]}: {len(now)} whole positive numbers are needed, one for each class of"
                " opposite edges, as layout.counts has them",
                field="counts",
            )
        if np.array_equal(given, now):
            return self
        layout = self.layout.with_counts(given)
        if self._document is None:
            return self._resampled(layout, "take other counts")
        document = self.description()
        sides = layout.edge_counts[layout.block_edges[:, [BOTTOM, LEFT]]].tolist()
        blocks = [{**block, "cells": cells} for block, cells in zip(document["blocks"], sides, strict=True)]
        edges = [{key: value for key, value in edge.items() if key != "cells"} for edge in document.get("edges", ())]
        return Blocks.of({**document, "blocks": blocks, "edges": edges, "refine": 1})

    def with_counts_of(self, mesh: Mesh) -> Blocks:
        """The same domain with the numbers of cells of a ``mesh`` of it, as rounds with a budget of points find them.

        Raises :class:`~equimesh.errors.InputError` for a mesh of other blocks, and where the initial mesh folds.
        """
        if np.array_equal(mesh.cells, self.mesh.cells):
            return self
        counts = self.layout.counts_of([block.shape for block in mesh.blocks])
        found = None if counts is None else self.with_counts(counts)
        if found is None or not np.array_equal(mesh.cells, found.mesh.cells):
            raise InputError(OTHER_CELLS, field="mesh")
        return found

    def _resampled(self, layout: Layout, remedy: str) -> Blocks:
        """The domain with the counts of a ``layout``; its nodes stand between those of the mesh."""
        mesh, on_curves = resampled(self.mesh, self.layout, self.curves, self.boundary_edges, layout)
        check_not_folded(mesh, ("domain",) * layout.block_count, remedy)
        stays = {
            int(vertex)
            for vertices, nodes in zip(self.layout.edges, self.layout.edge_nodes(self.mesh.blocks), strict=True)
            for vertex, node in zip(vertices, nodes[[0, -1]], strict=True)
            if self.node_curve[node] == FIXED
        }
        return Blocks.assembled(mesh, layout, curves=self.curves, on_curves=on_curves, corners=stays)


def _listed(values: object) -> object:
    """The values of anything that has some in turn as a tuple; anything else, and a text, as it is."""
    return tuple(values) if isinstance(values, Iterable) and not isinstance(values, str) else values


def _furthest(curve: BoundaryCurve, t: Array, axis: int, sign: float) -> float:
    """The largest of ``sign`` times a coordinate: the best of the places ``t``, and closer searches around it."""
    for _ in range(ZOOMS + 1):
        values = sign * curve.evaluate(t)[axis]
        best = int(values.argmax())
        t = np.linspace(t[max(best - 1, 0)], t[min(best + 1, len(t) - 1)], ZOOM_PLACES)
    return float(values[best])
