"""Meshes from VTK XML files of unstructured grids."""

from __future__ import annotations

from typing import Final
from xml.etree import ElementTree

import numpy as np

from equimesh.errors import InputError
from equimesh.io.reading.plain_mesh import PlainMesh, check_side_count, refuse_cell
from equimesh.io.reading.refusals import most_unpacked
from equimesh.io.vtk_xml import BROKEN, VtkXml
from equimesh.numerics.types import Array, IntArray

# VTK's numbers of the cells that are read or skipped, ...
VERTEX, LINE, PIXEL, QUADRILATERAL = 1, 3, 8, 9
# ... and of others, by name.
OTHERS: Final = {
    2: "cloud of points", 4: "line of several edges", 5: "triangle", 6: "strip of triangles", 7: "polygon",
    10: "tetrahedron", 12: "hexahedron", 13: "prism", 14: "pyramid", 22: "triangle of the second order",
    23: "quadrilateral of the second order", 28: "quadrilateral of the second order",
}  # fmt: skip
# Cell data whose integers name the sides that lines belong to; the first one in the file is taken.
SIDE_DATA: Final = ("side", "boundary", "gmsh:physical", "CellEntityIds", "tag", "cell_tags")
# What the names of field data with the edges of a side begin with.
SIDE_DATA_PREFIX: Final = "sides/"


def read_vtu(data: bytes) -> PlainMesh:
    """The mesh of a ``.vtu`` file of one piece.

    Field data whose names begin with ``sides/`` are the edges of sides: so :func:`~equimesh.io.write.write_mesh` writes
    them. Else lines among the cells are edges of sides, and one of the cell data ``SIDE_DATA`` gives the name
    ``group_<k>``. Raises :class:`~equimesh.errors.InputError` for cells that are no quadrilaterals, and for a broken
    file.
    """
    try:
        reader = VtkXml(data, most_unpacked(len(data)))
        pieces = list(reader.root.iter("Piece"))
        if len(pieces) != 1:
            raise InputError(f"the vtu file has {len(pieces)} pieces: save one piece", field="file")
        return _mesh(reader, pieces[0])
    except BROKEN as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"the vtu file cannot be read: {str(error)[:200]}", field="file") from error


def _mesh(reader: VtkXml, piece: ElementTree.Element) -> PlainMesh:
    count, cells = int(piece.attrib["NumberOfPoints"]), int(piece.attrib["NumberOfCells"])
    where = piece.find("Points/DataArray")
    if where is None:
        raise InputError("the vtu file has no points", field="file")
    points = reader.array(where, 3 * count).reshape(count, 3)
    named = {array.get("Name"): array for array in piece.iterfind("Cells/DataArray")}
    for name in ("connectivity", "offsets", "types"):
        if name not in named:
            raise InputError(f"the cells of the vtu file have no array {name!r}", field="file")
    offsets, types = (reader.array(named[name], cells).astype(np.int64) for name in ("offsets", "types"))
    size = int(offsets[-1]) if cells else 0
    starts = np.concatenate([np.zeros(1, np.int64), offsets[:-1]])
    if (np.diff(np.append(starts, size)) < 0).any():
        raise InputError("the offsets of the vtu file fall", field="file")
    nodes = reader.array(named["connectivity"], size).astype(np.int64)
    other = ~np.isin(types, (VERTEX, LINE, PIXEL, QUADRILATERAL))
    if other.any():
        cell = int(other.argmax())
        kind = OTHERS.get(int(types[cell]), f"cell of the type {types[cell]}")
        raise refuse_cell(kind, cell, points, nodes[starts[cell] : offsets[cell]])
    sides = _named_sides(reader)
    lines = _rows(nodes, starts, offsets, types == LINE, 2)
    if len(lines) and not sides:
        sides = _sides(reader, piece, lines, types == LINE)
    quads = _rows(nodes, starts, offsets, (types == QUADRILATERAL) | (types == PIXEL), 4)
    pixels = types[(types == QUADRILATERAL) | (types == PIXEL)] == PIXEL
    quads[pixels] = quads[pixels][:, [0, 1, 3, 2]]
    return PlainMesh.of(points, quads, sides)


def _rows(nodes: IntArray, starts: IntArray, offsets: IntArray, wanted: Array, corners: int) -> IntArray:
    """The nodes of the ``wanted`` cells, which have as many ``corners``."""
    first = starts[wanted]
    if (offsets[wanted] - first != corners).any():
        raise InputError(f"a cell of the vtu file does not have the {corners} nodes of its type", field="file")
    found: IntArray = nodes[first[:, None] + np.arange(corners)]
    return found


def _named_sides(reader: VtkXml) -> dict[str, IntArray]:
    """The edges of sides in the field data, by their names."""
    found: dict[str, IntArray] = {}
    for array in reader.root.iterfind("UnstructuredGrid/FieldData/DataArray"):
        name = array.get("Name", "")
        if name.startswith(SIDE_DATA_PREFIX) and array.get("NumberOfComponents") == "2":
            numbers = reader.array(array, 2 * int(array.get("NumberOfTuples", "0")))
            check_side_count(len(found) + 1)
            found[name.removeprefix(SIDE_DATA_PREFIX)] = numbers.astype(np.int64).reshape(-1, 2)
    return found


def _sides(reader: VtkXml, piece: ElementTree.Element, lines: IntArray, wanted: Array) -> dict[str, IntArray]:
    """The lines by the integer that names their side; no sides where the file has none."""
    for array in piece.iterfind("CellData/DataArray"):
        if array.get("Name") in SIDE_DATA and array.get("NumberOfComponents", "1") in ("", "1"):
            number = reader.array(array, len(wanted)).astype(np.int64)[wanted]
            groups = np.unique(number).tolist()
            check_side_count(len(groups))
            return {f"group_{k}": lines[number == k] for k in groups if k}
    return {}
