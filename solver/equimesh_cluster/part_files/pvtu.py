"""Unstructured grids of VTK in parts: a ``.vtu`` file for every part, and a ``.pvtu`` head.

Nodes and cells are in our order. Neighbouring parts share the row of nodes between them; the point data
``GlobalNodeIds`` are the numbers of the nodes in the whole mesh, by which a program can join them. The arrays of a part
follow its text as plain bytes, "raw appended data", so that they are written block by block, and read from a file that
is mapped into memory.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias
from xml.sax.saxutils import quoteattr

import numpy as np
import numpy.typing as npt

from equimesh.io.reading.vtk import VtkXml, parse_xml
from equimesh.io.vtk import CELL_TYPES, NUMBERS
from equimesh.io.vtk import head as head_lines
from equimesh.meshes.mesh import Grid
from equimesh_cluster.mesh_part import MeshPart
from equimesh_cluster.part_files.formats import (
    PARTED_FORMATS,
    ROWS,
    NodeValues,
    PartData,
    PartedGrid,
    blocks,
    cell_arrays,
    cell_type,
    corners,
    node_block,
    part_reference,
    side_digits,
)

Blocks: TypeAlias = Callable[[], Iterator[npt.NDArray[Any]]]
"""Returns the values of an array block by block."""
# The array with the number of every node in the whole mesh: what two parts share has the same number.
GLOBAL_IDS = "GlobalNodeIds"
# Bytes of the number before every array: how many bytes follow.
COUNT_BYTES = 8


def write_part(path: Path, part: MeshPart, data: PartData) -> None:
    """Write the nodes and cells of ``part`` as a ``.vtu`` file."""
    rows, columns = part.x.shape
    count = (rows - 1) * (columns - 1)
    index = np.int32 if 4 * max(part.x.size, count) <= np.iinfo(np.int32).max else np.int64
    nodes = [
        RawArray(name=name, dtype=np.float64, count=part.x.size, blocks=_by_rows(part, _values(part, values)))
        for name, values in data.nodes.items()
    ]
    nodes += [
        RawArray(name="node_groups", dtype=np.uint8, count=part.x.size, blocks=_by_rows(part, _sides(part))),
        RawArray(name=GLOBAL_IDS, dtype=np.int64, count=part.x.size, blocks=_by_rows(part, _ids(part))),
    ]
    cells = [
        RawArray(name=name, dtype=cell_type(name), count=count, blocks=_cell_rows(values))
        for name, values in cell_arrays(data, part).items()
    ]
    points = RawArray(
        name="Points", dtype=np.float64, count=3 * part.x.size, components=3, blocks=_by_rows(part, _points(part))
    )
    table = [
        RawArray(name="connectivity", dtype=index, count=4 * count, blocks=_corners(rows, columns, index)),
        RawArray(name="offsets", dtype=index, count=count, blocks=_ends(count, index)),
        RawArray(name="types", dtype=np.uint8, count=count, blocks=_types(count)),
    ]
    where = f"{part.grid.n_xi} {part.grid.n_eta} {part.first}"
    write_raw(
        path,
        f'NumberOfPoints="{part.x.size}" NumberOfCells="{count}"',
        {"Points": [points], "Cells": table, "PointData": nodes, "CellData": cells},
        extra=f'<FieldData><DataArray type="Int64" Name="{ROWS}" NumberOfTuples="3" format="ascii">{where}</DataArray>'
        "</FieldData>\n",
    )


def write_head(path: Path, head: Path, parted: PartedGrid, nodes: Sequence[str], cells: Sequence[str]) -> None:
    """Write the text of the head ``head`` to ``path``."""
    kind = PARTED_FORMATS["pvtu"]
    pieces = (f"<Piece Source={quoteattr(part_reference(head, number, kind))}/>" for number in range(parted.count))
    at_nodes = [described(name, np.float64) for name in nodes]
    sections = {
        "PPointData": [*at_nodes, described("node_groups", np.uint8), described(GLOBAL_IDS, np.int64)],
        "PCellData": [described(name, cell_type(name)) for name in (*cells, "subdomain")],
        "PPoints": [described("Points", np.float64, 3)],
    }
    path.write_text(head_text(sections, pieces), encoding="utf-8", newline="\n")


def _by_rows(part: MeshPart, block: Callable[[slice], npt.NDArray[Any]]) -> Blocks:
    rows, columns = part.x.shape
    return lambda: (block(some) for some in blocks(rows, columns))


def _points(part: MeshPart) -> Callable[[slice], npt.NDArray[Any]]:
    def found(rows: slice) -> npt.NDArray[Any]:
        points = np.zeros((rows.stop - rows.start, part.x.shape[1], 3))
        points[:, :, 0], points[:, :, 1] = part.x[rows], part.y[rows]
        return points

    return found


def _values(part: MeshPart, values: NodeValues) -> Callable[[slice], npt.NDArray[Any]]:
    return lambda rows: node_block(values, part, rows)


def _sides(part: MeshPart) -> Callable[[slice], npt.NDArray[Any]]:
    return lambda rows: side_digits(part, rows)


def _ids(part: MeshPart) -> Callable[[slice], npt.NDArray[Any]]:
    columns = part.x.shape[1]
    return lambda rows: part.first_node + np.arange(rows.start * columns, rows.stop * columns, dtype=np.int64)


def _cell_rows(values: npt.NDArray[Any]) -> Blocks:
    return lambda: (values[some] for some in blocks(*values.shape))


def _corners(rows: int, columns: int, dtype: npt.DTypeLike) -> Blocks:
    def found() -> Iterator[npt.NDArray[Any]]:
        return (corners(some.start, some.stop, columns, dtype) for some in blocks(rows - 1, 4 * columns))

    return found


def _ends(count: int, dtype: npt.DTypeLike) -> Blocks:
    return lambda: (4 * np.arange(some.start + 1, some.stop + 1, dtype=dtype) for some in blocks(count, 1))


def _types(count: int) -> Blocks:
    return lambda: (np.full(some.stop - some.start, CELL_TYPES[4], dtype=np.uint8) for some in blocks(count, 1))


@dataclass(frozen=True, kw_only=True, eq=False)
class RawArray:
    """An array of a file: ``count`` numbers of type ``dtype``, in rows of ``components``."""

    name: str
    dtype: npt.DTypeLike
    count: int
    blocks: Blocks
    components: int = 1

    @property
    def bytes(self) -> int:
        """The bytes of its numbers."""
        return self.count * np.dtype(self.dtype).itemsize


Sections: TypeAlias = Mapping[str, Sequence[RawArray]]
"""The arrays of the sections of a piece, such as ``PointData``."""


def vtk_type(dtype: npt.DTypeLike) -> str:
    """VTK's name of a type of numbers."""
    kind = np.dtype(dtype)
    return f"{NUMBERS[kind.kind]}{8 * kind.itemsize}"


