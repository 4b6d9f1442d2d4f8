"""Checks of curves and of initial meshes, whose errors name the place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from equimesh.blocks.curves import BoundaryCurve
from equimesh.blocks.layout import Layout
from equimesh.errors import InputError
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.types import Array, BoolArray, IntArray

# Places that a mesh covers twice, where no cell is inverted.
#
# All cells have the same orientation. So a place is covered as often as the boundary winds around it, and where this
# number changes, there is a boundary. It is enough to compare the cells at edges of the boundary that meet. Where
# none of them overlap, the number is the same all along each closed line of the boundary, and one place of each line
# tells it. Boxes of edges are small also where cells are long, thin and slanted, whose own boxes nearly all overlap.

# Cells that touch overlap by rounding: by this share of the size of the mesh at most.
TOUCHING = 1e-8
# Pairs of cells that are compared at once.
PAIRS_AT_ONCE = 1 << 16


@dataclass(frozen=True, kw_only=True)
class Overlap:
    """Two cells that cover the same ``place``; ``is_inside`` where the first one lies in others with its boundary."""

    cells: tuple[int, int]
    place: tuple[float, float]
    is_inside: bool


def find_overlap(mesh: Mesh) -> Overlap | None:
    """Two cells of a mesh that is not folded, which overlap, one of them at the boundary; none where there are none."""
    edges = np.concatenate(list(mesh.sides.values()))
    order = np.full(len(mesh.points), len(edges))
    order[edges[::-1, 0]] = np.arange(len(edges))[::-1]
    first = order[mesh.cells].min(axis=1)
    at_boundary = np.flatnonzero(first < len(edges))
    at_boundary = at_boundary[np.argsort(first[at_boundary], kind="stable")]  # along the boundary
    corners = mesh.points[mesh.cells[at_boundary]]
    touching = TOUCHING * float(np.ptp(corners, axis=(0, 1)).max())
    one, other = _pairs_of_cells(mesh, edges, at_boundary, touching)
    for start in range(0, len(one), PAIRS_AT_ONCE):
        a, b = (corners[pair[start : start + PAIRS_AT_ONCE]] for pair in (one, other))
        depth = np.minimum(_depth(a, b), _depth(b, a))
        k = int(depth.argmax())
        if depth[k] > touching:
            low, high = np.maximum(a[k].min(axis=0), b[k].min(axis=0)), np.minimum(a[k].max(axis=0), b[k].max(axis=0))
            cells = int(at_boundary[one[start + k]]), int(at_boundary[other[start + k]])
            return Overlap(cells=cells, place=_pair(0.5 * (low + high)), is_inside=False)
    return _inside_others(mesh, edges, at_boundary)


def _inside_others(mesh: Mesh, edges: IntArray, at_boundary: IntArray) -> Overlap | None:
    """The overlap at a closed line of the boundary around which others wind, too."""
    size = len(mesh.points)
    graph = scipy.sparse.coo_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(size, size))
    _, line = scipy.sparse.csgraph.connected_components(graph, directed=False)
    on = np.zeros(size, dtype=bool)
    on[edges] = True
    cells = mesh.cells[at_boundary]
    of_cell = line[cells[np.arange(len(cells)), on[cells].argmax(axis=1)]]
    for k in np.unique(of_cell, return_index=True)[1].tolist():
        place = mesh.points[cells[k]].mean(axis=0)
        if _turns(mesh.points[edges], place) > 1:
            around = np.flatnonzero(_holds(mesh.points[mesh.cells], place))
            other = int(around[around != at_boundary[k]][0])
            return Overlap(cells=(int(at_boundary[k]), other), place=_pair(place), is_inside=True)
    return None


def _pairs_of_cells(mesh: Mesh, edges: IntArray, cells: IntArray, touching: float) -> tuple[IntArray, IntArray]:
    """The pairs of places in ``cells`` whose cells are at two edges of the boundary that meet, each once."""
    ends = mesh.points[edges]
    one, other = _pairs_of_boxes(ends.min(axis=1) - touching, ends.max(axis=1) + touching)
    same = np.arange(len(edges))
    meets = _incidence(np.append(one, same), np.append(other, same), (len(edges), len(edges)))
    of_edge = _incidence(np.repeat(same, 2), edges.ravel(), (len(edges), len(mesh.points)))
    of_cell = _incidence(mesh.cells[cells].ravel(), np.repeat(np.arange(len(cells)), 4), (len(mesh.points), len(cells)))
    at_edge = of_edge @ of_cell
    pairs = np.sort(np.column_stack((at_edge.T @ meets @ at_edge).nonzero()).astype(np.int64), axis=1)
    found = np.unique(pairs[pairs[:, 0] < pairs[:, 1]], axis=0)
    return found[:, 0], found[:, 1]


def _incidence(row: IntArray, column: IntArray, shape: tuple[int, int]) -> scipy.sparse.csr_array:
    return scipy.sparse.coo_array((np.ones(len(row)), (row, column)), shape=shape).tocsr()


def _pairs_of_boxes(low: Array, high: Array) -> tuple[IntArray, IntArray]:
    """The pairs of boxes that overlap, each once, the lower number first.

    Boxes with near numbers should be near: a tree of boxes around pairs of them, pairs of pairs, and so on is searched.
    """
    levels = [(low, high)]
    while len(levels[-1][0]) > 1:
        low, high = levels[-1]
        if len(low) % 2:
            low, high = np.concatenate([low, low[-1:]]), np.concatenate([high, high[-1:]])
        levels.append((np.minimum(low[::2], low[1::2]), np.maximum(high[::2], high[1::2])))
    one = other = np.zeros(1, dtype=np.int64)
    for low, high in levels[-2::-1]:
        one = (2 * one[:, None] + np.array([0, 0, 1, 1])).ravel()
        other = (2 * other[:, None] + np.array([0, 1, 0, 1])).ravel()
        kept = (one <= other) & (other < len(low))
        one, other = one[kept], other[kept]
        kept = ((low[one] < high[other]) & (low[other] < high[one])).all(axis=1) | (one == other)
        one, other = one[kept], other[kept]
    return one[one != other], other[one != other]


def _depth(a: Array, b: Array) -> Array:
    """How far each quadrilateral of ``b`` reaches into that of ``a`` at least, by the edges of ``a``; ``(k, 4, 2)``."""
    along = np.roll(a, -1, axis=1) - a
    away = b[:, None] - a[:, :, None]
    inwards = along[..., None, 0] * away[..., 1] - along[..., None, 1] * away[..., 0]
    return np.asarray((inwards.max(axis=2) / np.hypot(along[..., 0], along[..., 1])).min(axis=1))


def _turns(edges: Array, place: Array) -> int:
    """How often the ``edges``, shape ``(k, 2, 2)``, wind around a place that is on none of them."""
    (x0, y0), (x1, y1) = (edges - place).transpose(1, 2, 0)
    left = x0 * y1 - y0 * x1 > 0.0
    return int(((y0 <= 0.0) & (y1 > 0.0) & left).sum() - ((y0 > 0.0) & (y1 <= 0.0) & ~left).sum())


def _holds(corners: Array, place: Array) -> BoolArray:
    """Which convex quadrilaterals, shape ``(m, 4, 2)``, hold a place."""
    away, along = place - corners, np.roll(corners, -1, axis=1) - corners
    return np.asarray((along[..., 0] * away[..., 1] - along[..., 1] * away[..., 0] >= 0.0).all(axis=1))


def _pair(place: Array) -> tuple[float, float]:
    return float(place[0]) + 0.0, float(place[1]) + 0.0


# Pieces of a curve in the search for crossings.
PIECES = 600
# Lines that touch to rounding do not cross: as a share of the square of the size.
ROUNDING = 1e-12


def check_not_crossing(curve: BoundaryCurve, name: str, field: str) -> None:
    """Refuse a curve that crosses itself; the message has the place."""
    t = np.linspace(*curve.ends, PIECES + 1)
    line = np.column_stack(curve.evaluate(t)[:2])
    a, b = line[:-1], line[1:]
    starts, ends = _turn(a[:, None], b[:, None], a[None, :]), _turn(a[:, None], b[:, None], b[None, :])
    apart = ROUNDING * float(np.ptp(line, axis=0).max()) ** 2
    astride = (np.minimum(starts, ends) < -apart) & (np.maximum(starts, ends) > apart)
    crossing = np.triu(astride & astride.T, 2)
    if curve.closed:
        crossing[0, -1] = False
    if crossing.any():
        i, j = (int(k) for k in np.argwhere(crossing)[0])
        raise InputError(
            f"{name} crosses itself near ({a[i, 0]:.4g}, {a[i, 1]:.4g}), at t = {t[i]:.4g} and t = {t[j]:.4g}: order"
            " its points along the line, around a profile once, from the trailing edge to the trailing edge",
            field=field,
        )


def check_not_folded(mesh: Mesh, fields: tuple[str, ...], remedy: str) -> None:
    """Refuse an initial mesh with an inverted cell; the message names its block and place."""
    if not mesh.is_folded:
        return
    for k, block in enumerate(mesh.blocks):
        part = mesh.block_mesh(k)
        if not part.is_folded:
            continue
        jacobians = part.corner_jacobians().min(axis=0)
        if (jacobians < 0).all():
            raise InputError(
                f"{mesh.block_names[k]} is inside out: list its corners counter-clockwise, and blocks around a closed"
                " line with the side on that line as the first or the last of i",
                field=fields[k],
            )
        i, j = (int(n) for n in np.unravel_index(int(jacobians.argmin()), jacobians.shape))
        x, y = mesh.points[block[i : i + 2, j : j + 2].ravel()].mean(axis=0) + 0.0
        raise InputError(
            f"{mesh.block_names[k]} folds at ({x:.5g}, {y:.5g}), in its cell ({i}, {j}) of"
            f" {jacobians.shape[0]} x {jacobians.shape[1]}: {remedy}",
            field=fields[k],
        )


def check_connected(layout: Layout, names: Sequence[str], fields: Sequence[str]) -> None:
    """Refuse blocks that no common or joined edges lead to; the message names one, and where it comes near."""
    across = layout.neighbours[..., 0]
    block, side = np.nonzero(across >= 0)
    graph = scipy.sparse.coo_array((np.ones(len(block)), (block, across[block, side])), shape=2 * (layout.block_count,))
    number, piece = scipy.sparse.csgraph.connected_components(graph, directed=False)
    if number > 1:
        apart = int((piece != piece[0]).argmax())
        edges = " or ".join(layout.edge_name(int(edge)) for edge in layout.block_edges[apart])
        raise InputError(
            f"{names[apart]} is not connected with {names[0]}: no edge leads to it, so give {edges} to another block,"
            " with the same two vertices, or send the parts one by one",
            field=fields[apart],
        )


def check_not_overlapping(mesh: Mesh, layout: Layout, fields: Sequence[str]) -> None:
    """Refuse an initial mesh that covers a place twice; the message names blocks, edges of the boundary, and place."""
    found = find_overlap(mesh)
    if found is None:
        return
    ends = np.cumsum([block.size for block in mesh.block_cells])
    one, other = (int(np.searchsorted(ends, cell, side="right")) for cell in found.cells)
    edge_nodes = layout.edge_nodes(mesh.blocks)
    edge_at = np.full(len(mesh.points), -1)
    for edge in np.flatnonzero(layout.edge_uses == 1).tolist():
        edge_at[edge_nodes[edge]] = edge
    edges = [
        layout.edge_name(int(edge_at[mesh.cells[cell]].max())) for cell in found.cells[: 1 if found.is_inside else 2]
    ]
    names = mesh.block_names[one], mesh.block_names[other]
    who = f"{names[0]} overlaps itself" if one == other else f"{names[0]} and {names[1]} overlap"
    x, y = found.place
    if found.is_inside:
        how = f"the closed line of the boundary with the edge {edges[0]} lies inside of {names[1]}"
    else:
        how = f"at the boundary {' and '.join(sorted(set(edges)))}"
    raise InputError(
        f"{who} near ({x:.5g}, {y:.5g}): {how}; move their vertices or curves apart, or name the same two vertices in"
        " both blocks where they have an edge in common; where bent lines come near each other, take more cells",
        field=fields[max(one, other)],
    )


def _turn(a: Array, b: Array, c: Array) -> Array:
    """Twice the area of the triangles abc: positive where they are counter-clockwise."""
    return np.asarray(
        (b[..., 0] - a[..., 0]) * (c[..., 1] - a[..., 1]) - (b[..., 1] - a[..., 1]) * (c[..., 0] - a[..., 0])
    )
