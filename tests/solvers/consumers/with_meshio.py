"""meshio reads a mesh, and says what it holds."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import meshio
import numpy as np

FORMATS = ("msh", "vtu", "vtk", "xdmf", "mesh", "su2")
VERSION = meshio.__version__
SIDES = ("left", "right", "bottom", "top")


def read(path: str) -> Any:
    mesh = meshio.read(path)
    facets = Path(path).with_name(f"{Path(path).stem}_facets.xdmf")
    mesh.info = {"facets": meshio.read(facets) if path.endswith(".xdmf") else mesh}
    return mesh


def facts(mesh: Any) -> dict[str, Any]:
    cells = mesh.cells_dict.get("quad", mesh.cells_dict.get("triangle"))
    x, y = mesh.points[cells, :2].transpose(2, 0, 1)
    areas = (x * np.roll(y, -1, 1) - y * np.roll(x, -1, 1)).sum(axis=1) / 2
    if "line" in mesh.info["facets"].cells_dict:
        edges = mesh.info["facets"].cells_dict["line"]
        (tags,) = (
            mesh.info["facets"].cell_data_dict[name]["line"]
            for name in ("gmsh:physical", "medit:ref", "su2:tag", "name_to_read")
            if name in mesh.info["facets"].cell_data_dict
        )
        sides = {side: np.unique(edges[tags == number]) for number, side in enumerate(SIDES, start=1)}
    else:
        xi, eta = (np.ravel(mesh.point_data[name]) for name in ("xi", "eta"))
        where = {"left": xi == 0.0, "right": xi == 1.0, "bottom": eta == 0.0, "top": eta == 1.0}
        sides = {side: np.flatnonzero(here) for side, here in where.items()}
    return {"points": mesh.points[:, :2], "area": areas.sum(), "smallest": areas.min(), "sides": sides}
