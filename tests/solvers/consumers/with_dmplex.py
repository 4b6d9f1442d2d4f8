"""PETSc's DMPlex reads a mesh, and says what it holds."""

from __future__ import annotations

from typing import Any

import numpy as np
from petsc4py import PETSc

from equimesh_coupling.adaptors.dmplex import mesh_of

FORMATS = ("msh",)
COMM = PETSc.COMM_SELF
VERSION = ".".join(map(str, PETSc.Sys.getVersion()))
SIDES = {1: "left", 2: "right", 3: "bottom", 4: "top"}


def read(path: str) -> Any:
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


def _vector(plex: Any, components: int = 1) -> tuple[Any, Any]:
    """A vector with values at the vertices, and their points."""
    first, end = plex.getDepthStratum(0)
    section = PETSc.Section().create(comm=PETSc.COMM_SELF)
    section.setChart(*plex.getChart())
    for vertex in range(first, end):
        section.setDof(vertex, components)
    section.setUp()
    getattr(plex, "setLocalSection", plex.setSection)(section)
    return plex.createLocalVector(), plex.getCoordinatesLocal().array.reshape(end - first, -1)


def linear(plex: Any) -> Any:
    """The field x + 2 y."""
    vector, points = _vector(plex)
    vector.array[:] = points @ [1.0, 2.0]
    return plex, vector


def strangers(parts: Any) -> list[Any]:
    """A field with two components, and a vector of another length."""
    double, single = mesh_of(parts, PETSc.COMM_SELF), mesh_of(parts, PETSc.COMM_SELF)
    _vector(single)
    return [(double, _vector(double, 2)[0]), (single, PETSc.Vec().createSeq(3))]
