"""ParaView reads a mesh with the readers that it takes for files of this name, and says what it holds."""

from __future__ import annotations

from typing import Any

import numpy as np
from paraview import servermanager, simple
from vtkmodules.util.numpy_support import vtk_to_numpy

FORMATS = ("vtu", "vtk", "vts", "xdmf")
VERSION = str(simple.GetParaViewVersion())
if VERSION.count(".") == 1:
    VERSION = str(servermanager.vtkSMProxyManager.GetVersion())


def read(path: str, cells: str) -> Any:
    reader = simple.OpenDataFile(path)
    reader.UpdatePipeline()
    return servermanager.Fetch(reader)


def facts(grid: Any) -> dict[str, Any]:
    order = _our_order(grid)
    points = vtk_to_numpy(grid.GetPoints().GetData())[order, :2]
    areas = [_area(grid.GetCell(k)) for k in range(grid.GetNumberOfCells())]
    xi, eta = (vtk_to_numpy(grid.GetPointData().GetArray(name))[order] for name in ("xi", "eta"))
    where = {"left": xi == 0.0, "right": xi == 1.0, "bottom": eta == 0.0, "top": eta == 1.0}
    sides = {side: np.flatnonzero(here) for side, here in where.items()}
    return {"points": points, "area": sum(areas), "smallest": min(areas), "sides": sides}


def _our_order(grid: Any) -> Any:
    """The point of every node: in a structured grid the index along xi runs fastest."""
    numbers = np.arange(grid.GetNumberOfPoints())
    if not hasattr(grid, "GetDimensions"):
        return numbers
    n_xi, n_eta, _ = grid.GetDimensions()
    return numbers.reshape(n_eta, n_xi).T.ravel()


def _area(cell: Any) -> float:
    """The signed area."""
    corners = np.array([cell.GetPoints().GetPoint(k) for k in range(cell.GetNumberOfPoints())])
    x, y, _ = corners.T
    return float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum() / 2)
