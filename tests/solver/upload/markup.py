"""Files of VTK and XDMF, written by hand around given texts and bytes."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable
from typing import Any

import h5py

from solver.upload.files import CLOUD, CLOUD_U

XDMF = "<Xdmf><Domain><Grid><Geometry GeometryType='XY'>{points}</Geometry>{more}</Grid></Domain></Xdmf>"


def item(reference: str, dimensions: str, form: str = "HDF") -> str:
    return f"<DataItem Dimensions='{dimensions}' Format='{form}'>{reference}</DataItem>"


def xdmf(points: str, u: str) -> bytes:
    return XDMF.format(points=points, more=f"<Attribute Name='u' Center='Node'>{u}</Attribute>").encode()


def zipped(**members: bytes) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, data in members.items():
            # At a fixed date, so that the same members give the same bytes.
            archive.writestr(zipfile.ZipInfo(name.replace("_", "."), date_time=(1980, 1, 1, 0, 0, 0)), data)
    return stream.getvalue()


def h5(fill: Callable[[h5py.File], Any]) -> bytes:
    stream = io.BytesIO()
    with h5py.File(stream, "w") as file:
        fill(file)
    return stream.getvalue()


def with_cloud(file: h5py.File, **options: Any) -> None:
    group = file.create_group("g")
    group.create_dataset("points", data=CLOUD, **options)
    group.create_dataset("u", data=CLOUD_U, **options)


IN_H5 = xdmf(item("a.h5:/g/points", "44 2"), item(" a.h5:/g/u\n", "44"))


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
