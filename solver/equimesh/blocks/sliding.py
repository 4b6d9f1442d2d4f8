"""Which nodes slide on which curve: from edges of blocks to a curve and a parameter of each node."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass

import numpy as np

from equimesh.blocks.curves import BoundaryCurve, Line
from equimesh.blocks.layout import Layout
from equimesh.meshes.cell_edges import originals_of
from equimesh.numerics.types import Array, IntArray

# In place of the number of a curve: a node that is free to move, and one that stays.
FREE, FIXED = -1, -2
# Straight edges are one line where their directions differ by less, in radians.
SAME_DIRECTION = 1e-9
# Parameters are those of a corner within this share of the curve.
AT_CORNER = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class BoundaryEdge:
    """An edge whose nodes slide: its ``nodes`` from begin to end, and their ``parameters`` on the curve ``curve``.

    Both have the shape ``(n,)``. Parameters rise or fall; on a closed curve they may leave its ends.
    """

    edge: int
    curve: int
    nodes: IntArray
    parameters: Array


def with_lines(
    layout: Layout,
    sliding: Sequence[int],
    points: Array,
    edge_nodes: Sequence[IntArray],
    curves: Sequence[BoundaryCurve],
    on_curves: Mapping[int, tuple[int, Array]],
) -> tuple[tuple[BoundaryCurve, ...], tuple[BoundaryEdge, ...]]:
    """The given curves and one line for each straight part of the edges ``sliding``, and these edges.

    ``on_curves`` has, by the number of an edge, the curve that it lies on and the parameters of its nodes. All other
    edges are straight; those that go on in one direction at a vertex are one line.
    """
    straight = [edge for edge in sliding if edge not in on_curves]
    ends = {edge: points[edge_nodes[edge][[0, -1]]] for edge in straight}
    chains = _chains(layout, straight, ends)
    found = list(curves)
    placed = dict(on_curves)
    for chain in chains:
        line = _line_through(np.concatenate([ends[edge] for edge in chain]))
        for edge in chain:
            at = points[edge_nodes[edge]] - np.array(line.start)
            placed[edge] = len(found), at @ np.array(line.direction)
        found.append(line)
    edges = tuple(
        BoundaryEdge(edge=edge, curve=placed[edge][0], nodes=edge_nodes[edge], parameters=placed[edge][1])
        for edge in sliding
    )
    return tuple(found), edges


def slide(
    layout: Layout,
    count: int,
    edges: Sequence[BoundaryEdge],
    curves: Sequence[BoundaryCurve],
    edge_nodes: Sequence[IntArray],
    ties: IntArray,
    corners: Set[int],
) -> tuple[IntArray, Array]:
    """For each of ``count`` nodes the number of its curve, ``FREE`` or ``FIXED``, and its parameter, else 0.

    A vertex slides where two edges on one curve meet at it; it stays where it is one of ``corners``, a corner of the
    curve, or where two curves meet.
    """
    node_curve, parameter = np.full(count, FREE), np.zeros(count)
    node_of = np.empty(layout.vertex_count, dtype=np.int64)
    for k in np.flatnonzero(np.isin(layout.edges, list(corners)).any(axis=1)).tolist():
        node_of[layout.edges[k]] = edge_nodes[k][[0, -1]]
    original = originals_of(count, ties)
    meeting: dict[int, list[tuple[int, int, float]]] = {}  # by the original of a vertex: node, curve, parameter
    for edge in edges:
        node_curve[edge.nodes[1:-1]] = edge.curve
        parameter[edge.nodes[1:-1]] = edge.parameters[1:-1]
        for end in (0, -1):
            node = int(edge.nodes[end])
            meeting.setdefault(int(original[node]), []).append((node, edge.curve, float(edge.parameters[end])))
    stays = {int(original[node_of[vertex]]) for vertex in corners}
    groups: dict[int, list[int]] = {}
    for copy, node in ties.tolist():
        groups.setdefault(node, [node]).append(copy)
    for node, places in meeting.items():
        together = groups.get(node, [node])
        if node not in stays and _slides(places, curves, len(together)):
            for at, curve, t in places:
                node_curve[at], parameter[at] = curve, t
        else:
            node_curve[together] = FIXED
    for node in stays:
        node_curve[groups.get(node, [node])] = FIXED
    return node_curve, parameter


def _slides(places: list[tuple[int, int, float]], curves: Sequence[BoundaryCurve], copies: int) -> bool:
    """Whether two edges meet at a vertex in one direction, so that it can slide on their curve."""
    if len(places) != 2:
        return False
    (one, first, t), (other, second, s) = places
    if one != other or copies > 1:  # where a join meets the boundary: both copies slide on their line
        lines = [curves[k] for k in (first, second)]
        if one == other or copies != 2 or not all(isinstance(line, Line) for line in lines):
            return False
        (a, b), (c, d) = (line.direction for line in lines if isinstance(line, Line))
        return math.hypot(a - c, b - d) < SAME_DIRECTION
    if first != second:
        return False
    curve = curves[first]
    low, high = curve.ends
    turns = (t - s) / (high - low)
    if abs(turns - (round(turns) if curve.closed else 0.0)) > AT_CORNER:
        return False
    if not curve.closed and min(t - low, high - t) < AT_CORNER * (high - low):
        return False
    gaps = (curve.corners - t) / (high - low)
    gaps = gaps - np.round(gaps) if curve.closed else gaps
    return not bool((np.abs(gaps) < AT_CORNER).any())


def _chains(layout: Layout, straight: Sequence[int], ends: Mapping[int, Array]) -> list[list[int]]:
    """The straight edges in groups that are one line, each in the order of the edges."""
    at: dict[int, list[int]] = {}
    for edge in straight:
        for vertex in layout.edges[edge].tolist():
            at.setdefault(vertex, []).append(edge)
    group = {edge: edge for edge in straight}
    for pair in at.values():
        if len(pair) == 2 and _goes_on(*(ends[edge] for edge in pair)):
            one, other = sorted(group[edge] for edge in pair)
            group = {edge: one if first == other else first for edge, first in group.items()}
    return [[edge for edge in straight if group[edge] == first] for first in sorted(set(group.values()))]


def _goes_on(one: Array, other: Array) -> bool:
    """Whether two straight edges with a common end lie on one line, on different sides of that end."""
    a, b = one[1] - one[0], other[1] - other[0]
    lengths = math.hypot(*a), math.hypot(*b)
    if abs(a[0] * b[1] - a[1] * b[0]) > SAME_DIRECTION * lengths[0] * lengths[1]:
        return False
    farthest = max(math.hypot(*(p - q)) for p in one for q in other)
    return farthest > max(lengths) + 0.5 * min(lengths)


def _line_through(places: Array) -> Line:
    """The line through these places, which lie on one, between the outer ones; it runs to the right, or upwards."""
    far = places[int(np.hypot(*(places - places[0]).T).argmax())] - places[0]
    main = int(abs(far[0]) < SAME_DIRECTION * abs(far[1]))  # the coordinate that rises: y where the line is upright
    low, high = places[int(places[:, main].argmin())], places[int(places[:, main].argmax())]
    return Line(start=(float(low[0]), float(low[1])), end=(float(high[0]), float(high[1])))
