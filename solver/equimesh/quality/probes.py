"""Probes of u between the nodes of a mesh, at more points than quadrature has."""

from __future__ import annotations

import numpy as np

from equimesh.fields.field import Field
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.types import Array
from equimesh.quality.cells import BilinearCells, gather_cells
from equimesh.quality.interpolation import LargestError

PROBES = 65_536
"""Probes of a mesh, about."""
MAX_PROBES_PER_CELL = 64
"""Probes of a cell, at most."""
SHARES = (0.7548776662466927, 0.5698402909980532)
"""Steps of the two coordinates of a sequence that fills the square evenly: powers of the plastic number."""


def probe_errors(mesh: Mesh, u: Field) -> tuple[LargestError, float]:
    """The largest difference of u and its bilinear interpolant at the probes, and the range of u.

    The range is the largest value at the probes and the nodes minus the smallest one. The place is that of the probe.
    Every cell has as many probes, in other places of each. Values that are not finite
    have no part in it.
    """
    cells = BilinearCells(mesh)
    numbers = np.arange(cells.count)
    corners = np.empty((8, cells.count))
    with np.errstate(all="ignore"):
        gather_cells(*cells.nodes, numbers, corners)
        nodal = u.evaluate(*cells.nodes)[0]
        values, found = cells.corner_values(nodal, numbers), LargestError(0.0, np.nan, np.nan)
        low, high = float(np.nanmin(nodal)), float(np.nanmax(nodal))
        for probe in range(max(1, min(MAX_PROBES_PER_CELL, PROBES // cells.count))):
            steps = probe * cells.count + numbers + 1.0
            weights = _weights(np.asarray(SHARES[0] * steps) % 1.0, np.asarray(SHARES[1] * steps) % 1.0)
            x, y = (np.einsum("ck,ck->k", weights, corners[part]) for part in (slice(0, 4), slice(4, 8)))
            there = u.evaluate(x, y)[0]
            error = np.abs(np.einsum("ck,ck->k", weights, values) - there)
            error[~np.isfinite(error)] = 0.0
            low, high = min(low, float(np.nanmin(there))), max(high, float(np.nanmax(there)))
            worst = int(error.argmax())
            if error[worst] > found.value:
                found = LargestError(float(error[worst]), float(x[worst]), float(y[worst]))
    return found, high - low


def _weights(s: Array, t: Array) -> Array:
    """The bilinear weights of the corners at (s, t), counter-clockwise, of shape ``(4, n)``."""
    return np.stack([(1.0 - s) * (1.0 - t), s * (1.0 - t), s * t, (1.0 - s) * t])
