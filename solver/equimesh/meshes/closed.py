"""Meshes with closed grid lines, in reference coordinates: their memory with copied ends, and finer grids.

The arrays of a mesh hold both copies of a seam: the last row is the first one, moved by 1. In working memory one more
row of copies stands before the first one, so that every node of a closed line has two neighbours.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from equimesh.meshes.folding import largest_difference
from equimesh.meshes.grid import Grid
from equimesh.meshes.interpolation import WIDTH, Rule, fixed_rule, interpolate, lagrange
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.nested import refinement
from equimesh.numerics.types import Array, IntArray

Closed: TypeAlias = tuple[bool, bool]
"""Whether the xi-lines and the eta-lines are closed."""
OPEN: Closed = (False, False)
"""No closed lines."""


def padded_shape(shape: tuple[int, int], closed: Closed) -> tuple[int, int]:
    """The shape of a mesh in working memory."""
    return shape[0] + closed[0], shape[1] + closed[1]


def padded(mesh: Mesh, closed: Closed) -> Mesh:
    """A copy of the mesh with the row or column of copies before the first one."""
    before = int(closed[0]), int(closed[1])
    return Mesh(*(_extended(q, axis, closed, before, (0, 0)) for axis, q in enumerate((mesh.x, mesh.y))))


def unpadded(x: Array, y: Array, closed: Closed) -> Mesh:
    """The mesh in working memory without the row or column before the first one, in the same memory."""
    inside = slice(int(closed[0]), None), slice(int(closed[1]), None)
    return Mesh(x[inside], y[inside])


def closed_mesh(mesh: Mesh, closed: Closed) -> Mesh:
    """A copy of the mesh with straight sides where these are no seams, and the last copy of a seam as the first one."""
    x, y = np.array(mesh.x, order="C"), np.array(mesh.y, order="C")
    if closed[0]:
        x[-1], y[-1] = x[0] + 1.0, y[0]
    else:
        x[0], x[-1] = 0.0, 1.0
    if closed[1]:
        x[:, -1], y[:, -1] = x[:, 0], y[:, 0] + 1.0
    else:
        y[:, 0], y[:, -1] = 0.0, 1.0
    return Mesh(x, y)


def prolong_closed(mesh: Mesh, grid: Grid, closed: Closed, coarser: Mesh | None = None) -> Mesh:
    """The mesh interpolated to another grid, across the seams; as :func:`~equimesh.meshes.nested.prolong`."""
    if coarser is not None:
        share = (1.0 - 1.0 / refinement(grid, mesh.grid)) / (refinement(mesh.grid, coarser.grid) - 1.0)
        rough = interpolated_closed(coarser, mesh.grid, closed)
        lifted = Mesh(mesh.x + share * (mesh.x - rough.x), mesh.y + share * (mesh.y - rough.y))
        candidate = interpolated_closed(lifted, grid, closed)
        if not candidate.is_folded:
            return candidate
    for cubic in (True, False):
        candidate = interpolated_closed(mesh, grid, closed, cubic=cubic)
        if not candidate.is_folded:
            return candidate
    return Mesh.uniform(grid)


def interpolated_closed(mesh: Mesh, grid: Grid, closed: Closed, *, cubic: bool = True) -> Mesh:
    """The interpolant of a mesh on another grid; closed lines have no ends at which a rule would be one-sided."""
    found = [interpolated_across(q, grid.shape, closed, axis, cubic=cubic) for axis, q in enumerate((mesh.x, mesh.y))]
    return closed_mesh(Mesh(*found), closed)


def interpolated_across(
    values: Array, shape: tuple[int, int], closed: Closed, axis: int | None = None, *, cubic: bool = True
) -> Array:
    """Nodal values of a mesh with closed lines on a grid of another shape.

    ``axis`` is that of the coordinate that they are, which grows by 1 along a closed line; ``None`` for values that
    do not grow.
    """
    ends = (WIDTH // 2 * closed[0], WIDTH // 2 * closed[1])
    rules = [_rule(coarse, n, end, cubic=cubic) for coarse, n, end in zip(values.shape, shape, ends, strict=True)]
    fine = np.empty(shape)
    interpolate(_extended(values, axis, closed, ends, ends), rules[0], rules[1], (0, shape[0]), fine, True)
    return fine


def distance_closed(mesh: Mesh, coarse: Mesh, closed: Closed) -> float:
    """The largest difference of a coordinate between a mesh and one on a coarser grid, at the common nodes if any."""
    steps = [(n - 1) // (m - 1) for n, m in zip(mesh.grid.shape, coarse.grid.shape, strict=True)]
    if all((m - 1) * step == n - 1 for n, m, step in zip(mesh.grid.shape, coarse.grid.shape, steps, strict=True)):
        here = Mesh(mesh.x[:: steps[0], :: steps[1]], mesh.y[:: steps[0], :: steps[1]])
        return max(largest_difference(here.x, coarse.x), largest_difference(here.y, coarse.y))
    fine = interpolated_closed(coarse, mesh.grid, closed)
    return max(largest_difference(mesh.x, fine.x), largest_difference(mesh.y, fine.y))


def tied_nodes(shape: tuple[int, int], closed: Closed) -> IntArray:
    """The pairs (copy, original) of node numbers that are one node of a closed line, shape ``(k, 2)``."""
    number = np.arange(shape[0] * shape[1], dtype=np.int64).reshape(shape)
    original = number.copy()
    if closed[0]:
        original[-1] = original[0]
    if closed[1]:
        original[:, -1] = original[:, 0]
    copies = original != number
    return np.column_stack([number[copies], original[copies]])


def _rule(coarse: int, fine: int, ends: int, *, cubic: bool) -> Rule:
    """The rule between grids of one direction, of which the coarse one has ``ends`` more points at either end."""
    place = np.arange(fine) * (coarse - 1) / (fine - 1)
    cell = np.minimum(place.astype(np.int64), coarse - 2)
    first = np.clip(cell - 1, -ends, coarse + ends - WIDTH)
    weights, every = np.zeros((WIDTH, fine)), np.arange(fine)
    if cubic:
        weights[:] = lagrange((cell - first) + (place - cell))
    else:
        weights[cell - first, every], weights[cell - first + 1, every] = 1.0 - (place - cell), place - cell
    return fixed_rule(first + ends, weights)


def _extended(q: Array, axis: int | None, closed: Closed, before: tuple[int, int], after: tuple[int, int]) -> Array:
    """A coordinate (``axis`` 0: x, 1: y) with copied nodes before the first ones and after the last ones."""
    for direction in (0, 1):
        if not closed[direction]:
            continue
        lines, period = np.moveaxis(q, direction, 0), float(direction == axis)
        nodes = len(lines) - 1
        number = np.arange(-before[direction], nodes + 1 + after[direction])
        turns = number // nodes
        moved = lines[number % nodes] + period * turns[:, None]
        q = np.moveaxis(moved, 0, direction)
    return np.array(q, order="C")
