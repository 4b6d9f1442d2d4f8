"""VTK reads a mesh, and says what it holds."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkIdList, vtkVersion
from vtkmodules.vtkIOLegacy import vtkUnstructuredGridReader
from vtkmodules.vtkIOXML import vtkXMLStructuredGridReader, vtkXMLUnstructuredGridReader

FORMATS = ("vtu", "vtk", "vts")
VERSION = vtkVersion.GetVTKVersion()
READERS = {".vtu": vtkXMLUnstructuredGridReader, ".vtk": vtkUnstructuredGridReader, ".vts": vtkXMLStructuredGridReader}


def read(path: str) -> Any:
    reader = READERS[Path(path).suffix]()
    if path.endswith(".vtk"):
        reader.ReadAllScalarsOn()
    reader.SetFileName(path)
    reader.Update()
    return reader.GetOutput()


def _corners(grid: Any, cell: int) -> list[int]:
    nodes = vtkIdList()
    grid.GetCellPoints(cell, nodes)
    return [nodes.GetId(k) for k in range(nodes.GetNumberOfIds())]


def facts(grid: Any) -> dict[str, Any]:
    points = vtk_to_numpy(grid.GetPoints().GetData())[:, :2]
    cells = np.array([_corners(grid, cell) for cell in range(grid.GetNumberOfCells())])
    x, y = points[cells].transpose(2, 0, 1)
    areas = (x * np.roll(y, -1, 1) - y * np.roll(x, -1, 1)).sum(axis=1) / 2
    xi, eta = (vtk_to_numpy(grid.GetPointData().GetArray(name)) for name in ("xi", "eta"))
    where = {"left": xi == 0.0, "right": xi == 1.0, "bottom": eta == 0.0, "top": eta == 1.0}
    sides = {side: np.flatnonzero(here) for side, here in where.items()}
    return {"points": points, "area": areas.sum(), "smallest": areas.min(), "sides": sides}
