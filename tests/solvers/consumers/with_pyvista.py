"""PyVista reads a mesh, and says what it holds."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyvista

from equimesh_coupling.adaptors.pyvista import mesh_of

FORMATS = ("vtu", "vtk", "vts", "xdmf")
VERSION = pyvista.__version__


def read(path: str) -> Any:
    return pyvista.read(path)


def facts(grid: Any) -> dict[str, Any]:
    areas = np.asarray(grid.compute_cell_sizes(length=False, volume=False)["Area"])
    if "left" in grid.field_data:
        sides = {side: np.unique(grid.field_data[side]) for side in ("left", "right", "bottom", "top")}
    else:
        xi, eta = (np.asarray(grid.point_data[name]) for name in ("xi", "eta"))
        where = {"left": xi == 0.0, "right": xi == 1.0, "bottom": eta == 0.0, "top": eta == 1.0}
        sides = {side: np.flatnonzero(here) for side, here in where.items()}
    surface = grid.extract_surface(algorithm=None)
    normals = surface.compute_normals(auto_orient_normals=False, consistent_normals=False).cell_data["Normals"]
    smallest = min(float(np.asarray(normals)[:, 2].min()), areas.min())
    return {"points": np.asarray(grid.points)[:, :2], "area": areas.sum(), "smallest": smallest, "sides": sides}


def linear(grid: Any) -> Any:
    """The values of x + 2 y at the nodes, as active scalars."""
    grid.point_data["w"] = np.asarray(grid.points)[:, :2] @ [1.0, 2.0]
    grid.set_active_scalars("w")
    return grid


def strangers(parts: Any) -> list[Any]:
    """A grid without values, one with values at cells, and one with vectors."""
    bare, cells, vectors = mesh_of(parts), mesh_of(parts), mesh_of(parts)
    cells.cell_data["w"] = np.zeros(cells.n_cells)
    cells.set_active_scalars("w", preference="cell")
    vectors.point_data["w"] = np.zeros((vectors.n_points, 3))
    vectors.set_active_scalars("w")
    return [bare, cells, vectors]
