"""ParaView reads a mesh with the readers that it takes for files of this name, and says what it holds."""

from __future__ import annotations

from typing import Any

import numpy as np
from paraview import servermanager, simple
from vtkmodules.util.numpy_support import vtk_to_numpy

FORMATS = ("vtu", "vtk", "vts", "xdmf")
VERSION = f"{simple.GetParaViewVersion().major}.{simple.GetParaViewVersion().minor}"


def read(path: str) -> Any:
    reader = simple.OpenDataFile(path)
    reader.UpdatePipeline()
    return servermanager.Fetch(reader)


def facts(grid: Any) -> dict[str, Any]:
    points = vtk_to_numpy(grid.GetPoints().GetData())[:, :2]
    areas = [_area(grid.GetCell(k)) for k in range(grid.GetNumberOfCells())]
    xi, eta = (vtk_to_numpy(grid.GetPointData().GetArray(name)) for name in ("xi", "eta"))
    where = {"left": xi == 0.0, "right": xi == 1.0, "bottom": eta == 0.0, "top": eta == 1.0}
    sides = {side: np.flatnonzero(here) for side, here in where.items()}
    return {"points": points, "area": sum(areas), "smallest": min(areas), "sides": sides}


def _area(cell: Any) -> float:
    """The signed area."""
    corners = np.array([cell.GetPoints().GetPoint(k) for k in range(cell.GetNumberOfPoints())])
    x, y, _ = corners.T
    return float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum() / 2)
