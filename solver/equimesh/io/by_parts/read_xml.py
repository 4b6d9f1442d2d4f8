"""Rows of meshes in parts in VTK's XML files with raw appended data: the files are mapped into memory."""

import xml.etree.ElementTree as ET
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from equimesh.io.by_parts.layout import PartedGrid
from equimesh.io.by_parts.pvtu import ROWS
from equimesh.io.by_parts.vtk_raw import COUNT_BYTES
from equimesh.meshes.grid import Grid

# What stands before the bytes of the arrays.
APPENDED = b'<AppendedData encoding="raw">\n_'
# The types of the numbers, by VTK's names.
TYPES = {"Float64": np.float64, "Int32": np.int32, "Int64": np.int64, "UInt8": np.uint8}
# The longest text before the arrays.
MAX_TEXT = 1 << 20


@dataclass(frozen=True, kw_only=True, eq=False)
class Piece:
    """The file of a part: its text, and where its bytes begin."""

    path: Path
    text: ET.Element
    start: int

    @classmethod
    def of(cls, path: Path) -> "Piece":
        """The piece in a file."""
        with path.open("rb") as file:
            head, found, _ = file.read(MAX_TEXT).partition(APPENDED)
        if not found:
            raise ValueError(f"{path.name} has no raw appended data")
        return cls(path=path, text=ET.fromstring(head + b"</VTKFile>"), start=len(head) + len(found))

    def names(self, section: str) -> tuple[str, ...]:
        """The names of the arrays of a section."""
        return tuple(array.attrib["Name"] for array in self.text.iterfind(f".//Piece/{section}/DataArray"))

    def array(self, section: str, name: str, shape: tuple[int, ...]) -> npt.NDArray[Any]:
        """An array, mapped into memory."""
        found = self.text.find(f".//Piece/{section}/DataArray[@Name='{name}']")
        if found is None:
            raise KeyError(name)
        offset = self.start + int(found.attrib["offset"]) + COUNT_BYTES
        return np.memmap(self.path, TYPES[found.attrib["type"]], "r", offset=offset, shape=shape)


@dataclass(frozen=True, kw_only=True, eq=False)
class XmlParts(ABC):
    """The arrays of several pieces, each of which holds the first row of the next one, too."""

    parted: PartedGrid
    nodes: tuple[str, ...]
    cells: tuple[str, ...]
    pieces: tuple[Piece, ...]

    def rows(self, name: str, first: int, last: int) -> npt.NDArray[Any]:
        """Some rows of an array."""
        in_cells = name in self.cells
        found = []
        for number, piece in enumerate(self.pieces):
            begin, end = self.parted.cell_rows(number) if in_cells else self.parted.ends[number]
            low, high = max(first, begin), min(last, end)
            if low < high:
                found.append(np.array(self.table(piece, number, name)[low - begin : high - begin]))
        width = self.parted.grid.n_eta - in_cells
        return np.concatenate(found) if found else np.empty((0, width))

    def table(self, piece: Piece, number: int, name: str) -> npt.NDArray[Any]:
        """All rows of an array that a piece holds, mapped into memory."""
        first, end = self.parted.cell_rows(number)
        rows, columns = end - first, self.parted.grid.n_eta - 1
        if name in self.cells:
            return self.in_rows(piece.array("CellData", name, self.shape(rows, columns)))
        shape = self.shape(rows + 1, columns + 1)
        if name in ("x", "y"):
            return self.in_rows(piece.array("Points", "Points", (*shape, 3)))[:, :, "xy".index(name)]
        return self.in_rows(piece.array("PointData", name, shape))

    @abstractmethod
    def shape(self, rows: int, columns: int) -> tuple[int, int]:
        """The shape of an array in the file."""

    @abstractmethod
    def in_rows(self, values: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """An array of the file with xi first."""


class StructuredParts(XmlParts):
    """The pieces of a ``.pvts``, whose rows are along xi."""

    @classmethod
    def of(cls, head: Path) -> "StructuredParts":
        """The parts that a head names."""
        root = ET.parse(head).getroot()
        whole = root.find("PStructuredGrid")
        if whole is None:
            raise ValueError("it has no PStructuredGrid")
        _, n_xi, _, n_eta, *_ = (int(number) + 1 for number in whole.attrib["WholeExtent"].split())
        found = whole.findall("Piece")
        firsts = [int(piece.attrib["Extent"].split()[0]) for piece in found]
        pieces = tuple(Piece.of(head.parent / piece.attrib["Source"]) for piece in found)
        return cls(parted=PartedGrid.of(Grid(n_xi=n_xi, n_eta=n_eta), firsts[1:]), pieces=pieces, **_names(pieces))

    def shape(self, rows: int, columns: int) -> tuple[int, int]:
        """The shape of an array in the file."""
        return columns, rows

    def in_rows(self, values: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """An array of the file with xi first."""
        return values.swapaxes(0, 1)


class UnstructuredParts(XmlParts):
    """The pieces of a ``.pvtu``, whose nodes are in our order."""

    @classmethod
    def of(cls, head: Path) -> "UnstructuredParts":
        """The parts that a head names."""
        found = ET.parse(head).getroot().findall("PUnstructuredGrid/Piece")
        pieces = tuple(Piece.of(head.parent / piece.attrib["Source"]) for piece in found)
        where = [_rows_of(piece) for piece in pieces]
        n_xi, n_eta, _ = where[0]
        grid = Grid(n_xi=n_xi, n_eta=n_eta)
        return cls(parted=PartedGrid.of(grid, [first for *_, first in where[1:]]), pieces=pieces, **_names(pieces))

    def shape(self, rows: int, columns: int) -> tuple[int, int]:
        """The shape of an array in the file."""
        return rows, columns

    def in_rows(self, values: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """An array of the file with xi first."""
        return values


def _names(pieces: tuple[Piece, ...]) -> Mapping[str, Any]:
    own = ("node_groups", "GlobalNodeIds")
    return {
        "nodes": tuple(name for name in pieces[0].names("PointData") if name not in own),
        "cells": pieces[0].names("CellData"),
    }


def _rows_of(piece: Piece) -> list[int]:
    found = piece.text.find(f".//FieldData/DataArray[@Name='{ROWS}']")
    if found is None or not found.text:
        raise ValueError(f"{piece.path.name} does not say which rows it holds")
    return [int(number) for number in found.text.split()]
