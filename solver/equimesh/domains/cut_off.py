"""The area that the straight sides of cells cut off the curved sides of a domain, or add to it.

A cell on a curved side ends at a chord. Where nodes move apart along the side, its chord leaves out much of the domain,
or covers much beyond it. The error of a mesh is measured on its cells alone, so that such a mesh seems better than it
is.
"""

from __future__ import annotations

import numpy as np

from equimesh.domains.domain import Domain
from equimesh.numerics.types import Array

PLACES = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Where a piece of a side is compared with its chord, as shares of the way from node to node in the parameter."""
WEIGHTS = (0.0, 1.0 / 3.0, 1.0 / 6.0, 1.0 / 3.0, 0.0)
"""Simpson's weights of these places, over two intervals."""
MAX_MORE_SHARE = 0.25
"""A mesh may cut off this share of the area more than the initial mesh; or twice as much, where that is more."""


def area_between(x: Array, y: Array) -> float:
    """The area between pieces of curves and their chords, on either side of these.

    The points of a piece at the ``PLACES`` are a row of ``x`` and ``y``, of shape ``(pieces, 5)``. The rule is exact
    for a parabola.
    """
    along_x, along_y = x[:, -1:] - x[:, :1], y[:, -1:] - y[:, :1]
    heights = np.abs((x - x[:, :1]) * along_y - (y - y[:, :1]) * along_x)
    return float((heights @ np.array(WEIGHTS)).sum())


def cut_off(domain: Domain, begins: Array, ends: Array) -> float:
    """The area between pieces of the sides of a domain and their chords.

    ``begins`` and ``ends`` are the nodes of each piece on the reference square, of shape ``(2, pieces)``.
    """
    s, t = (np.multiply.outer(one, 1.0 - np.array(PLACES)) + np.multiply.outer(two, PLACES)
            for one, two in zip(begins, ends, strict=True))  # fmt: skip
    return area_between(*domain.map(s, t))


def most_cut_off(first: float, area: float) -> float:
    """What a mesh may cut off a domain with this ``area``, whose initial mesh cuts off ``first``."""
    return first + max(first, MAX_MORE_SHARE * area)
