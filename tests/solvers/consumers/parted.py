"""VTK, PyVista, ParaView or xarray read meshes in parts, and compare them with the whole mesh: parted.py NAME FOLDER.

The folder holds `whole.npz`, and a folder of heads for each number of parts. What was read is written to NAME.json.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

# The suffixes that each reads.
SUFFIXES = {
    "vtk": (".pvtu", ".vtkhdf"),
    "pyvista": (".pvtu", ".vtkhdf"),
    "paraview": (".pvtu", ".vtkhdf"),
    "xarray": (".zarr",),
}


def vtk_reader() -> Callable[[str], Any]:
    from vtkmodules.vtkIOHDF import vtkHDFReader
    from vtkmodules.vtkIOXML import vtkXMLPUnstructuredGridReader

    readers = {".pvtu": vtkXMLPUnstructuredGridReader, ".vtkhdf": vtkHDFReader}

    def read(path: str) -> Any:
        reader = readers[Path(path).suffix]()
        reader.SetFileName(path)
        reader.Update()
        return reader.GetOutputDataObject(0)

    return read


def pyvista_reader() -> Callable[[str], Any]:
    import pyvista

    return pyvista.read


def paraview_reader() -> Callable[[str], Any]:
    from paraview import servermanager, simple

    def read(path: str) -> Any:
        is_hdf = Path(path).suffix == ".vtkhdf"  # which it reads by itself under the name .hdf
        reader = simple.VTKHDFReader(FileName=path) if is_hdf else simple.OpenDataFile(path)
        reader.UpdatePipeline()
        return servermanager.Fetch(reader)

    return read


def xarray_reader() -> Callable[[str], Any]:
    import xarray

    return lambda path: xarray.open_zarr(path, consolidated=False)


READERS = {"vtk": vtk_reader, "pyvista": pyvista_reader, "paraview": paraview_reader, "xarray": xarray_reader}


def check_arrays(found: Any, whole: Any) -> dict[str, Any]:
    """Compare the arrays and dimensions of a data set of xarray."""
    for name in ("x", "y", "u", "Q_eq", "subdomain"):
        assert np.array_equal(found[name].values, whole[name]), name
        assert found[name].dims == (("xi", "eta") if whole[name].shape == whole["x"].shape else ("xi_cell", "eta_cell"))
    for side, where in found.attrs["sides"].items():
        line = {"left": whole["x"][0], "right": whole["x"][-1], "bottom": whole["x"][:, 0], "top": whole["x"][:, -1]}
        assert np.array_equal(found["x"].isel(where).values, line[side])
    return {"class": type(found).__name__, "points": found["x"].size, "counter-clockwise": True}


def check(grid: Any, suffix: str, whole: Any) -> dict[str, Any]:
    """Compare nodes, cells and data; returns what the grid is."""
    from vtkmodules.util.numpy_support import vtk_to_numpy

    points = vtk_to_numpy(grid.GetPoints().GetData())
    at_nodes, in_cells = grid.GetPointData(), grid.GetCellData()

    def values(data: Any, name: str) -> Any:
        return vtk_to_numpy(data.GetArray(name))

    nodes, cells = whole["x"].shape, whole["Q_eq"].shape
    if suffix == ".pvtu":
        ids = values(at_nodes, "GlobalNodeIds")
        assert sorted({*ids.tolist()}) == [*range(whole["x"].size)]
        found = {"x": (points[:, 0], whole["x"].ravel()[ids]), "y": (points[:, 1], whole["y"].ravel()[ids])}
        found["u"] = values(at_nodes, "u"), whole["u"].ravel()[ids]
    else:
        found = {"x": (points[:, 0].reshape(nodes), whole["x"]), "y": (points[:, 1].reshape(nodes), whole["y"])}
        found["u"] = values(at_nodes, "u").reshape(nodes), whole["u"]
    for name in ("Q_eq", "subdomain"):
        found[name] = values(in_cells, name).reshape(cells), whole[name]
    for name, (read, expected) in found.items():
        assert np.array_equal(read, expected), name
    groups = values(at_nodes, "node_groups")
    assert np.array_equal(groups, whole["node_groups"][ids if suffix == ".pvtu" else slice(None)])
    area = sum(signed_areas(grid))
    assert abs(abs(area) - 1) < 1e-12
    return {"class": grid.GetClassName(), "points": len(points), "counter-clockwise": bool(area > 0)}


def signed_areas(grid: Any) -> Iterator[float]:
    for number in range(grid.GetNumberOfCells()):
        points = grid.GetCell(number).GetPoints()
        x, y, _ = np.array([points.GetPoint(k) for k in range(points.GetNumberOfPoints())]).T
        yield float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum() / 2)


def main(name: str, folder: Path) -> None:
    read, found = READERS[name](), {}
    for place in sorted(path for path in folder.iterdir() if path.is_dir()):
        with np.load(place / "whole.npz") as whole:
            for suffix in SUFFIXES[name]:
                mesh = read(str(place / f"mesh{suffix}"))
                found[place.name + suffix] = (
                    check_arrays(mesh, whole) if suffix == ".zarr" else check(mesh, suffix, whole)
                )
    (folder / f"{name}.json").write_text(json.dumps(found))


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
