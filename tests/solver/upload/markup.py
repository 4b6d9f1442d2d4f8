"""Files of VTK, written by hand around given texts and bytes."""

from __future__ import annotations

from typing import Any

from solver.upload.files import CLOUD

VTK_HEAD = "# vtk DataFile Version 3.0\ntitle POINTS 3 float\nASCII\nDATASET UNSTRUCTURED_GRID\n"


def vtu(arrays: dict[str, Any], *, tail: str = "", **attributes: str) -> bytes:
    """A vtu file around the given texts of its arrays: ``(attributes, text)`` each."""
    root = "".join(f' {k}="{v}"' for k, v in attributes.items())
    parts = {
        name: f"<DataArray type='Float64' Name='{name}' {form}>{text}</DataArray>"
        for name, (form, text) in arrays.items()
    }
    return (
        f"<?xml version='1.0'?><VTKFile type='UnstructuredGrid' version='1.0'{root}><UnstructuredGrid>"
        f"<Piece NumberOfPoints='{len(CLOUD)}' NumberOfCells='0'><PointData>{parts['u']}</PointData>"
        f"<Points>{parts['Points']}</Points></Piece></UnstructuredGrid>{tail}</VTKFile>"
    ).encode("latin-1")
