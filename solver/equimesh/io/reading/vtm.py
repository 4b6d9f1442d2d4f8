"""Meshes from VTK XML files of several blocks: a head, and a structured grid for each block."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import PurePosixPath
from typing import Final

from equimesh.errors import InputError
from equimesh.io.reading.plain_mesh import PlainMesh
from equimesh.io.reading.plot3d import joined
from equimesh.io.reading.refusals import MAX_EXPANDED, most_unpacked
from equimesh.io.vtk_xml import BROKEN, VtkXml
from equimesh.io.xml_tree import parse_xml
from equimesh.numerics.types import Array

# Blocks of a file, at most.
MAX_BLOCKS: Final = 10_000


def read_vtm(head: bytes, read: Callable[[str], bytes], most: int = MAX_EXPANDED) -> PlainMesh:
    """The mesh of a ``.vtm`` file, whose ``head`` names a ``.vts`` file for each block; ``read`` has their bytes.

    All coordinates have ``most`` bytes together.

    Nodes of blocks at the same place become one node. The blocks keep their names; the sides have none. Raises
    :class:`~equimesh.errors.InputError` for a broken file, and for blocks that are no plane structured grids, with the
    name of their file.

    Source: VTK file formats, "XML file formats": vtkMultiBlockDataSet and StructuredGrid.
    """
    root = parse_xml(head, "vtm")
    entries = list(root.iter("DataSet"))
    if root.get("type") != "vtkMultiBlockDataSet" or not 1 <= len(entries) <= MAX_BLOCKS:
        message = f"the vtm file has {len(entries)} blocks: a vtkMultiBlockDataSet of 1 to {MAX_BLOCKS} is read"
        raise InputError(message, field="file")
    blocks, names, left = [], [], most
    files: set[str] = set()
    for number, entry in enumerate(entries):
        file = entry.get("file", "")
        place = PurePosixPath(file)
        if not file or place.is_absolute() or ".." in place.parts:
            message = f"block {number} of the vtm file is in {file[:80]!r}: its file must be beside the vtm file"
            raise InputError(message, field="file")
        if file in files:
            raise InputError(f"two blocks of the vtm file are in {file[:80]!r}: name each file once", field="file")
        files.add(file)
        data = read(file)
        try:
            blocks.append(_grid(data, left))
        except BROKEN as error:
            message = f"{file[:80]!r} of the vtm file cannot be read: {str(error)[:200]}"
            raise InputError(message, field="file") from error
        left -= blocks[-1].nbytes
        names.append(entry.get("name") or f"block{number}")
    sizes = [(block.shape[0] - 1) * (block.shape[1] - 1) for block in blocks]
    return replace(joined(blocks, {}), blocks=tuple(zip(names, sizes, strict=True)))


def _grid(data: bytes, most: int) -> Array:
    """The nodes of a ``.vts`` file of one piece, shape ``(n_i, n_j, 3)``."""
    reader = VtkXml(data, min(most, most_unpacked(len(data))))
    pieces = list(reader.root.iterfind("StructuredGrid/Piece"))
    points = pieces[0].find("Points/DataArray") if len(pieces) == 1 else None
    if points is None:
        raise InputError(f"it has {len(pieces)} pieces of a structured grid with points: one is read")
    ends = [int(number) for number in pieces[0].attrib["Extent"].split()]
    n_i, n_j, n_k = (last - first + 1 for first, last in zip(ends[::2], ends[1::2], strict=True))
    if n_i < 2 or n_j < 2 or n_k != 1:
        raise InputError(f"it has {n_i} x {n_j} x {n_k} nodes: a plane grid has at least 2 x 2 x 1")
    return reader.array(points, 3 * n_i * n_j).reshape(n_j, n_i, 3).transpose(1, 0, 2)
