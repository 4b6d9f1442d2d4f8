"""The mesh of a domain with other numbers of cells: cubic between its nodes, and on the same curves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator

from equimesh.blocks.curves import BoundaryCurve
from equimesh.blocks.layout import BOTTOM, LEFT, RIGHT, TOP, Layout, line_of
from equimesh.blocks.sides import side_edges
from equimesh.blocks.sliding import BoundaryEdge
from equimesh.blocks.transfinite import transfinite
from equimesh.meshes.quad_mesh import QuadMesh, quads_of_block
from equimesh.numerics.types import Array


def resampled(
    mesh: QuadMesh, layout: Layout, curves: Sequence[BoundaryCurve], edges: Sequence[BoundaryEdge], wanted: Layout
) -> tuple[QuadMesh, dict[int, tuple[int, Array]]]:
    """The mesh with the counts of ``wanted``, and for each edge on the boundary its curve and the parameters there.

    ``layout``, ``curves`` and boundary ``edges`` are those of the domain of ``mesh``. Nodes whose place between the
    ends of their edges does not change stay to rounding. It may fold where cells of very different sizes meet.
    """
    count, blocks = wanted.numbering()
    parameters = {edge.edge: _between(edge.parameters, int(wanted.edge_counts[edge.edge])) for edge in edges}
    number = {edge.edge: edge.curve for edge in edges}
    lines = []
    for edge, nodes in enumerate(layout.edge_nodes(mesh.blocks)):
        line = mesh.points[nodes]
        finer = _cubic(line, int(wanted.edge_counts[edge]))
        if edge in parameters:
            finer = np.column_stack(curves[number[edge]].evaluate(parameters[edge])[:2])
        finer[0], finer[-1] = line[0], line[-1]
        lines.append(finer)
    points = np.empty((count, 2))
    for b, (old, new) in enumerate(zip(mesh.blocks, blocks, strict=True)):
        inner = _cubic(mesh.points[old], new.shape[0] - 1)
        inner = _cubic(inner.transpose(1, 0, 2), new.shape[1] - 1).transpose(1, 0, 2)
        sides = [
            lines[layout.block_edges[b, side]][:: 1 if layout.forward[b, side] else -1]
            for side in (LEFT, RIGHT, BOTTOM, TOP)
        ]
        offsets = [line - line_of(inner, side) for side, line in enumerate(sides)]
        even = [np.linspace(0.0, 1.0, len(line)) for line in sides]
        points[new] = inner + transfinite(offsets, even)
        for side, line in enumerate(sides):
            points[line_of(new, side)] = line
    edge_nodes = wanted.edge_nodes(blocks)
    found = QuadMesh(
        points=points,
        cells=np.concatenate([quads_of_block(block) for block in blocks]),
        sides=side_edges(wanted, edge_nodes, _edges_of_sides(mesh, layout)),
        blocks=blocks,
        block_names=mesh.block_names,
        ties=wanted.ties(blocks),
    )
    return found, {edge.edge: (edge.curve, parameters[edge.edge]) for edge in edges}


def _edges_of_sides(mesh: QuadMesh, layout: Layout) -> dict[str, list[int]]:
    """The edges of the layout that lie on each side of a mesh."""
    of = {(int(a), int(b)): name for name, edges in mesh.sides.items() for a, b in edges}
    found: dict[str, list[int]] = {name: [] for name in mesh.sides}
    for edge, nodes in enumerate(layout.edge_nodes(mesh.blocks)):
        first, second = int(nodes[0]), int(nodes[1])
        name = of.get((first, second), of.get((second, first)))
        if name is not None and layout.edge_uses[edge] == 1:
            found[name].append(edge)
    return {name: edges for name, edges in found.items() if edges}


def _between(values: Array, cells: int) -> Array:
    """Parameters that rise or fall, at other numbers of cells; they still do."""
    places = np.linspace(0.0, len(values) - 1.0, cells + 1)
    return np.asarray(PchipInterpolator(np.arange(len(values)), values)(places))


def _cubic(values: Array, cells: int) -> Array:
    """Values along the first axis at other numbers of cells, by a cubic spline."""
    if len(values) - 1 == cells:
        return values.copy()
    places = np.linspace(0.0, len(values) - 1.0, cells + 1)
    return np.asarray(CubicSpline(np.arange(len(values)), values, axis=0)(places))
