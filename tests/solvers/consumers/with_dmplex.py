"""PETSc's DMPlex reads a mesh, and says what it holds."""

from __future__ import annotations

from typing import Any

import numpy as np
from petsc4py import PETSc

FORMATS = ("msh",)
VERSION = ".".join(map(str, PETSc.Sys.getVersion()))
SIDES = {1: "left", 2: "right", 3: "bottom", 4: "top"}


def read(path: str, cells: str) -> Any:
    return PETSc.DMPlex().createFromFile(path, interpolate=True, comm=PETSc.COMM_SELF)


def facts(plex: Any) -> dict[str, Any]:
    first, end = plex.getDepthStratum(0)
    points = plex.getCoordinatesLocal().array.reshape(end - first, -1)[:, :2]
    turned = []
    for cell in range(*plex.getHeightStratum(0)):
        closure = plex.getTransitiveClosure(cell)[0]
        corners = points[[point - first for point in closure if first <= point < end]]
        x, y = corners.T
        turned.append((x * np.roll(y, -1) - y * np.roll(x, -1)).sum() / 2)
    sides = {}
    for number, side in SIDES.items():
        faces = plex.getStratumIS("Face Sets", number).getIndices()
        closures = [plex.getTransitiveClosure(face)[0] for face in faces]
        sides[side] = np.unique([point - first for closure in closures for point in closure if first <= point < end])
    return {"points": points, "area": sum(turned), "smallest": min(turned), "sides": sides}
