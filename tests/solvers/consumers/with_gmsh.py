"""Gmsh reads a mesh, and says what it holds."""

from __future__ import annotations

from typing import Any

import gmsh
import numpy as np

FORMATS = ("msh",)
VERSION = gmsh.__version__


def read(path: str) -> Any:
    if not gmsh.isInitialized():
        gmsh.initialize(readConfigFiles=False, interruptible=False)
        gmsh.option.setNumber("General.Terminal", 0)
    gmsh.clear()
    gmsh.open(path)
    return gmsh.model


def facts(model: Any) -> dict[str, Any]:
    tags, coordinates, _ = model.mesh.getNodes()
    points = coordinates.reshape(-1, 3)[np.argsort(tags), :2]
    (kind,), _, (nodes,) = model.mesh.getElements(2)
    cells = nodes.astype(np.int64).reshape(-1, 3 if kind == 2 else 4) - 1
    x, y = points[cells].transpose(2, 0, 1)
    areas = (x * np.roll(y, -1, 1) - y * np.roll(x, -1, 1)).sum(axis=1) / 2
    sides = {
        model.getPhysicalName(1, tag): model.mesh.getNodesForPhysicalGroup(1, tag)[0].astype(np.int64) - 1
        for _, tag in model.getPhysicalGroups(1)
    }
    return {"points": points, "area": areas.sum(), "smallest": areas.min(), "sides": sides}
