"""The smallest and the largest value of a function on a domain with closed lines.

Values at the nodes of a grid depend on where its lines begin. Those of the extremes do not: they are sought around the
best nodes, closer and closer.
"""

from __future__ import annotations

import numpy as np

from equimesh.domains.closing import closed_of
from equimesh.domains.domain import Domain
from equimesh.fields.field import Field
from equimesh.numerics.types import Array

CELLS = 90
"""Cells in a direction of the first search."""
CANDIDATES = 32
"""Nodes around which an extreme is sought."""
ZOOMS = 16
"""Closer searches around each of them."""
ZOOM_SHARE = 0.4
"""The width of a closer search, as a share of that of the search before."""
OFFSETS = np.linspace(-1.0, 1.0, 7)
"""The places of a closer search in a direction, in units of its width."""


def extremes(u: Field, domain: Domain) -> tuple[float, float]:
    """The smallest and the largest finite value of ``u``; ``(0, 0)`` where there is none."""
    line = np.linspace(0.0, 1.0, CELLS + 1)
    s, t = (axis.ravel() for axis in np.meshgrid(line, line, indexing="ij"))
    with np.errstate(all="ignore"):
        values = _values(u, domain, s, t)
        known = np.isfinite(values)
        if not known.any():
            return 0.0, 0.0
        s, t, values = s[known], t[known], values[known]
        return -_largest(u, domain, (s, t), -values, -1.0), _largest(u, domain, (s, t), values, 1.0)


def _largest(u: Field, domain: Domain, nodes: tuple[Array, Array], values: Array, sign: float) -> float:
    """The largest value of ``sign`` times u, from its values at nodes."""
    best = np.argsort(-values, kind="stable")[:CANDIDATES]
    s, t, found, width = nodes[0][best], nodes[1][best], values[best], 1.0 / CELLS
    closed = closed_of(domain)
    a, b = (offsets.ravel() for offsets in np.meshgrid(OFFSETS, OFFSETS, indexing="ij"))
    every = np.arange(best.size)
    for _ in range(ZOOMS):
        near_s, near_t = s[:, None] + width * a, t[:, None] + width * b
        near_s, near_t = (
            q % 1.0 if around else np.clip(q, 0.0, 1.0) for q, around in zip((near_s, near_t), closed, strict=True)
        )
        near = sign * _values(u, domain, near_s, near_t)
        near[~np.isfinite(near)] = -np.inf
        which = near.argmax(axis=1)
        s, t, found = near_s[every, which], near_t[every, which], np.maximum(found, near[every, which])
        width *= ZOOM_SHARE
    return float(found.max())


def _values(u: Field, domain: Domain, s: Array, t: Array) -> Array:
    return u.evaluate(*domain.map(s, t))[0]
