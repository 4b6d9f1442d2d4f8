"""Meshes of blocks: the initial one of a description, and one with other numbers of cells on the same curves."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from equimesh.blocks.counts import Plan
from equimesh.blocks.curves import BoundaryCurve, parameters_at, span
from equimesh.blocks.description import Description, EdgeEntry
from equimesh.blocks.grading import shares
from equimesh.blocks.layout import BOTTOM, LEFT, RIGHT, TOP, Layout, line_of
from equimesh.blocks.sides import side_edges
from equimesh.blocks.sliding import BoundaryEdge
from equimesh.blocks.spline_curve import SplineCurve
from equimesh.errors import InputError
from equimesh.meshes.cell_edges import quads_of_block
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.types import Array, IntArray

# The nodes of a block between its four sides, by transfinite interpolation.
#
# W. J. Gordon and C. A. Hall, *Construction of curvilinear coordinate systems and applications to mesh generation*,
# Int. J. Numer. Meth. Engng 7 (1973).


def transfinite(sides: Sequence[Array], shares: Sequence[Array]) -> Array:
    """The nodes of a block, shape ``(n_i, n_j, 2)``.

    ``sides`` are the nodes on left, right, bottom and top with their index rising, shape ``(n, 2)`` each, and
    ``shares`` their places on the side from 0 to 1. A line of the block begins and ends at such shares of opposite
    sides; a node stands where two straight lines between them cross in the unit square, and there the four sides are
    blended.
    """
    left, right, bottom, top = sides
    v_left, v_right, u_bottom, u_top = shares
    u_bottom, u_top, v_left, v_right = u_bottom[:, None], u_top[:, None], v_left[None, :], v_right[None, :]
    du, dv = u_top - u_bottom, v_right - v_left
    u = (u_bottom + v_left * du) / (1.0 - du * dv)
    v = (v_left + u_bottom * dv) / (1.0 - du * dv)
    u, v = u[..., None], v[..., None]
    corners = (1.0 - u) * ((1.0 - v) * bottom[0] + v * top[0]) + u * ((1.0 - v) * bottom[-1] + v * top[-1])
    found = (1.0 - v) * bottom[:, None] + v * top[:, None] + (1.0 - u) * left[None] + u * right[None] - corners
    found[0], found[-1], found[:, 0], found[:, -1] = left, right, bottom, top
    return np.asarray(found)


# A vertex may be so far from the curve of its edge, as a share of the size of the domain: it is moved onto the curve.
MAX_DISTANCE_SHARE = 0.02
# A vertex of two curves must be so near to both.
MEETING_SHARE = 1e-8
# Times that a vertex of two curves is moved from one to the other until it is on both.
ALTERNATIONS = 200
# Parameters are those of a corner within this share of the curve.
AT_CORNER = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class EdgeLine:
    """The nodes of an edge, shape ``(n, 2)``, their shares of its length, and, on a curve, its number and their t."""

    points: Array
    shares: Array
    curve: int
    parameters: Array


def edge_lines(description: Description, plan: Plan) -> tuple[EdgeLine, ...]:
    """The nodes of all edges.

    Raises :class:`~equimesh.errors.InputError` where a vertex is not on the curve of its edge, and where a curve has a
    corner inside an edge.
    """
    curves, names = list(description.curves.values()), list(description.curves)
    entries = {plan.edge_of[frozenset(entry.ends)]: entry for entry in description.edges if entry.on is not None}
    vertices = _on_curves(description, plan)
    layout, found = plan.layout, []
    for edge, (first, last) in enumerate(layout.edges.tolist()):
        share = shares(plan.gradings[edge], int(layout.edge_counts[edge]))
        ends = vertices[[first, last]]
        if edge not in entries:
            if first == last:
                name = layout.edge_name(edge)
                message = f"the edge {name} begins and ends at one vertex: name the closed curve that it lies on"
                raise InputError(message, field="domain.edges")
            points = (1.0 - share[:, None]) * ends[0] + share[:, None] * ends[1]
            found.append(EdgeLine(points=points, shares=share, curve=-1, parameters=np.empty(0)))
            continue
        entry, number = entries[edge], names.index(str(entries[edge].on))
        t = _parameters(curves[number], entry, ends, share, layout.edge_name(edge))
        points = np.column_stack(curves[number].evaluate(t)[:2])
        points[0], points[-1] = ends
        found.append(EdgeLine(points=points, shares=share, curve=number, parameters=t))
    return _with_copies(plan, found)


def block_points(plan: Plan, lines: tuple[EdgeLine, ...], blocks: tuple[IntArray, ...], count: int) -> Array:
    """All nodes, shape ``(count, 2)``: those of the edges, and between them those of the blocks."""
    points = np.empty((count, 2))
    for block, edges, forward in zip(blocks, plan.layout.block_edges, plan.layout.forward, strict=True):
        sides, places = [], []
        for side in (LEFT, RIGHT, BOTTOM, TOP):
            line = lines[edges[side]]
            sides.append(line.points if forward[side] else line.points[::-1])
            places.append(line.shares if forward[side] else 1.0 - line.shares[::-1])
        points[block] = transfinite(
            (sides[0], sides[1], sides[2], sides[3]), (places[0], places[1], places[2], places[3])
        )
    return points


def _on_curves(description: Description, plan: Plan) -> Array:
    """The vertices, each moved onto the curves of its edges, shape ``(v, 2)``."""
    places = np.array(list(description.vertices.values()))
    size = float(np.hypot(*np.ptp(places, axis=0)))
    for curve in description.curves.values():
        t = np.linspace(*curve.ends, 33)
        size = max(size, float(np.hypot(*np.ptp(np.column_stack(curve.evaluate(t)[:2]), axis=0))))
    wanted: dict[int, list[EdgeEntry]] = {}
    for entry in description.edges:
        if entry.on is not None:
            for vertex in set(plan.layout.edges[plan.edge_of[frozenset(entry.ends)]].tolist()):
                wanted.setdefault(vertex, []).append(entry)
    for vertex, users in wanted.items():
        of = {str(entry.on): entry for entry in users}
        start = places[vertex].copy()
        for name, entry in of.items():
            _check_near(description.curves[name], start, size, plan.layout.vertex_name(vertex), entry)
        for _ in range(ALTERNATIONS if len(of) > 1 else 1):
            before = places[vertex].copy()
            for name in of:
                places[vertex] = _foot(description.curves[name], places[vertex])
            if np.array_equal(before, places[vertex]):
                break
        for name, entry in of.items():
            gap = places[vertex] - _foot(description.curves[name], places[vertex])
            if math.hypot(*gap) > MEETING_SHARE * size:
                raise InputError(
                    f"the vertex {plan.layout.vertex_name(vertex)} has edges on the curves {' and '.join(of)}, which do"
                    f" not meet near ({start[0]:.6g}, {start[1]:.6g})",
                    field=f"{entry.field}.on",
                )
    return places


def _check_near(curve: BoundaryCurve, at: Array, size: float, vertex: str, entry: EdgeEntry) -> None:
    """Refuse a vertex that is far from the curve of its edge."""
    foot = _foot(curve, at)
    distance = math.hypot(*(foot - at))
    if distance > MAX_DISTANCE_SHARE * size:
        raise InputError(
            f"the edge {entry.ends[0]}-{entry.ends[1]} lies on the curve {entry.on}, but its vertex {vertex} ="
            f" ({at[0]:.6g}, {at[1]:.6g}) is {distance:.3g} away from it: move the vertex to ({foot[0]:.6g},"
            f" {foot[1]:.6g}), the nearest point of the curve",
            field=f"{entry.field}.on",
        )


def _foot(curve: BoundaryCurve, at: Array) -> Array:
    """The nearest point of a curve."""
    x, y, *_ = curve.evaluate(curve.nearest(np.array(at[0]), np.array(at[1])))
    return np.array([float(x), float(y)])


def _parameters(curve: BoundaryCurve, entry: EdgeEntry, ends: Array, share: Array, name: str) -> Array:
    """The t of the nodes of an edge on a curve, from its begin to its end."""
    first, last = curve.nearest(ends[:, 0], ends[:, 1])
    t = parameters_at(curve, span(curve, first, last, via=entry.via, name=name, field=f"{entry.field}.on"), share)
    low, high = min(t[0], t[-1]), max(t[0], t[-1])
    period = curve.ends[1] - curve.ends[0]
    room = AT_CORNER * period
    if isinstance(curve, SplineCurve) and curve.straight:
        return t
    for corner in curve.corners:
        turns = np.arange(-2, 3) * period if curve.closed else np.zeros(1)
        inside = (corner + turns > low + room) & (corner + turns < high - room)
        if inside.any():
            x, y, *_ = curve.evaluate(np.array(corner))
            raise InputError(
                f"the edge {name} runs through the corner ({x + 0.0:.6g}, {y + 0.0:.6g}) of the curve {entry.on}: put a"
                " vertex there, or give the curve other corners",
                field=f"{entry.field}.on",
            )
    return t


def _with_copies(plan: Plan, lines: list[EdgeLine]) -> tuple[EdgeLine, ...]:
    """The same lines, with the nodes of every joined copy moved to those of its original plus the translation."""
    for one, copy, same in plan.layout.joins.tolist():
        here, there = lines[one], lines[copy]
        ahead = slice(None, None, 1 if same else -1)
        shift = there.points[ahead][0] - here.points[0]
        points = (here.points + shift)[ahead].copy()
        points[0], points[-1] = there.points[0], there.points[-1]
        share = here.shares if same else 1.0 - here.shares[::-1]
        lines[copy] = EdgeLine(points=points, shares=share, curve=-1, parameters=np.empty(0))
    return tuple(lines)


# The mesh of a domain with other numbers of cells: cubic between its nodes, and on the same curves.


def resampled(
    mesh: Mesh, layout: Layout, curves: Sequence[BoundaryCurve], edges: Sequence[BoundaryEdge], wanted: Layout
) -> tuple[Mesh, dict[int, tuple[int, Array]]]:
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
    found = Mesh(
        points=points,
        cells=np.concatenate([quads_of_block(block) for block in blocks]),
        sides=side_edges(wanted, edge_nodes, _edges_of_sides(mesh, layout)),
        blocks=blocks,
        block_names=mesh.block_names,
        ties=wanted.ties(blocks),
    )
    return found, {edge.edge: (edge.curve, parameters[edge.edge]) for edge in edges}


def _edges_of_sides(mesh: Mesh, layout: Layout) -> dict[str, list[int]]:
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
    return np.asarray(scipy.interpolate.PchipInterpolator(np.arange(len(values)), values)(places))


def _cubic(values: Array, cells: int) -> Array:
    """Values along the first axis at other numbers of cells, by a cubic spline."""
    if len(values) - 1 == cells:
        return values.copy()
    places = np.linspace(0.0, len(values) - 1.0, cells + 1)
    return np.asarray(scipy.interpolate.CubicSpline(np.arange(len(values)), values, axis=0)(places))
