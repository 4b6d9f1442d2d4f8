"""The formats of meshes in parts: names, suffixes, media types, who reads them, and how they mark the four sides."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from equimesh.errors import InputError


@dataclass(frozen=True, kw_only=True)
class PartedFormat:
    """A format of a mesh in parts: its short ``name``, and the ``suffix`` and ``media_type`` of its head.

    Every part is a file with ``part_suffix`` and ``part_media_type``; both are empty where the parts are chunks of one
    store. ``companion`` is the suffix of a second file of the head, which holds what the first refers to. ``readers``
    are the programs that read the head, and ``sides`` says how the four sides are found. ``shares_rows`` says whether
    two neighbouring parts both hold the nodes between them.
    """

    name: str
    suffix: str
    media_type: str
    part_suffix: str
    part_media_type: str
    readers: str
    sides: str
    companion: str = ""
    shares_rows: bool = False


PARTED_FORMATS: Final = {
    f.name: f
    for f in (
        PartedFormat(
            name="pvts",
            suffix=".pvts",
            media_type="application/vnd.vtk.pvts+xml",
            part_suffix=".vts",
            part_media_type="application/vnd.vtk.vts+xml",
            readers="VTK, ParaView",
            sides="by index: i runs along xi and j along eta; left is the first i, right the last, bottom the first j,"
            " top the last",
            shares_rows=True,
        ),
        PartedFormat(
            name="pvtu",
            suffix=".pvtu",
            media_type="application/vnd.vtk.pvtu+xml",
            part_suffix=".vtu",
            part_media_type="application/vnd.vtk.vtu+xml",
            readers="VTK, PyVista, ParaView",
            sides="point data node_groups: 0 inside, 1 left, 2 right, 3 bottom, 4 top, both digits at a corner",
            shares_rows=True,
        ),
        PartedFormat(
            name="xdmf",
            suffix=".xdmf",
            media_type="application/x-xdmf+xml",
            part_suffix=".h5",
            part_media_type="application/x-hdf5",
            companion=".h5",
            readers="VTK's XDMF reader, PyVista, ParaView; h5py for the .h5 file next to it",
            sides="datasets sides/left, sides/right, sides/bottom, sides/top of the .h5 file: edges, the domain on"
            " their left",
        ),
        PartedFormat(
            name="vtkhdf",
            suffix=".vtkhdf",
            media_type="application/x-hdf5",
            part_suffix=".hdf",
            part_media_type="application/x-hdf5",
            readers="VTK, PyVista, ParaView; h5py",
            sides="point data node_groups: 0 inside, 1 left, 2 right, 3 bottom, 4 top, both digits at a corner",
        ),
        PartedFormat(
            name="zarr",
            suffix=".zarr",
            media_type="application/vnd+zarr",
            part_suffix="",
            part_media_type="",
            readers="zarr, xarray, Dask",
            sides="by index: left is the first row of an array, right the last, bottom the first column, top the last",
        ),
    )
}


def parted_format(path: str | os.PathLike[str], name: str | None = None) -> PartedFormat:
    """The format with this ``name``, or without one that of the suffix of ``path``.

    Raises :class:`~equimesh.errors.InputError` for an unknown name or suffix, and for a path without the suffix of the
    format.
    """
    if name is not None and name not in PARTED_FORMATS:
        raise InputError(f"unknown format {name!r} of parts: choose one of {', '.join(PARTED_FORMATS)}", field="format")
    found = Path(path).name
    for known in PARTED_FORMATS.values():
        if name in (None, known.name) and found.endswith(known.suffix) and found != known.suffix:
            return known
    suffixes = ", ".join(known.suffix for known in PARTED_FORMATS.values() if name in (None, known.name))
    raise InputError(
        f"{found!r} cannot be the name of a mesh in parts: it must end in {suffixes}",
        field="path",
    )
