"""FiPy reads a mesh, says what it holds, and solves on it."""

from __future__ import annotations

from typing import Any

import fipy
import numpy as np
import poisson

from equimesh_coupling.adaptors.fipy import mesh_of

FORMATS = ("msh",)
VERSION = fipy.__version__


def read(path: str) -> Any:
    return fipy.Gmsh2D(path)


def facts(mesh: Any) -> dict[str, Any]:
    sides = {}
    for side in ("left", "right", "bottom", "top"):
        faces = np.asarray(mesh.physicalFaces[side].value, dtype=bool)
        sides[side] = np.unique(np.ma.compressed(mesh.faceVertexIDs[:, faces]))
    areas = np.asarray(mesh.cellVolumes)
    return {"points": np.asarray(mesh.vertexCoords).T, "area": areas.sum(), "smallest": areas.min(), "sides": sides}


def solve(mesh: Any) -> Any:
    u = fipy.CellVariable(mesh=mesh)
    at_faces = np.asarray(mesh.faceCenters)
    for side in poisson.FIXED:
        u.constrain(poisson.w(*at_faces), mesh.physicalFaces[side])
    u.faceGrad.constrain(np.stack(poisson.gradient(*at_faces)), mesh.physicalFaces["right"])
    load = fipy.CellVariable(mesh=mesh, value=poisson.load(*np.asarray(mesh.cellCenters)))
    (fipy.DiffusionTerm(1.0) + load == 0.0).solve(var=u, solver=fipy.LinearLUSolver())
    return u


def error(mesh: Any, u: Any) -> float:
    """The error at the centres of the cells, in L2: what FiPy solves for."""
    difference = np.asarray(u.value) - poisson.w(*np.asarray(mesh.cellCenters))
    return float(np.sqrt((np.asarray(mesh.cellVolumes) * difference**2).sum()))


def strangers(parts: Any) -> list[Any]:
    """A variable of another mesh, one with components, and one of a solve that diverged."""
    other, mesh = fipy.Grid2D(nx=3, ny=3), mesh_of(parts)
    diverged = fipy.CellVariable(mesh=mesh, value=np.nan)
    return [fipy.CellVariable(mesh=other), fipy.CellVariable(mesh=mesh, rank=1), diverged]
