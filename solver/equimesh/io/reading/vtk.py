"""Files of VTK in XML: their trees and arrays, within bounds; meshes of cells and of blocks."""

from __future__ import annotations

import base64
import binascii
import lzma
import mmap
import re
import sys
import zlib
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Any, Final, Literal, NoReturn
from xml.etree import ElementTree
from xml.parsers import expat

import numpy as np
import numpy.typing as npt

from equimesh.errors import InputError, SamplesError
from equimesh.io.reading.bounds import MAX_EXPANDED, bad_file, most_unpacked
from equimesh.io.reading.plain_mesh import PlainMesh, check_side_count, refuse_cell
from equimesh.io.reading.structured import joined
from equimesh.numerics.types import Array, IntArray

# The tree of a file: no document type, no entities, nothing from elsewhere.

MAX_LEVELS: Final = 50
MAX_PARTS: Final = 100_000


def parse_xml(data: bytes, kind: str) -> ElementTree.Element:
    """The root of the tree of ``data``; messages call it a ``kind`` file.

    The parser itself stops at a document type, so that no encoding can hide one.
    Raises :class:`~equimesh.errors.SamplesError`.
    """
    if max(data.count(b"<"), data.count(b"=")) > MAX_PARTS:  # numbers, and what is packed, have next to none
        raise SamplesError(f"the {kind} file has more than {MAX_PARTS} elements or attributes")
    builder = ElementTree.TreeBuilder()
    depth = 0

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > MAX_LEVELS:
            raise SamplesError(f"the {kind} file is nested more than {MAX_LEVELS} levels deep")
        builder.start(tag, attributes)

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(tag)

    def refuse(*_: object) -> NoReturn:
        raise SamplesError(f"the {kind} file declares a document type or entities: save it again without them")

    parser = expat.ParserCreate()
    parser.buffer_text = True
    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler = builder.data
    parser.StartDoctypeDeclHandler = refuse
    try:
        parser.Parse(data, True)
    except (expat.ExpatError, ValueError, LookupError) as error:  # the latter two for unknown encodings
        if isinstance(error, SamplesError):
            raise
        raise SamplesError(f"the {kind} file cannot be read: {str(error)[:200]}") from error
    return builder.close()


# Arrays in every encoding that VTK knows, with a limit of their size.

XML_TYPES = {f"{kind}{bits}": f"{kind[0].lower()}{bits // 8}" for kind in ("Int", "UInt") for bits in (8, 16, 32, 64)}
XML_TYPES |= {"Float32": "f4", "Float64": "f8"}
HEADER_TYPES = {"UInt32": "u4", "UInt64": "u8"}
DECOMPRESSORS: dict[str, Callable[[], Any]] = {
    "vtkZLibDataCompressor": zlib.decompressobj,
    "vtkLZMADataCompressor": partial(lzma.LZMADecompressor, memlimit=2**26),
}
# What a broken file raises besides.
BROKEN: Final = (KeyError, ValueError, binascii.Error, zlib.error, lzma.LZMAError)
# The least bytes of a compressed block, but for the last one; VTK's have 32768 of them.
MIN_BLOCK: Final = 512


