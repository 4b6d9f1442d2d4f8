"""Predicted rates of the Schwarz iteration, from the leading part of the equations.

Across interfaces the leading part of the mesh equations is a family of independent one-dimensional problems
``P_xixi = 0`` along the grid lines (method of lines for the metric coordinate P), whatever the spacing. Errors of one
subdomain are straight lines between its two ends, so an iteration is a small matrix acting on the interface data, and
its spectral radius is the rate.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from equimesh.decomposition import Decomposition
from equimesh.schwarz import Ordering, Schwarz
from equimesh.transmission import Classical

Array: TypeAlias = npt.NDArray[np.float64]


def predicted_rate(decomposition: Decomposition, settings: Schwarz) -> float | None:
    """Factor by which the error falls in one iteration, for large iteration numbers.

    For classical Schwarz with two subdomains this is ``alpha (1 - beta) / (beta (1 - alpha))`` for one alternating, or
    two parallel, iterations. ``None`` for Robin conditions, whose rate depends on the metric, and for one subdomain.

    The rest of the equations can be slower: on 40 x 40 points with an overlap of 8 the paper's u shows 0.48 throughout,
    as predicted, tanh(20 (x + y/2 - 0.75)) first 0.49 and, from an error of 1e-6 or so on, up to 0.66.
    """
    if not isinstance(settings.transmission, Classical) or decomposition.subdomains == (1, 1):
        return None
    return max(
        _rate([(part.first * h, part.last * h) for part in spans], settings.ordering)
        for spans, h in zip(decomposition.spans, (decomposition.grid.d_xi, decomposition.grid.d_eta), strict=True)
    )


@dataclass(frozen=True)
class _Errors:
    """Straight-line errors on intervals, given by their values at both ends."""

    intervals: list[tuple[float, float]]

    def sweep(self, ends: Array, ordering: Ordering) -> Array:
        """The errors after one iteration; ``ends`` has shape ``(subdomains, 2)``."""
        new = ends.copy()
        read = ends if ordering is Ordering.PARALLEL else new
        for k, (alpha, beta) in enumerate(self.intervals):
            left = self._at(read, k - 1, alpha) if k > 0 else 0.0
            right = self._at(read, k + 1, beta) if k + 1 < len(self.intervals) else 0.0
            new[k] = left, right
        return new

    def _at(self, ends: Array, k: int, place: float) -> float:
        alpha, beta = self.intervals[k]
        return float(np.interp(place, (alpha, beta), ends[k]))


def _rate(intervals: list[tuple[float, float]], ordering: Ordering) -> float:
    """Spectral radius of one sweep on the interface values."""
    errors, size = _Errors(intervals), 2 * len(intervals)
    columns = [errors.sweep(unit.reshape(-1, 2), ordering).ravel() for unit in np.eye(size)]
    return float(np.abs(np.linalg.eigvals(np.column_stack(columns))).max())
