"""The wanted density of cells at the nodes of a mesh, from an error indicator of its cells."""

from __future__ import annotations

from typing import Final, Literal

import numpy as np

from equimesh_coupling.parts import Array

# The power of an indicator by which the number of cells has to grow: it falls with the cube of the spacing in L2, with
# its square for the gradient.
POWERS: Final = {"l2": 2.0 / 3.0, "h1": 1.0}
# The share of the mean density that is added to it everywhere: cells where the indicator is zero stay bounded.
FLOOR_SHARE: Final = 0.1


def wanted_density(x: Array, y: Array, indicator: Array, norm: Literal["l2", "h1"]) -> Array | None:
    """The wanted density of cells at the nodes (x, y), shape ``(n_xi, n_eta)``, with the mean 1 over the cells.

    It is the density of the cells now, times a power of the ``indicator`` of shape ``(n_xi - 1, n_eta - 1)``. ``None``
    where all indicators are zero.
    """
    area = 0.5 * (
        (x[1:, 1:] - x[:-1, :-1]) * (y[:-1, 1:] - y[1:, :-1]) - (x[:-1, 1:] - x[1:, :-1]) * (y[1:, 1:] - y[:-1, :-1])
    )
    largest = float(indicator.max())
    if not largest > 0.0:
        return None
    density = (indicator / largest) ** POWERS[norm] / area
    density /= float((density * area).sum() / area.sum())
    padded = np.pad(density, 1, mode="edge")
    nodes = 0.25 * (padded[:-1, :-1] + padded[1:, :-1] + padded[:-1, 1:] + padded[1:, 1:])
    return np.asarray((nodes + FLOOR_SHARE) / (1.0 + FLOOR_SHARE))
