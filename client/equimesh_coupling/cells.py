"""Values on cells, wrapped to say what they are: an error indicator, or averages of the solution."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from equimesh_coupling.arrays import finite, real
from equimesh_coupling.errors import BadValues
from equimesh_coupling.parts import Array, HasParts, MeshParts


@dataclass(frozen=True, eq=False)
class ErrorIndicator:
    """An error indicator of a solver: one of its ``values`` for each cell, in the order of the cells, none negative."""

    values: npt.ArrayLike


@dataclass(frozen=True, eq=False)
class CellAverages:
    """Averages of a solution over the cells: one of the ``values`` for each cell, in the order of the cells."""

    values: npt.ArrayLike


def cell_values(wrapped: ErrorIndicator | CellAverages, mesh: HasParts) -> Array:
    """The values of an error indicator or of cell averages for each quadrilateral, shape ``(n_xi - 1, n_eta - 1)``.

    On triangles an indicator has one value for each of them: that of a quadrilateral is the root of the sum of
    squares. The average over a quadrilateral is that of its triangles, by their areas.

    Raises :class:`BadValues` for another length, values that are not finite, and a negative indicator.
    """
    parts = mesh.mesh_parts()
    is_indicator = isinstance(wrapped, ErrorIndicator)
    what = "the error indicator" if is_indicator else "the array of cell averages"
    values = finite(real(wrapped.values, what), what)
    quads, triangles = cell_counts(parts)
    if is_indicator and values.size and values.min() < 0.0:
        raise BadValues("the error indicator has negative values: return the size of the error on each cell")
    is_flat = max(values.shape, default=1) == values.size
    if values.size == quads and (is_flat or values.shape == parts.cell_shape):
        return values.reshape(parts.cell_shape)
    if values.size == triangles and is_flat:
        parts = mesh.mesh_parts("triangle")
        pairs = values.reshape(-1, 2)
        merged = np.sqrt((pairs**2).sum(axis=1)) if is_indicator else _mean_of_pairs(pairs, parts)
        return np.asarray(merged.reshape(parts.cell_shape))
    raise BadValues(
        f"{what} has {values.size} values of shape {values.shape}, and this mesh has {quads} quadrilaterals, or "
        f"{triangles} triangles: return one value for each, flat or of shape {parts.cell_shape}"
    )


def _mean_of_pairs(pairs: Array, parts: MeshParts) -> Array:
    corners = parts.points[parts.cells]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    areas = np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]).reshape(-1, 2)
    return np.asarray((pairs * areas).sum(axis=1) / areas.sum(axis=1))


def cell_counts(parts: MeshParts) -> tuple[int, int]:
    """The number of quadrilaterals, and of triangles cut from them."""
    quads = math.prod(parts.cell_shape)
    return quads, 2 * quads
