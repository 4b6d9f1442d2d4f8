"""The angles at the corners of the cells."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from equimesh.meshes.mesh import Mesh
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.numerics.types import Array
from equimesh.quality.quad_cells import cells_of

FROM_DEGREES = 30.0
"""The smallest angle that many solvers take without complaint."""
TO_DEGREES = 150.0
"""The largest such angle."""


@dataclass(frozen=True, kw_only=True)
class Angles:
    """The angles at the corners of all cells, in degrees; some are larger than 180 where a cell is folded."""

    smallest: float
    """The smallest angle."""
    largest: float
    """The largest angle."""
    share_within: float
    """The share of the corners whose angle is between ``FROM_DEGREES`` and ``TO_DEGREES``."""

    def summary(self) -> dict[str, float]:
        """The three numbers as plain Python data, ready for JSON."""
        return {"min": self.smallest, "max": self.largest, "share_within": self.share_within}


def corner_angles(mesh: Mesh | QuadMesh) -> Array:
    """The angle at each corner of each cell, from 0 to 360 degrees, shape ``(4, cells)``, counter-clockwise."""
    cells = cells_of(mesh)
    corners = cells.corners(cells.own)
    x, y = corners[:4], corners[4:]
    ahead_x, ahead_y = np.roll(x, -1, axis=0) - x, np.roll(y, -1, axis=0) - y
    behind_x, behind_y = np.roll(x, 1, axis=0) - x, np.roll(y, 1, axis=0) - y
    turned = np.arctan2(ahead_x * behind_y - ahead_y * behind_x, ahead_x * behind_x + ahead_y * behind_y)
    return np.asarray(np.degrees(turned) % 360.0)


def measure_angles(
    mesh: Mesh | QuadMesh, *, from_degrees: float = FROM_DEGREES, to_degrees: float = TO_DEGREES
) -> Angles:
    """The measures of the angles of ``mesh``; the share is that between the two angles given."""
    found = corner_angles(mesh)
    within = (found >= from_degrees) & (found <= to_degrees)
    return Angles(smallest=float(found.min()), largest=float(found.max()), share_within=float(within.mean()))
