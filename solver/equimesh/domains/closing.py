"""Closed lines: domains whose opposite sides are one line, so that grid lines run around.

Both copies of the seam are in the arrays of a mesh: the last node of a closed line is its first one, moved by the
period. In reference coordinates the period is 1. In the plane it is a translation, which is zero where the domain
closes around itself, as a ring does.
"""

from __future__ import annotations

from typing import TypeAlias

from equimesh.meshes.closed import Closed
from equimesh.numerics.types import Array

Periods: TypeAlias = tuple[tuple[float, float], tuple[float, float]]
"""The translations of the plane from the first to the last node of a xi-line, and of an eta-line."""
OPEN: Closed = (False, False)
"""Four sides."""
NOWHERE: Periods = ((0.0, 0.0), (0.0, 0.0))
"""No translations."""


def closed_of(domain: object) -> Closed:
    """Whether the xi-lines and the eta-lines of a domain are closed; a domain that does not say so has four sides."""
    closed: Closed = getattr(domain, "closed_lines", OPEN)
    return closed


def is_closed(domain: object) -> bool:
    """Whether some grid lines of a domain are closed."""
    return any(closed_of(domain))


def periods_of(domain: object) -> Periods:
    """The translations of the plane from the first to the last node of a closed xi-line, and of a closed eta-line.

    They are zero for lines that are open, and where both copies of the seam are the same points.
    """
    periods: Periods = getattr(domain, "periods", NOWHERE)
    return periods


def close_seam(x: Array, y: Array, domain: object) -> None:
    """Write the second copy of each seam of a mesh of ``domain``, in place: the first one, moved by the period."""
    closed, periods = closed_of(domain), periods_of(domain)
    for axis in (0, 1):
        if closed[axis]:
            for q, period in zip((x, y), periods[axis], strict=True):
                lines = q if axis == 0 else q.T
                lines[-1] = lines[0] + period
