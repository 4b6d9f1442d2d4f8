"""The cells of any mesh of quadrilaterals, and the lines of nodes that run through them."""

from __future__ import annotations

import numpy as np

from equimesh.least_error.cells import Cells
from equimesh.meshes.quad_links import places_of
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array, IntArray
from equimesh_coupling.parts import cuts_at_corners


def cells_of_mesh(corners: IntArray, free: Array, ties: IntArray, *, are_cut: bool = False) -> Cells:
    """The cells with these ``corners``, shape ``(cells, 4)``, counter-clockwise.

    ``free`` is 1 where a coordinate of a node may change, else 0, shape ``(2, nodes)``. ``ties`` are pairs of nodes
    that move together, ``(copy, original)``. ``are_cut`` tells whether triangles of the cells are used.

    A line of nodes runs straight on through a node of four cells, and along the boundary through a node of two. It ends
    at other nodes: corners of the domain, and singular nodes.
    """
    nodes = free.shape[1]
    corners = np.ascontiguousarray(corners)
    starts, places = places_of(corners, nodes)
    originals = np.arange(nodes)
    originals[ties[:, 0]] = ties[:, 1]
    if ties.size:
        own = originals[corners]
        triples = _triples(own, *places_of(own, nodes))
    else:
        triples = _triples(corners, starts, places)
    return Cells(
        corners=corners,
        starts=starts,
        places=places,
        triples=triples,
        free=free,
        stiffness=_stiffness(triples, nodes),
        corner_cuts=cuts_at_corners(corners) if are_cut else {},
        ties=ties,
    )


@compiled
def _triples(corners: IntArray, starts: IntArray, places: IntArray) -> IntArray:
    """Three consecutive nodes of lines, those around one node together, shape ``(triples, 3)``."""
    out, count = np.empty((2 * (starts.size - 1), 3), dtype=np.int64), 0
    for node in range(starts.size - 1):
        first, size = starts[node], starts[node + 1] - starts[node]
        if size not in (2, 4):
            continue
        cell, corner = divmod(places[first], 4)
        ahead, behind = corners[cell, (corner + 1) % 4], corners[cell, (corner + 3) % 4]
        if size == 2:
            other, corner = divmod(places[first + 1], 4)
            ahead_there, behind_there = corners[other, (corner + 1) % 4], corners[other, (corner + 3) % 4]
            if behind == ahead_there:
                out[count] = ahead, node, behind_there
                count += 1
            elif ahead == behind_there:
                out[count] = behind, node, ahead_there
                count += 1
            continue
        for k in range(first + 1, first + 4):
            other, corner = divmod(places[k], 4)
            ahead_there, behind_there = corners[other, (corner + 1) % 4], corners[other, (corner + 3) % 4]
            if ahead_there not in (ahead, behind) and behind_there not in (ahead, behind):
                out[count] = ahead, node, ahead_there
                out[count + 1] = behind, node, behind_there
                count += 2
                break
    return out[:count].copy()


@compiled
def _stiffness(triples: IntArray, nodes: int) -> Array:
    """The sum of squared weights of each node in the second differences."""
    out = np.zeros(nodes)
    for k in range(triples.shape[0]):
        out[triples[k, 0]] += 1.0
        out[triples[k, 1]] += 4.0
        out[triples[k, 2]] += 1.0
    return out
