"""From a description to its topology: edges by their vertices, and counts and gradings through opposite edges."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from equimesh.blocks.description import Description, Ends
from equimesh.blocks.grading import EVEN, Grading, is_same, reversed_grading
from equimesh.blocks.layout import BOTTOM, LEFT, RIGHT, RISES_WITH_BLOCK_ON_LEFT, TOP, Layout
from equimesh.errors import InputError
from equimesh.numerics.types import BoolArray, IntArray

# The corners of a block at which its sides begin and end: left, right, bottom, top, each with its index rising.
SIDE_CORNERS = ((0, 3), (1, 2), (0, 1), (3, 2))
# Nodes of one domain.
MAX_NODES = 50_000_000


@dataclass(frozen=True, kw_only=True, eq=False)
class Plan:
    """The topology of a description, and for each edge its grading from begin to end; ``edge_of`` finds an edge."""

    layout: Layout
    gradings: tuple[Grading, ...]
    edge_of: dict[frozenset[str], int]

    def find(self, ends: Ends, field: str) -> int:
        """The number of an edge; raises :class:`~equimesh.errors.InputError` where no block has it."""
        found = self.edge_of.get(frozenset(ends))
        if found is None:
            raise InputError(f"{ends[0]}-{ends[1]} is no edge of a block", field=field)
        return found


def plan_of(description: Description) -> Plan:
    """The topology of a description.

    Raises :class:`~equimesh.errors.InputError`, with the name of the edge, where counts or gradings contradict each
    other or are missing, where more than two blocks have an edge, and where two of them lie on the same side of it.
    """
    ends, edge_of = _edges(description)
    numbers = {name: k for k, name in enumerate(description.vertices)}
    table = np.array([[numbers[a], numbers[b]] for a, b in ends])
    block_edges, forward = _sides_of_blocks(description, ends, edge_of)
    _check_uses(description, ends, block_edges, forward)
    used = np.zeros(len(numbers), dtype=bool)
    used[table] = True
    if not used.all():
        name = list(numbers)[int((~used).argmax())]
        message = f"the vertex {name} is no corner of a block: add the block that has it, or leave it out"
        raise InputError(message, field=f"domain.vertices.{name}")
    joins = _joins(description, ends, edge_of, block_edges)
    given = _given_counts(description, ends, edge_of)
    counts = _spread_counts(given, block_edges, joins, ends)
    counts = np.maximum(1, np.floor(counts * description.refine + 0.5)).astype(np.int64)
    layout = Layout(
        edges=table,
        block_edges=block_edges,
        forward=forward,
        edge_counts=counts,
        joins=joins,
        vertex_names=tuple(numbers),
    )
    if layout.node_count > MAX_NODES:
        message = f"the mesh would have {layout.node_count} nodes: {MAX_NODES} are possible"
        raise InputError(message, field="domain.blocks")
    return Plan(layout=layout, gradings=_spread_gradings(description, ends, edge_of, layout), edge_of=edge_of)


def _edges(description: Description) -> tuple[list[Ends], dict[frozenset[str], int]]:
    """All edges of the blocks, in the direction of their entry, and their numbers by their vertices."""
    wanted = {}
    for entry in description.edges:
        if frozenset(entry.ends) in wanted:
            raise InputError(
                f"the edge {entry.ends[0]}-{entry.ends[1]} stands twice in edges: two vertices have one edge, so put a"
                " vertex between them where there are two lines",
                field=entry.field,
            )
        wanted[frozenset(entry.ends)] = entry.ends
    ends: list[Ends] = []
    edge_of: dict[frozenset[str], int] = {}
    for block in description.blocks:
        for first, last in SIDE_CORNERS:
            pair = block.corners[first], block.corners[last]
            if frozenset(pair) not in edge_of:
                edge_of[frozenset(pair)] = len(ends)
                ends.append(wanted.get(frozenset(pair), pair))
    for entry in description.edges:
        if frozenset(entry.ends) not in edge_of:
            raise InputError(f"{entry.ends[0]}-{entry.ends[1]} is no edge of a block", field=entry.field)
    return ends, edge_of


def _sides_of_blocks(
    description: Description, ends: list[Ends], edge_of: dict[frozenset[str], int]
) -> tuple[IntArray, BoolArray]:
    """The edge of each side of each block, and whether it runs as the index of the side."""
    block_edges = np.empty((len(description.blocks), 4), dtype=np.int64)
    forward = np.empty((len(description.blocks), 4), dtype=bool)
    for b, block in enumerate(description.blocks):
        for side, (first, last) in enumerate(SIDE_CORNERS):
            pair = block.corners[first], block.corners[last]
            edge = edge_of[frozenset(pair)]
            block_edges[b, side], forward[b, side] = edge, ends[edge] == pair
    return block_edges, forward


def _check_uses(description: Description, ends: list[Ends], block_edges: IntArray, forward: BoolArray) -> None:
    """Refuse an edge that more than two blocks have, or two on the same side of it."""
    on_left = forward == np.array(RISES_WITH_BLOCK_ON_LEFT)  # whether the block lies on the left of the edge
    uses: dict[int, list[tuple[int, int]]] = {}
    for b, edges in enumerate(block_edges.tolist()):
        for side, edge in enumerate(edges):
            uses.setdefault(edge, []).append((b, side))
    for edge, places in uses.items():
        if len(places) == 1:
            continue
        blocks = [b for b, _ in places]
        names = [description.blocks[block].name for block in blocks]
        name, field = f"{ends[edge][0]}-{ends[edge][1]}", f"{description.blocks[blocks[-1]].field}.corners"
        if len(blocks) > 2:
            message = f"the edge {name} is a side of {len(blocks)} blocks, {', '.join(names)}: two can have it at most"
            raise InputError(message, field=field)
        if on_left[places[0]] == on_left[places[1]]:
            raise InputError(
                f"the blocks {names[0]} and {names[1]} lie on the same side of their common edge {name}: list the"
                " corners of every block counter-clockwise",
                field=field,
            )


def _joins(
    description: Description, ends: list[Ends], edge_of: dict[frozenset[str], int], block_edges: IntArray
) -> IntArray:
    """The joined edges, as :class:`Layout` has them; refuses edges that are no boundary, or that differ in length."""
    found: list[tuple[int, int, int]] = []
    uses = np.bincount(block_edges.ravel(), minlength=len(ends))
    for k, pair in enumerate(description.joins):
        edges: list[int] = []
        for word, one in zip(("from", "to"), pair, strict=True):
            field, edge = f"domain.joins[{k}].{word}", edge_of.get(frozenset(one))
            if edge is None:
                raise InputError(f"{one[0]}-{one[1]} is no edge of a block", field=field)
            if uses[edge] != 1 or edge in [e for join in found for e in join[:2]] + edges:
                message = (
                    f"the edge {one[0]}-{one[1]} is inside, or joined already: join each edge of the boundary once"
                )
                raise InputError(message, field=field)
            edges.append(edge)
        (a, d), (b, c) = (tuple(np.array(description.vertices[name]) for name in one) for one in pair)
        size = max(float(np.hypot(*(d - a))), float(np.hypot(*(b - a))))
        if float(np.hypot(*((b - a) - (c - d)))) > 1e-9 * size:
            raise InputError(
                f"the edges {pair[0][0]}-{pair[0][1]} and {pair[1][0]}-{pair[1][1]} are no copies of each other by a"
                f" translation: {pair[1][0]} lies ({b[0] - a[0]:.6g}, {b[1] - a[1]:.6g}) from {pair[0][0]}, and"
                f" {pair[1][1]} lies ({c[0] - d[0]:.6g}, {c[1] - d[1]:.6g}) from {pair[0][1]}",
                field=f"domain.joins[{k}]",
            )
        same = (ends[edges[0]] == pair[0]) == (ends[edges[1]] == pair[1])
        found.append((edges[0], edges[1], int(same)))
    return np.array(found, dtype=np.int64).reshape(-1, 3)


def _given_counts(
    description: Description, ends: list[Ends], edge_of: dict[frozenset[str], int]
) -> dict[int, tuple[int, str]]:
    """The counts that blocks and edges give, each with its field; refuses two different ones of one edge."""
    given: dict[int, tuple[int, str]] = {}

    def put(edge: int, count: int | None, field: str) -> None:
        if count is None:
            return
        before, where = given.setdefault(edge, (count, field))
        if before != count:
            raise InputError(
                f"the edge {ends[edge][0]}-{ends[edge][1]} has {before} cells by {where.removeprefix('domain.')}, but"
                f" {count} by {field.removeprefix('domain.')}: give both the same number",
                field=field,
            )

    for entry in description.edges:
        put(edge_of[frozenset(entry.ends)], entry.cells, f"{entry.field}.cells")
    for block in description.blocks:
        for side, (first, last) in enumerate(SIDE_CORNERS):
            edge = edge_of[frozenset((block.corners[first], block.corners[last]))]
            put(edge, block.cells[0 if side in (BOTTOM, TOP) else 1], f"{block.field}.cells")
    return given


def _spread_counts(
    given: dict[int, tuple[int, str]], block_edges: IntArray, joins: IntArray, ends: list[Ends]
) -> IntArray:
    """The cells of every edge: those that are given, spread through opposite and joined edges."""
    opposite: dict[int, list[int]] = {edge: [] for edge in range(len(ends))}
    pairs = [*block_edges[:, [LEFT, RIGHT]].tolist(), *block_edges[:, [BOTTOM, TOP]].tolist(), *joins[:, :2].tolist()]
    for one, other in pairs:
        opposite[one].append(other)
        opposite[other].append(one)
    found = dict(given)
    todo = list(given)
    for edge in todo:  # grows while it runs: the edges that are reached from one whose count is known
        count, field = found[edge]
        for other in opposite[edge]:
            if other not in found:
                found[other] = count, field
                todo.append(other)
            elif found[other][0] != count:
                names = [f"{ends[e][0]}-{ends[e][1]}" for e in (edge, other)]
                raise InputError(
                    f"the edges {names[0]} and {names[1]} are opposite in a block, or joined, and have {count} cells by"
                    f" {field.removeprefix('domain.')}, but {found[other][0]} by"
                    f" {found[other][1].removeprefix('domain.')}: give both the same number",
                    field=found[other][1],
                )
    for edge, (first, last) in enumerate(ends):
        if edge not in found:
            raise InputError(
                f"no block gives the cells along the edge {first}-{last}, nor along those that are opposite to it:"
                " give a number in place of null in one of these blocks",
                field="domain.blocks",
            )
    return np.array([found[edge][0] for edge in range(len(ends))], dtype=np.int64)


def _spread_gradings(
    description: Description, ends: list[Ends], edge_of: dict[frozenset[str], int], layout: Layout
) -> tuple[Grading, ...]:
    """The grading of every edge from its begin: given, else that of an opposite edge, else even."""
    found: dict[int, Grading] = {}

    def put(edge: int, grading: Grading | None, along: bool, field: str) -> None:
        if grading is None:
            return
        here = grading if along else reversed_grading(grading)
        if not is_same(found.setdefault(edge, here), here):
            raise InputError(
                f"the edge {ends[edge][0]}-{ends[edge][1]} has two gradings: give it one, from {ends[edge][0]} to"
                f" {ends[edge][1]}, in each block that it is a side of",
                field=field,
            )

    for entry in description.edges:
        put(edge_of[frozenset(entry.ends)], entry.grading, True, f"{entry.field}.grading")
    own = dict(found)
    for b, block in enumerate(description.blocks):
        for side, grading in enumerate(block.gradings):
            edge = int(layout.block_edges[b, side])
            if edge not in own:  # an entry of edges goes before those of blocks
                put(edge, grading, bool(layout.forward[b, side]), f"{block.field}.grading")
    links = [
        (*layout.block_edges[b, pair], bool(np.equal(*layout.forward[b, pair])))
        for b in range(layout.block_count)
        for pair in ([LEFT, RIGHT], [BOTTOM, TOP])
    ]
    links += [(one, copy, bool(same)) for one, copy, same in layout.joins.tolist()]
    neighbours: dict[int, list[tuple[int, bool]]] = {edge: [] for edge in range(len(ends))}
    for one, other, same in links:
        neighbours[int(one)].append((int(other), same))
        neighbours[int(other)].append((int(one), same))
    todo = list(found)
    for edge in todo:
        for other, same in neighbours[edge]:
            if other not in found:
                found[other] = found[edge] if same else reversed_grading(found[edge])
                todo.append(other)
    for k, (one, copy, same) in enumerate(layout.joins.tolist()):
        here = found.get(copy, EVEN)
        if not is_same(found.get(one, EVEN), here if same else reversed_grading(here)):
            message = f"the joined edges {layout.edge_name(one)} and {layout.edge_name(copy)} have two gradings"
            raise InputError(f"{message}: give both the same", field=f"domain.joins[{k}]")
    return tuple(found.get(edge, EVEN) for edge in range(len(ends)))
