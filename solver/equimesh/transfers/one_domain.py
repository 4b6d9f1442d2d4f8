"""Whether two meshes are ones of the same domain, by their sides."""

from __future__ import annotations

import numpy as np

from equimesh.errors import InputError
from equimesh.inputs import describe_value
from equimesh.meshes.cell_edges import QuadLinks, links_of
from equimesh.meshes.mesh import MIN_POINTS, Mesh
from equimesh.meshes.mesh_data import joined
from equimesh.meshes.unrolled import moves_of
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array, IntArray
from equimesh.transfers.integrals import untied

# Whether two meshes of quadrilaterals are ones of the same domain, by their boundaries.

MAX_CURVE_TURN = 0.8
"""The largest turn of a curve at a node of its mesh, in radians; a larger one is a corner."""


def boundary_of(mesh: Mesh) -> tuple[Array, Array]:
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


# The distance of sides, as a share of the extent of the domain, that counts as rounding: also in single precision.
MAX_ROUNDING = 1e-6
# The largest turn at a node, in radians, that is counted: an edge cannot be further from its curve than its length.
MAX_TURN = 1.0


def require_valid(mesh: object) -> None:
    """Raise :class:`~equimesh.errors.InputError` for what is no mesh, a folded one, and less than 4 nodes a side."""
    if not isinstance(mesh, Mesh):
        raise InputError(f"a mesh is needed, such as solution.mesh, not {describe_value(mesh)}", field="mesh")
    if mesh.is_grid and min(mesh.x.shape) < MIN_POINTS:
        raise InputError(
            f"a mesh has {mesh.x.shape[0]} x {mesh.x.shape[1]} nodes: at least {MIN_POINTS} in each direction are"
            " needed",
            field="mesh",
        )
    if mesh.is_folded:
        raise InputError(
            "a mesh is folded, or has a coordinate that is not finite: give one whose min_jacobian is positive",
            field="mesh",
        )


def require_one_domain(mesh: Mesh, new_mesh: Mesh) -> None:
    """Raise :class:`~equimesh.errors.InputError` unless both meshes are valid ones of the same domain.

    Each node on a side of one mesh must lie on a side of the other one: up to rounding where that is straight, and
    where it is curved up to the product of the length of the edge and the turn at its ends, which is 8 times the
    distance of an arc from its chord.
    """
    for one in (mesh, new_mesh):
        require_valid(one)
    if have_seams(mesh, new_mesh):
        mesh, new_mesh = joined(mesh), joined(new_mesh)
    old, new = _boundary(mesh), _boundary(new_mesh)
    rounding = MAX_ROUNDING * max(np.ptp(mesh.x), np.ptp(mesh.y))
    for (points, _), (_, edges) in ((new, old), (old, new)):
        found = first_beyond(points, edges, rounding)
        if found >= 0:
            raise InputError(
                f"the node at ({points[found, 0]:.6g}, {points[found, 1]:.6g}) of a side of one mesh does not lie on a"
                " side of the other one: fields are carried between two meshes of one domain",
                field="mesh",
            )


def have_seams(mesh: Mesh, new_mesh: Mesh) -> bool:
    """Whether both meshes are grids with closed lines, whose seams are no sides."""
    return all(one.is_grid and len(one.ties) > 0 for one in (mesh, new_mesh))


def _boundary(mesh: Mesh) -> tuple[Array, Array]:
    """The nodes of the boundary, shape ``(nodes, 2)``, and its edges as in :func:`_edges`."""
    if not mesh.is_grid:
        return boundary_of(mesh)
    sides = _sides(mesh)
    return np.concatenate(sides), np.concatenate([_edges(side) for side in sides])


def _sides(mesh: Mesh) -> list[Array]:
    """The nodes of the four sides, shape ``(nodes, 2)`` each."""
    return [
        np.column_stack([mesh.x[side], mesh.y[side]]).astype(float)
        for side in (np.s_[0], np.s_[-1], np.s_[:, 0], np.s_[:, -1])
    ]


def _edges(side: Array) -> Array:
    """The edges of a side: x and y of both ends, and how far a curve may be from them; shape ``(edges, 5)``."""
    dx, dy = np.diff(side, axis=0).T
    turns = np.abs(np.arctan2(dx[:-1] * dy[1:] - dy[:-1] * dx[1:], dx[:-1] * dx[1:] + dy[:-1] * dy[1:]))
    turn = np.maximum(np.append(turns, 0.0), np.append(0.0, turns))  # the larger one of both ends
    return np.column_stack([side[:-1], side[1:], np.hypot(dx, dy) * np.minimum(turn, MAX_TURN)])


@compiled
def first_beyond(points: Array, edges: Array, rounding: float) -> int:
    """The number of the first point that is too far from all ``edges``; -1 where there is none.

    The search begins at the edge that was near the point before.
    """
    count, near = edges.shape[0], 0
    for p in range(points.shape[0]):
        is_near = False
        for step in range(count):
            k = (near + step) % count
            ex, ey = edges[k, 2] - edges[k, 0], edges[k, 3] - edges[k, 1]
            px, py = points[p, 0] - edges[k, 0], points[p, 1] - edges[k, 1]
            along = min(max((px * ex + py * ey) / (ex * ex + ey * ey), 0.0), 1.0)
            if np.hypot(px - along * ex, py - along * ey) <= rounding + edges[k, 4]:
                near, is_near = k, True
                break
        if not is_near:
            return p
    return -1
