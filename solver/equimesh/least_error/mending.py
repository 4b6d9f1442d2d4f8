"""Folds of a mesh that comes from a coarser one, mended: the displacements of the nodes around them are averaged.

A cell whose nodes are all displaced by the same vector has the shape that it has in the first mesh. So where the
displacements of neighbours become more alike, folds vanish. The rest of the mesh stays as it is.
"""

from __future__ import annotations

import numpy as np

from equimesh.least_error.cells import Cells
from equimesh.least_error.charts import CurveChart
from equimesh.least_error.kernels import Nodes
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array, BoolArray, IntArray

SMALLEST_SHARE = 1e-2
"""Cells with a corner whose Jacobian is a smaller share of that of the first mesh are mended."""
MAX_ROUNDS = 60
"""Rounds of averaging, at most."""
ROUNDS_OF_MEANS = 10
"""Rounds after which the displacements are shortened, too: beside a bent curve equal ones can fold."""
SHORTENING = 0.8
"""The factor by which they are shortened in a round."""


def mended(chart: CurveChart, cells: Cells, first: Array, mesh: Array) -> Array:
    """The ``mesh`` with fewer folds, mostly with none; both are unknowns of the ``chart``, shape ``(2, nodes)``.

    Nodes of curves move along these. ``first`` is a valid mesh.
    """
    start = np.stack(chart.nodes(first))
    marks = np.zeros(mesh.shape[1], dtype=np.bool_)
    for done in range(MAX_ROUNDS):
        at = np.stack(chart.nodes(mesh))
        if not mark_folds(Nodes(at[0], at[1], cells.corners.reshape(-1)), start, SMALLEST_SHARE, marks):
            break
        copies, originals = cells.ties.T
        np.logical_or.at(marks, originals, marks[copies])
        changes = np.zeros_like(at)
        share = 1.0 if done < ROUNDS_OF_MEANS else SHORTENING
        average(at - start, cells.corners, (cells.starts, cells.places), marks, share, changes)
        step = chart.pulled(mesh, changes)
        cells.tie(step)
        mesh = mesh + step
    return mesh


@compiled
def mark_folds(nodes: Nodes, start: Array, least: float, marks: BoolArray) -> bool:
    """Mark the nodes of cells with a corner whose Jacobian is at most ``least`` times that at ``start``, and no others.

    Returns whether there are any. ``start`` are x and y of the nodes, shape ``(2, nodes)``.
    """
    x, y, corners = nodes
    found = False
    marks[:] = False
    for cell in range(corners.size // 4):
        is_bad = False
        for k in range(4):
            p, n, m = corners[4 * cell + k], corners[4 * cell + (k + 1) % 4], corners[4 * cell + (k + 3) % 4]
            before = (start[0, n] - start[0, p]) * (start[1, m] - start[1, p])
            before -= (start[1, n] - start[1, p]) * (start[0, m] - start[0, p])
            now = (x[n] - x[p]) * (y[m] - y[p]) - (y[n] - y[p]) * (x[m] - x[p])
            is_bad = is_bad or not now > least * before
        if is_bad:
            found = True
            for k in range(4):
                marks[corners[4 * cell + k]] = True
    return found


@compiled
def average(
    moves: Array, corners: IntArray, around: tuple[IntArray, IntArray], marks: BoolArray, share: float, out: Array
) -> None:
    """The changes that make the ``moves`` of marked nodes the means of their own and those of their neighbours.

    They are made ``share`` times these means. ``around`` are the places of the nodes in the ``corners`` of cells: where
    the entries of each node begin, and these. A neighbour counts once for every cell that it shares an edge with the
    node in.
    """
    starts, places = around
    for node in range(marks.size):
        if not marks[node]:
            continue
        a, b, count = moves[0, node], moves[1, node], 1
        for place in places[starts[node] : starts[node + 1]]:
            cell, k = divmod(place, 4)
            for other in (corners[cell, (k + 1) % 4], corners[cell, (k + 3) % 4]):
                a += moves[0, other]
                b += moves[1, other]
                count += 1
        out[0, node], out[1, node] = share * a / count - moves[0, node], share * b / count - moves[1, node]