def write_raw(path: Path, piece: str, sections: Sections, extra: str) -> None:
    """Write a file of one piece, which has the attributes ``piece``; ``extra`` goes before it.

    Raises ``OSError`` where the file cannot be written, and ``ValueError`` for blocks that do not add up.
    """
    arrays = [array for section in sections.values() for array in section]
    text, offset = [f"{head_lines('UnstructuredGrid')}<UnstructuredGrid>\n{extra}<Piece {piece}>\n"], 0
    for name, section in sections.items():
        has_ids = any(array.name == GLOBAL_IDS for array in section)
        text.append(f"<{name}{' GlobalIds=' + quoteattr(GLOBAL_IDS) if has_ids else ''}>\n")
        for array in section:
            text.append(
                f'<DataArray type="{vtk_type(array.dtype)}" Name={quoteattr(array.name)}'
                f' NumberOfComponents="{array.components}" format="appended" offset="{offset}"/>\n'
            )
            offset += COUNT_BYTES + array.bytes
        text.append(f"</{name}>\n")
    text.append('</Piece>\n</UnstructuredGrid>\n<AppendedData encoding="raw">\n_')
    with path.open("wb") as file:
        file.write("".join(text).encode())
        for array in arrays:
            file.write(np.uint64(array.bytes).tobytes())
            written = 0
            for block in array.blocks():
                plain = np.ascontiguousarray(block, dtype=array.dtype)
                file.write(plain.reshape(-1).view(np.uint8).data)
                written += plain.nbytes
            if written != array.bytes:
                raise ValueError(f"{array.name} has {written} bytes, not {array.bytes}")
        file.write(b"\n</AppendedData>\n</VTKFile>\n")