class VtkXml:
    """One VTK XML file: its tree ``root``, and how its arrays are encoded.

    Reads every encoding: text, inline base64, appended base64 or raw, uncompressed or with zlib or LZMA. At most
    ``max_bytes`` of arrays are decoded. Raises :class:`~equimesh.errors.SamplesError`.
    """

    def __init__(self, data: bytes | mmap.mmap, max_bytes: int) -> None:
        end = data.find(b"<AppendedData")
        self.root = parse_xml(data[:] if end < 0 else data[:end] + b"</VTKFile>", "vtu")
        if self.root.tag != "VTKFile":
            raise SamplesError(f"the vtu file starts with <{self.root.tag}>, not with <VTKFile>")
        self.budget = max_bytes
        begin = data.find(b"_", end) + 1 if end >= 0 else 0
        self.appended = memoryview(data)[begin if begin else len(data) :]
        self.raw = re.search(rb"""encoding\s*=\s*["']raw""", data[end:begin] if begin else b"") is not None
        self.order: Literal["<", ">"] = ">" if self.root.get("byte_order") == "BigEndian" else "<"
        self.header = np.dtype(HEADER_TYPES[self.root.get("header_type", "UInt32")]).newbyteorder(self.order)
        compressor = self.root.get("compressor")
        if compressor is not None and compressor not in DECOMPRESSORS:
            raise SamplesError(f"the vtu file is compressed by {compressor}: save it with zlib or uncompressed")
        self.decompressor = DECOMPRESSORS.get(compressor) if compressor else None

    @classmethod
    def mapped(cls, path: Path) -> VtkXml:
        """The file at ``path``, of which only what is read comes into memory. Raises ``OSError``."""
        with path.open("rb") as file:
            return cls(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ), sys.maxsize)

    def points(self, piece: ElementTree.Element) -> Array:
        """The points of a piece, shape ``(n, 3)``. Raises what :meth:`stored` raises."""
        count = int(piece.attrib["NumberOfPoints"])
        where = piece.find("Points/DataArray")
        if where is None:
            raise SamplesError("a piece of the vtu file has no points", field="file")
        return self.array(where, 3 * count).reshape(count, 3)

    def array(self, element: ElementTree.Element, size: int) -> Array:
        """The ``size`` numbers of a DataArray in double precision; integers up to 2**53 stay exact.

        Raises what :meth:`stored` raises.
        """
        return self.stored(element, size).astype(np.float64)

    def stored(self, element: ElementTree.Element, size: int) -> npt.NDArray[Any]:
        """The ``size`` numbers of a DataArray, of the type that the file has; those of a text in double precision.

        Plain bytes that follow the text are not copied. Raises :class:`~equimesh.errors.SamplesError`, and the errors
        of broken encodings (``BROKEN``).
        """
        name = element.get("Name", "points")
        dtype = np.dtype(XML_TYPES[element.attrib["type"]]).newbyteorder(self.order)
        self.budget -= size * 8
        if size < 0 or self.budget < 0:
            raise SamplesError(f"the vtu file holds more data than the limit allows (reached at {name!r})")
        form = element.get("format", "ascii")
        if form == "ascii":
            values: npt.NDArray[Any] = np.array((element.text or "").split(None, size)[: size + 1], dtype=np.float64)
        else:
            block, raw = memoryview((element.text or "").strip().encode()), False
            if form == "appended":
                block, raw = self.appended[int(element.attrib["offset"]) :], self.raw
            values = np.frombuffer(self._decoded(block, raw, size * dtype.itemsize), dtype)
        if values.size != size:
            raise SamplesError(f"array {name!r} of the vtu file has {values.size} numbers where {size} are expected")
        return values

    def _decoded(self, block: memoryview, raw: bool, expected: int) -> bytes | memoryview:
        """The bytes of a block, which must be ``expected`` in number."""
        item = self.header.itemsize
        if self.decompressor is None:
            found = _take(block, raw, item + expected)
            declared = int(np.frombuffer(found[:item], self.header)[0])
            if declared != expected:
                raise SamplesError(f"an array of the vtu file has {declared} bytes where {expected} are expected")
            return found[item:]
        blocks = int(np.frombuffer(_take(block, raw, item), self.header)[0])
        if blocks > len(block) // item:
            raise SamplesError("an array of the vtu file ends too early")
        if blocks > 1 + expected // MIN_BLOCK:
            raise SamplesError(f"an array of the vtu file has {blocks} blocks for {expected} bytes: save larger blocks")
        sizes = np.frombuffer(_take(block, raw, (3 + blocks) * item), self.header)[3:].astype(object)
        start = (3 + blocks) * item if raw else -(-(3 + blocks) * item // 3) * 4  # the header is encoded by itself
        packed, done, at = _take(block[start:], raw, int(sum(sizes))), bytearray(), 0
        for size in sizes:
            done += self.decompressor().decompress(packed[at : at + size], expected - len(done) + 1)
            at += size
            if len(done) > expected:
                break
        if len(done) != expected:
            raise SamplesError(f"an array of the vtu file does not expand to the {expected} bytes expected")
        return bytes(done)


def _take(block: memoryview, raw: bool, count: int) -> bytes | memoryview:
    """The first ``count`` bytes of a raw or base64 block."""
    found = block[:count] if raw else base64.b64decode(block[: -(-count // 3) * 4])[:count]
    if len(found) != count:
        raise SamplesError("an array of the vtu file ends too early")
    return found


# Meshes of unstructured grids (vtu).

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
            raise bad_file(f"the vtu file has {len(pieces)} pieces: save one piece")
        return _mesh(reader, pieces[0])
    except BROKEN as error:
        if isinstance(error, InputError):
            raise
        raise bad_file(f"the vtu file cannot be read: {str(error)[:200]}") from error


def _mesh(reader: VtkXml, piece: ElementTree.Element) -> PlainMesh:
    points, cells = reader.points(piece), int(piece.attrib["NumberOfCells"])
    named = {array.get("Name"): array for array in piece.iterfind("Cells/DataArray")}
    for name in ("connectivity", "offsets", "types"):
        if name not in named:
            raise bad_file(f"the cells of the vtu file have no array {name!r}")
    offsets, types = (reader.array(named[name], cells).astype(np.int64) for name in ("offsets", "types"))
    size = int(offsets[-1]) if cells else 0
    starts = np.concatenate([np.zeros(1, np.int64), offsets[:-1]])
    if (np.diff(np.append(starts, size)) < 0).any():
        raise bad_file("the offsets of the vtu file fall")
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
        raise bad_file(f"a cell of the vtu file does not have the {corners} nodes of its type")
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
        raise bad_file(f"the vtm file has {len(entries)} blocks: a vtkMultiBlockDataSet of 1 to {MAX_BLOCKS} is read")
    blocks, names, left = [], [], most
    files: set[str] = set()
    for number, entry in enumerate(entries):
        file = entry.get("file", "")
        place = PurePosixPath(file)
        if not file or place.is_absolute() or ".." in place.parts:
            raise bad_file(f"block {number} of the vtm file is in {file[:80]!r}: its file must be next to the vtm file")
        if file in files:
            raise bad_file(f"two blocks of the vtm file are in {file[:80]!r}: name each file once")
        files.add(file)
        data = read(file)
        try:
            blocks.append(_grid(data, left))
        except BROKEN as error:
            raise bad_file(f"{file[:80]!r} of the vtm file cannot be read: {str(error)[:200]}") from error
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
