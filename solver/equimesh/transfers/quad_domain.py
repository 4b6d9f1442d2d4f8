"""Whether two meshes of quadrilaterals are ones of the same domain, by their boundaries."""

from __future__ import annotations

import numpy as np

from equimesh.errors import InputError
from equimesh.meshes.quad_links import QuadLinks, links_of
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.meshes.unrolled import moves_of
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array, IntArray
from equimesh.transfers.quad_cells import untied

MAX_CURVE_TURN = 0.8
"""The largest turn of a curve at a node of its mesh, in radians; a larger one is a corner."""


def require_valid_quads(mesh: QuadMesh) -> None:
    """Raise :class:`~equimesh.errors.InputError` for a folded mesh."""
    if mesh.is_folded:
        raise InputError(
            "a mesh is folded, or has a coordinate that is not finite: give one whose min_jacobian is positive",
            field="mesh",
        )


def boundary_of(mesh: QuadMesh) -> tuple[Array, Array]:
    """The nodes of the boundary, shape ``(k, 2)``, and its edges.

    Of each edge there are x and y of both ends, and how far a curve may be from it; shape ``(edges, 5)``. They are in
    the order of the loops of the boundary. Edges at a periodic join are none of the boundary; beyond such a join the
    other edges go on.
    """
    kept, number = untied(mesh)
    links = links_of(number[mesh.cells], kept.size)
    edges = in_loops(links, links.boundary())
    ends = [mesh.points[mesh.cells[edges // 4, (edges + step) % 4]] for step in (0, 1)]
    dx, dy = (ends[1] - ends[0]).T
    turns = np.zeros((2, kept.size))  # the directions of the edge that ends at a node, and of that which begins there
    begin, end = (links.cells[edges // 4, (edges + step) % 4] for step in (0, 1))
    turns[0, end], turns[1, begin] = np.arctan2(dy, dx), np.arctan2(dy, dx)
    turn = np.abs((turns[1] - turns[0] + np.pi) % (2.0 * np.pi) - np.pi)
    turn[turn > MAX_CURVE_TURN] = 0.0
    found = np.column_stack([*ends, np.hypot(dx, dy) * np.maximum(turn[begin], turn[end])])
    moves = moves_of(mesh)
    copies = [found + np.append(np.tile(move, 2), 0.0) for move in moves]
    return np.ascontiguousarray(ends[0]), np.concatenate(copies)


@compiled
def in_loops(links: QuadLinks, edges: IntArray) -> IntArray:
    """The edges of the boundary, as ``4 cell + edge``, each followed by the one that begins where it ends."""
    following = np.full(links.starts.size - 1, -1, dtype=np.int64)
    for at in range(edges.size):
        following[links.cells[edges[at] // 4, edges[at] % 4]] = at
    found, used, count = np.empty_like(edges), np.zeros(edges.size, dtype=np.bool_), 0
    for start in range(edges.size):
        at = start
        while at >= 0 and not used[at]:
            used[at] = True
            found[count] = edges[at]
            count += 1
            at = following[links.cells[edges[at] // 4, (edges[at] + 1) % 4]]
    return found
