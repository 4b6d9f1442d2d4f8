"""From points, cells and sides to all that a domain of blocks consists of."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from equimesh.blocks.checks import find_overlap
from equimesh.blocks.curves import BoundaryCurve
from equimesh.blocks.layout import Layout
from equimesh.blocks.recovery.boundary import Boundary, Corner
from equimesh.blocks.recovery.half_edges import HalfEdges, blocks_of, counter_clockwise
from equimesh.blocks.recovery.shapes import curve_through
from equimesh.domains.domain import MAX_COORDINATE
from equimesh.errors import InputError
from equimesh.inputs import real_array
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.types import Array, IntArray

# The layout of blocks that are given as arrays of nodes: which edges and vertices they have in common.


def layout_of(blocks: Sequence[IntArray]) -> tuple[Layout, IntArray]:
    """The layout of ``blocks`` of nodes, shape ``(n_i, n_j)`` each, which share whole edges; the node of each vertex.

    Edges and vertices are numbered in the order of the nodes at their ends.
    """
    flat = np.concatenate([block.reshape(-1) for block in blocks])
    n_i, n_j = np.array([block.shape for block in blocks]).T
    starts = np.cumsum(n_i * n_j) - n_i * n_j
    along_i, along_j = (np.stack([0 * n, 0 * n + 1, n - 2, n - 1], axis=1) for n in (n_i, n_j))
    upright, level = starts[:, None] + along_j, starts[:, None] + along_i * n_j[:, None]
    lines = [upright, upright + ((n_i - 1) * n_j)[:, None], level, level + (n_j - 1)[:, None]]
    ends, lengths = flat[np.stack(lines, axis=1)], np.stack([n_j, n_j, n_i, n_i], axis=1) - 1
    rows = ends.reshape(-1, 4)
    # An edge is known by its first step from the lower of its ends; a closed one by the lower of both steps.
    forward = (rows[:, 0] < rows[:, 3]) | ((rows[:, 0] == rows[:, 3]) & (rows[:, 1] <= rows[:, 2]))
    ahead = np.where(forward[:, None], rows, rows[:, ::-1])
    step = ahead[:, 0] * (int(flat.max()) + 1) + ahead[:, 1]
    _, first, edge = np.unique(step, return_index=True, return_inverse=True)
    nodes, vertex = np.unique(ahead[first][:, [0, 3]], return_inverse=True)
    layout = Layout(
        edges=vertex.reshape(-1, 2).astype(np.int64),
        block_edges=edge.reshape(-1, 4).astype(np.int64),
        forward=forward.reshape(-1, 4),
        edge_counts=lengths.ravel()[first],
    )
    return layout, nodes


@dataclass(frozen=True, kw_only=True, eq=False)
class RecoveredBlocks:
    """What a domain of blocks is assembled from: its mesh and layout, and for each boundary edge its curve.

    ``on_curves`` has, by the number of an edge of the layout, the number of its curve and the parameters of its nodes
    from begin to end. ``corners`` are the vertices that stay in their place.
    """

    mesh: Mesh
    layout: Layout
    curves: tuple[BoundaryCurve, ...]
    on_curves: Mapping[int, tuple[int, Array]]
    corners: IntArray


def recover(
    points: object,
    cells: object,
    sides: Mapping[str, object],
    *,
    corners: Iterable[Corner] = (),
    corner_angle: float | None = None,
    names: Mapping[str, str] | None = None,
    blocks_of_file: Sequence[tuple[str, int]] = (),
) -> RecoveredBlocks:
    """The blocks of any mesh of quadrilaterals, by lines from its irregular nodes and corners.

    The arguments are those of :meth:`equimesh.blocks.blocks.Blocks.of_mesh`, which has the errors, too. The names of
    blocks are those of ``blocks_of_file``, names and numbers of cells, from which their cells are.
    """
    places = real_array(points, "points", ndim=2)
    if places.shape[1] != 2:
        raise InputError(f"points has shape {places.shape}: it must be (n, 2)", field="points")
    if np.abs(places).max(initial=0.0) > MAX_COORDINATE:
        node = int(np.abs(places).max(axis=1).argmax())
        message = (
            f"node {node} is at {places[node].tolist()}: coordinates of at most {MAX_COORDINATE:g} in size are possible"
        )
        raise InputError(message, field="points")
    quads = counter_clockwise(places, _cells(cells, len(places)))
    edges = HalfEdges.of(places, quads)
    tables = {name: _table(table, len(places), f"sides.{name}", 2) for name, table in sides.items()}
    boundary = Boundary.of(places, edges, tables, corners=corners, corner_angle=corner_angle)
    vertices = np.zeros(len(places), np.bool_)
    vertices[boundary.corners] = True
    blocks, block_cells = blocks_of(edges, vertices)
    layout, nodes = layout_of(blocks)
    mesh = Mesh(
        points=places,
        cells=quads,
        sides=_renamed(boundary.sides, names or {}),
        blocks=tuple(blocks),
        block_names=_names_of(block_cells, blocks_of_file, len(quads)),
    )
    vars(mesh)["block_cells"] = tuple(block_cells)
    if (overlap := find_overlap(mesh)) is not None:
        (one, other), (x, y) = overlap.cells, overlap.place
        message = f"the cells {one} and {other} overlap near ({x:.6g}, {y:.6g}): repair the mesh there"
        raise InputError(message, field="cells")
    size = float(np.ptp(places, axis=0).max())
    found = [curve_through(places, line, size) for line in boundary.lines]
    parameters = [t for _, t in found]
    return RecoveredBlocks(
        mesh=mesh,
        layout=layout,
        curves=tuple(curve for curve, _ in found),
        on_curves=_on_curves(layout, mesh, boundary, parameters),
        corners=np.flatnonzero(np.isin(nodes, boundary.corners)),
    )


def _names_of(block_cells: Sequence[IntArray], blocks: Sequence[tuple[str, int]], count: int) -> tuple[str, ...]:
    """A name for each block: those of the file that its cells are of, and a number where a name comes again."""
    sizes = [size for _, size in blocks]
    if sum(sizes) != count:
        return ()
    owner = np.repeat(np.arange(len(blocks)), sizes)
    found: dict[str, None] = {}
    uses: dict[str, int] = {}
    for cells in block_cells:
        first = name = "+".join(blocks[k][0] for k in np.unique(owner[cells]))
        while name in found:
            uses[first] = uses.get(first, 1) + 1
            name = f"{first}_{uses[first]}"
        found[name] = None
    return tuple(found)


def _on_curves(layout: Layout, mesh: Mesh, boundary: Boundary, parameters: list[Array]) -> dict[int, tuple[int, Array]]:
    """For each edge on the boundary the number of its line, and the parameters of its nodes."""
    line_at, place_at = np.full(len(mesh.points), -1), np.zeros(len(mesh.points), np.int64)
    following = np.full(len(mesh.points), -1)
    for number, line in enumerate(boundary.lines):
        nodes = np.append(line.nodes, line.nodes[0]) if line.is_closed else line.nodes
        line_at[nodes[:-1]], place_at[nodes[:-1]] = number, np.arange(len(nodes) - 1)
        following[nodes[:-1]] = nodes[1:]
    result, edge_nodes = {}, layout.edge_nodes(mesh.blocks)
    for edge in layout.boundary.tolist():
        nodes = edge_nodes[edge]
        along = following[nodes[0]] == nodes[1]
        first = nodes[0] if along else nodes[-1]
        number, place = int(line_at[first]), int(place_at[first]) + np.arange(len(nodes))
        t = parameters[number]
        if boundary.lines[number].is_closed:
            turns, place = np.divmod(place, len(t) - 1)
            values = t[place] + turns * (t[-1] - t[0])
        else:
            values = t[place]
        result[edge] = number, values if along else values[::-1]
    return result


def _cells(value: object, count: int) -> IntArray:
    """The cells as an array of four nodes each."""
    cells = np.asarray(value)
    if cells.ndim == 2 and cells.shape[1] == 3:
        message = (
            "cells has three columns, which are triangles: only quadrilaterals can be adapted; make a mesh of"
            " quadrilaterals, in Gmsh by Recombine with the subdivision algorithm 'All Quads'"
        )
        raise InputError(message, field="cells")
    found = _table(value, count, "cells", 4)
    if len(found) == 0:
        raise InputError("cells is empty: a mesh has at least one cell", field="cells")
    unused = np.bincount(found.ravel(), minlength=count) == 0
    if unused.any():
        raise InputError(f"node {int(unused.argmax())} is in no cell: leave out such points", field="points")
    return found


def _table(value: object, count: int, field: str, columns: int) -> IntArray:
    """Rows of node numbers."""
    table = np.asarray(value)
    if table.ndim != 2 or table.shape[1] != columns or table.dtype.kind not in "iu":
        message = f"{field} has the shape {table.shape} and the type {table.dtype}: integers, shape (k, {columns})"
        raise InputError(message, field=field)
    bad = (table < 0) | (table >= count)
    if bad.any():
        row = int(bad.any(axis=1).argmax())
        message = f"{field}[{row}] has the nodes {table[row].tolist()}: nodes have the numbers 0 to {count - 1}"
        raise InputError(message, field=field)
    return np.ascontiguousarray(table, dtype=np.int64)


def _renamed(sides: Mapping[str, IntArray], names: Mapping[str, str]) -> dict[str, IntArray]:
    """The sides with other names; sides that get one name become one side."""
    for name in names:
        if name not in sides:
            raise InputError(f"names has {name!r}, but the sides are {', '.join(sides)}", field="names")
    found: dict[str, list[IntArray]] = {}
    for name, edges in sides.items():
        found.setdefault(names.get(name, name), []).append(edges)
    return {name: np.concatenate(tables) for name, tables in found.items()}