def head_text(sections: Mapping[str, Iterable[str]], pieces: Iterable[str]) -> str:
    """The text of a head: a description of the arrays of each section, and the pieces."""
    lines = [f'{head_lines("PUnstructuredGrid")}<PUnstructuredGrid GhostLevel="0">']
    for name, arrays in sections.items():
        described = [*arrays]
        ids = f" GlobalIds={quoteattr(GLOBAL_IDS)}" if any(f'"{GLOBAL_IDS}"' in text for text in described) else ""
        lines += [f"<{name}{ids}>", *described, f"</{name}>"]
    return "\n".join([*lines, *pieces, "</PUnstructuredGrid>", "</VTKFile>", ""])


def described(name: str, dtype: npt.DTypeLike, components: int = 1) -> str:
    """The description of an array in a head."""
    return f'<PDataArray type="{vtk_type(dtype)}" Name={quoteattr(name)} NumberOfComponents="{components}"/>'


@dataclass(frozen=True, kw_only=True)
class Piece:
    """The file of a part, which is open only while something is read."""

    path: Path

    def names(self, section: str) -> tuple[str, ...]:
        """The names of the arrays of a section."""
        found = VtkXml.mapped(self.path).root.iterfind(f".//Piece/{section}/DataArray")
        return tuple(array.attrib["Name"] for array in found)

    def array(self, section: str, name: str, shape: tuple[int, ...]) -> npt.NDArray[Any]:
        """An array of this shape, mapped into memory. Raises ``KeyError`` where there is none of this name."""
        reader = VtkXml.mapped(self.path)
        found = reader.root.find(f".//Piece/{section}/DataArray[@Name='{name}']")
        if found is None:
            raise KeyError(name)
        return reader.stored(found, math.prod(shape)).reshape(shape)

    def where(self) -> list[int]:
        """n_xi and n_eta of the whole mesh, and the first row of the part."""
        found = VtkXml.mapped(self.path).root.find(f".//FieldData/DataArray[@Name='{ROWS}']")
        if found is None or not found.text:
            raise ValueError(f"{self.path.name} does not say which rows it holds")
        return [int(number) for number in found.text.split()]


@dataclass(frozen=True, kw_only=True)
class Pieces:
    """The pieces of a head. Each piece also holds the first row of the next one."""

    parted: PartedGrid
    nodes: tuple[str, ...]
    cells: tuple[str, ...]
    pieces: tuple[Piece, ...]

    @classmethod
    def of(cls, path: Path) -> "Pieces":
        """The pieces that the head with this path names."""
        found = parse_xml(path.read_bytes(), "pvtu").findall("PUnstructuredGrid/Piece")
        pieces = tuple(Piece(path=path.parent / piece.attrib["Source"]) for piece in found)
        where = [piece.where() for piece in pieces]
        n_xi, n_eta, _ = where[0]
        return cls(
            parted=PartedGrid.of(Grid(n_xi=n_xi, n_eta=n_eta), [first for *_, first in where[1:]]),
            nodes=tuple(name for name in pieces[0].names("PointData") if name not in ("node_groups", GLOBAL_IDS)),
            cells=pieces[0].names("CellData"),
            pieces=pieces,
        )

    def rows(self, name: str, first: int, last: int) -> npt.NDArray[Any]:
        """Some rows of an array."""
        in_cells = name in self.cells
        found = []
        for number, piece in enumerate(self.pieces):
            begin, end = self.parted.cell_rows(number) if in_cells else self.parted.ends[number]
            low, high = max(first, begin), min(last, end)
            if low < high:
                found.append(np.array(self._table(piece, number, name)[low - begin : high - begin]))
        width = self.parted.grid.n_eta - in_cells
        return np.concatenate(found) if found else np.empty((0, width))

    def _table(self, piece: Piece, number: int, name: str) -> npt.NDArray[Any]:
        """All rows of an array that a piece holds, mapped into memory."""
        first, end = self.parted.cell_rows(number)
        rows, columns = end - first, self.parted.grid.n_eta - 1
        if name in self.cells:
            return piece.array("CellData", name, (rows, columns))
        if name in ("x", "y"):
            return piece.array("Points", "Points", (rows + 1, columns + 1, 3))[:, :, "xy".index(name)]
        return piece.array("PointData", name, (rows + 1, columns + 1))
