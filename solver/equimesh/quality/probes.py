"""Probes of u between the nodes of a mesh, at more points than quadrature has."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from equimesh.fields.field import Field
from equimesh.meshes.mesh_window import WindowCells
from equimesh.numerics.gather import joined
from equimesh.numerics.types import Array, IntArray
from equimesh.quality.cell_maps import gather_values
from equimesh.quality.cells import BilinearCells, MeshCells, pieces
from equimesh.quality.interpolation import CENTRE, LargestError
from equimesh.quality.quad_cells import AnyMesh, QuadCells, cells_of

PROBES = 65_536
"""Probes of a mesh, about."""
MAX_PROBES_PER_CELL = 64
"""Probes of a cell, at most."""
SHARES = (0.7548776662466927, 0.5698402909980532)
"""Steps of the two coordinates of a sequence that fills the square evenly: powers of the plastic number."""


def probe_errors(mesh: AnyMesh, u: Field) -> tuple[LargestError, float]:
    """The largest difference of u and its bilinear interpolant at the probes, and the range of u.

    The range is the largest value at the probes and the nodes minus the smallest one. The place is that of the probe.
    Every cell has as many probes, in other places of each. Values that are not finite
    have no part in it. Where a process holds some rows of a mesh, the result is that of all processes.
    """
    cells = cells_of(mesh)
    with np.errstate(all="ignore"):
        if isinstance(cells, QuadCells):
            extremes = [*_of_blocks(cells, u)]
        else:
            extremes = [found for first, last in cells.rows.strips for found in _of_strip(cells, first, last, u)]
        found = joined(cells.rows.channel, np.array(extremes).reshape(-1, 5))
        variation = float(np.fmax.reduce(found[:, 1]) - np.fmin.reduce(found[:, 0]))
    return LargestError(*map(float, found[found[:, 2].argmax(), 2:])), variation


def _of_strip(cells: BilinearCells, first: int, last: int, u: Field) -> Iterator[tuple[float, ...]]:
    """The smallest and the largest value of u, the largest error and its place: of nodes, and of blocks of cells.

    They are those of the rows ``first`` to ``last - 1`` of cells.
    """
    columns, nodal = cells.shape[1], u.evaluate(*cells.window.nodes(first, last))[0]
    yield float(np.nanmin(nodal)), float(np.nanmax(nodal)), 0.0, np.nan, np.nan
    for block in pieces(first * columns, last * columns, CENTRE):
        numbers = np.arange(block.start, block.stop)
        values = np.empty((4, numbers.size))
        gather_values(np.ascontiguousarray(nodal), numbers - first * columns, values)
        yield _at_probes(cells, numbers, values, u)


def _of_blocks(cells: QuadCells, u: Field) -> Iterator[tuple[float, ...]]:
    """The probed errors of a mesh of blocks."""
    nodal = u.evaluate(*cells.nodes)[0]
    yield float(np.nanmin(nodal)), float(np.nanmax(nodal)), 0.0, np.nan, np.nan
    for _, numbers in cells.blocks_of(WindowCells.of(cells.rows), CENTRE):
        yield _at_probes(cells, numbers, cells.corner_values(nodal, numbers), u)


def _at_probes(cells: MeshCells, numbers: IntArray, values: Array, u: Field) -> tuple[float, ...]:
    """The errors at the probes of some cells; ``values`` are u at the corners."""
    corners = cells.corners(numbers)
    low, high, found = np.inf, -np.inf, (0.0, np.nan, np.nan)
    for probe in range(max(1, min(MAX_PROBES_PER_CELL, PROBES // cells.count))):
        steps = probe * cells.count + numbers + 1.0
        weights = _weights(np.asarray(SHARES[0] * steps) % 1.0, np.asarray(SHARES[1] * steps) % 1.0)
        x, y = (np.einsum("ck,ck->k", weights, corners[part]) for part in (slice(0, 4), slice(4, 8)))
        there = u.evaluate(x, y)[0]
        error = np.abs(np.einsum("ck,ck->k", weights, values) - there)
        error[~np.isfinite(error)] = 0.0
        low, high = min(low, float(np.nanmin(there))), max(high, float(np.nanmax(there)))
        worst = int(error.argmax())
        if error[worst] > found[0]:
            found = float(error[worst]), float(x[worst]), float(y[worst])
    return low, high, *found


def _weights(s: Array, t: Array) -> Array:
    """The bilinear weights of the corners at (s, t), counter-clockwise, of shape ``(4, n)``."""
    return np.stack([(1.0 - s) * (1.0 - t), s * (1.0 - t), s * t, (1.0 - s) * t])
