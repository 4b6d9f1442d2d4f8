"""The boundary of a mesh of quadrilaterals: its named sides, its corners, and the lines between the corners."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import scipy

from equimesh.blocks.recovery.half_edges import HalfEdges
from equimesh.errors import InputError
from equimesh.numerics.types import Array, BoolArray, IntArray

# A corner is named by the number of its node, or by its place.
Corner: TypeAlias = int | Sequence[float]

# The boundary has a corner where it turns by more degrees than this.
SHARP: float = 30.0
# It also has one where it turns by this many degrees at least, and ...
SPIKE: float = 1.0
# ... by this many times the turn at both neighbours.
SPIKE_RATIO: float = 5.0
# Nodes are at the same place where they are nearer than this part of the size of the mesh.
SAME_PLACE: float = 1e-10
# A closed line of the boundary has no inside where its area is this part of its squared length.
NO_AREA: float = 1e-12
# What a side is called that has no name, before its number.
UNNAMED: str = "side_"


@dataclass(frozen=True, kw_only=True, eq=False)
class Line:
    """A line of the boundary: its ``nodes`` in order, the domain on the left; the first is not repeated at the end."""

    nodes: IntArray
    is_closed: bool


@dataclass(frozen=True, kw_only=True, eq=False)
class Boundary:
    """The boundary of a mesh.

    - ``sides``: the edges of each side, shape ``(k, 2)``, with the domain on their left, in their order along the side.
    - ``corners``: the numbers of the nodes that stay in their place: corners, and the ends of sides.
    - ``lines``: the lines between them; with closed ones, where a closed line has no corner.
    """

    sides: dict[str, IntArray]
    corners: IntArray
    lines: list[Line]

    @classmethod
    def of(
        cls,
        points: Array,
        edges: HalfEdges,
        sides: Mapping[str, IntArray],
        *,
        corners: Iterable[Corner] = (),
        corner_angle: float | None = None,
    ) -> Boundary:
        """The boundary of a mesh whose named ``sides`` may be in any order and direction, and may leave out edges.

        Edges without a name become the sides ``side_1``, ``side_2``, ...: each from corner to corner. ``corners`` are
        numbers of nodes, or places (x, y) whose nearest node on the boundary is one. There is also a corner where the
        boundary turns by more than ``corner_angle`` degrees; by default more than 30, or at least one degree and five
        times as much as at both neighbours.

        Raises :class:`~equimesh.errors.InputError` for an edge that is not on the boundary or of two sides, for a
        corner that is not on the boundary, and for nodes that lie at the same place.
        """
        loops = edges.loops()
        _check_places(points, edges, loops)
        following = np.full(len(points), -1)
        for loop in loops:
            following[loop] = np.roll(loop, -1)
        label = _labels(points, following, sides)
        fixed = np.zeros(len(points), np.bool_)
        for loop in loops:
            fixed[loop] = _sharp(points, loop, corner_angle)
        fixed[_corner_nodes(points, edges.boundary, corners)] = True
        named = {name: _ordered(table, following, label, k) for k, (name, table) in enumerate(sides.items())}
        for loop in loops:
            fixed[loop] |= label[loop] != np.roll(label[loop], 1)
        lines = [line for loop in loops for line in _lines(loop, fixed)]
        nameless = [line for line in lines if label[line.nodes[0]] < 0]
        taken, number = set(named), 1
        for line in nameless:
            while (name := f"{UNNAMED}{number}") in taken:
                number += 1
            taken.add(name)
            named[name] = _edges_of(line)
        return cls(sides=named, corners=np.flatnonzero(fixed), lines=lines)


def _labels(points: Array, following: IntArray, sides: Mapping[str, IntArray]) -> IntArray:
    """The place in ``sides`` of the side of each boundary edge, at its first node; -1 where it has none."""
    label = np.full(len(points), -1)
    for number, (name, table) in enumerate(sides.items()):
        if len(table) == 0:
            raise InputError(f"the side {name!r} has no edges: remove it, or add its edges", field=f"sides.{name}")
        start, end = table[:, 0], table[:, 1]
        forth, back = following[start] == end, following[end] == start
        if not (forth | back).all():
            k = int((forth | back).argmin())
            x, y = points[table[k]].mean(axis=0)
            message = (
                f"the side {name!r} has the edge between the nodes {start[k]} and {end[k]} near ({x:.6g}, {y:.6g}),"
                " which is not on the boundary of the mesh: a side may have edges of the boundary only"
            )
            raise InputError(message, field=f"sides.{name}")
        first = np.where(forth, start, end)
        twice = np.flatnonzero(label[first] >= 0)
        if len(twice):
            other = list(sides)[label[first[twice[0]]]]
            x, y = points[table[twice[0]]].mean(axis=0)
            message = (
                f"the edge between the nodes {start[twice[0]]} and {end[twice[0]]} near ({x:.6g}, {y:.6g}) belongs to"
                f" the sides {other!r} and {name!r}: give it one name"
            )
            raise InputError(message, field=f"sides.{name}")
        label[first] = number
    return label


def _ordered(table: IntArray, following: IntArray, label: IntArray, number: int) -> IntArray:
    """The edges of side ``number`` in their order along it, piece by piece, in the order of the first of each."""
    before = np.full(len(following), -1)
    on = np.flatnonzero(following >= 0)
    before[following[on]] = on
    done = np.zeros(len(following), np.bool_)
    result: list[int] = []
    for start, end in table.tolist():
        first = node = start if following[start] == end else end
        if done[node]:
            continue
        while label[before[node]] == number and before[node] != first:
            node = int(before[node])
        if label[before[node]] == number:  # all around
            node = first
        while label[node] == number and not done[node]:
            done[node] = True
            result.append(node)
            node = int(following[node])
    starts = np.array(result, dtype=np.int64)
    return np.column_stack([starts, following[starts]])


def _sharp(points: Array, loop: IntArray, corner_angle: float | None) -> BoolArray:
    """Which nodes of a closed line are corners by the angle of the line."""
    ahead = points[np.roll(loop, -1)] - points[loop]
    behind = np.roll(ahead, 1, axis=0)
    cross = behind[:, 0] * ahead[:, 1] - behind[:, 1] * ahead[:, 0]
    turn = np.degrees(np.abs(np.arctan2(cross, (behind * ahead).sum(axis=1))))
    if corner_angle is not None:
        return np.asarray(turn > corner_angle)
    beside = np.maximum(np.roll(turn, 1), np.roll(turn, -1))
    return np.asarray((turn > SHARP) | ((turn > SPIKE) & (turn > SPIKE_RATIO * beside)))


def with_places(corners: Iterable[Corner | str], places: Mapping[str, int]) -> list[Corner]:
    """The same corners, the names of ``places`` replaced by the numbers of their nodes.

    Raises :class:`~equimesh.errors.InputError` for a name that there is not.
    """
    found: list[Corner] = []
    for k, corner in enumerate(corners):
        if isinstance(corner, str) and corner not in places:
            message = (
                f"corners[{k}] = {corner[:40]!r} is no named point of the file: there are {', '.join(places) or 'none'}"
            )
            raise InputError(message, field=f"corners[{k}]")
        found.append(places[corner] if isinstance(corner, str) else corner)
    return found


def _corner_nodes(points: Array, boundary: BoolArray, corners: Iterable[Corner]) -> IntArray:
    """The numbers of the nodes that ``corners`` name."""
    found, on = [], np.flatnonzero(boundary)
    for k, corner in enumerate(corners):
        field = f"corners[{k}]"
        if isinstance(corner, int | np.integer) and not isinstance(corner, bool):
            if not (0 <= corner < len(boundary) and boundary[corner]):
                raise InputError(f"{field} = {corner} is no node on the boundary of the mesh", field=field)
            found.append(int(corner))
            continue
        try:
            place = np.asarray(corner, dtype=np.float64)
        except (TypeError, ValueError):
            place = np.full(1, np.nan)
        if place.shape != (2,) or not np.isfinite(place).all():
            message = f"{field} = {str(corner)[:40]!r}: give the number of a node, or its place (x, y)"
            raise InputError(message, field=field)
        found.append(int(on[((points[on] - place) ** 2).sum(axis=1).argmin()]))
    return np.array(found, dtype=np.int64)


def _lines(loop: IntArray, fixed: BoolArray) -> Iterator[Line]:
    """The lines of a closed line, with the fixed nodes as their ends."""
    ends = np.flatnonzero(fixed[loop])
    if len(ends) == 0:
        yield Line(nodes=loop, is_closed=True)
        return
    around = np.concatenate([loop, loop])
    for first, last in zip(ends, [*ends[1:], ends[0] + len(loop)], strict=True):
        yield Line(nodes=around[first : last + 1], is_closed=False)


def _edges_of(line: Line) -> IntArray:
    nodes = np.append(line.nodes, line.nodes[0]) if line.is_closed else line.nodes
    return np.column_stack([nodes[:-1], nodes[1:]])


def _check_places(points: Array, edges: HalfEdges, loops: list[IntArray]) -> None:
    """Refuse nodes of the boundary at the same place, and closed lines without an inside."""
    on = np.flatnonzero(edges.boundary)
    size = float(np.ptp(points, axis=0).max())
    found = scipy.spatial.KDTree(points[on]).query(points[on], k=2)
    distance, other = np.asarray(found[0]), np.asarray(found[1])
    near = int(distance[:, 1].argmin())
    if distance[near, 1] <= SAME_PLACE * size:
        one, two = sorted(
            (int(on[near]), int(on[other[near, 1]]) if other[near, 1] != near else int(on[other[near, 0]]))
        )
        x, y = points[one]
        message = (
            f"the nodes {one} and {two} lie at the same place ({x:.6g}, {y:.6g}): the cells on both sides are not"
            " connected there; merge such nodes (in Gmsh: Mesh > Remove duplicate nodes)"
        )
        raise InputError(message, field="points")
    for loop in loops:
        x, y = (points[loop, k] - points[loop[0], k] for k in range(2))
        area = 0.5 * float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum())
        length = float(np.hypot(np.roll(x, -1) - x, np.roll(y, -1) - y).sum())
        if abs(area) <= NO_AREA * length**2:
            nodes = loop[:6].tolist()
            message = (
                f"the cells do not meet along the nodes {nodes} near ({points[loop[0], 0]:.6g},"
                f" {points[loop[0], 1]:.6g}): a cell has the node of others in the middle of its edge; every edge must"
                " be shared whole by two cells"
            )
            raise InputError(message, field="cells")
