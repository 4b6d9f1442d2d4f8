"""Checks of curves and of initial meshes, whose errors name the place."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from equimesh.blocks.curves import BoundaryCurve
from equimesh.blocks.layout import Layout
from equimesh.blocks.overlaps import find_overlap
from equimesh.errors import InputError
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.numerics.types import Array

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


def check_not_folded(mesh: QuadMesh, fields: tuple[str, ...], remedy: str) -> None:
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
    graph = coo_array((np.ones(len(block)), (block, across[block, side])), shape=2 * (layout.block_count,))
    number, piece = connected_components(graph, directed=False)
    if number > 1:
        apart = int((piece != piece[0]).argmax())
        edges = " or ".join(layout.edge_name(int(edge)) for edge in layout.block_edges[apart])
        raise InputError(
            f"{names[apart]} is not connected with {names[0]}: no edge leads to it, so give {edges} to another block,"
            " with the same two vertices, or send the parts one by one",
            field=fields[apart],
        )


def check_not_overlapping(mesh: QuadMesh, layout: Layout, fields: Sequence[str]) -> None:
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
