"""Meshes from SU2 files."""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import islice
from typing import Final

import numpy as np

from equimesh.io.reading.bounds import bad_file, floats, integers, line_of
from equimesh.io.reading.plain_mesh import PlainMesh, refuse_cell
from equimesh.numerics.types import Array, IntArray

# VTK's numbers of the element types, which SU2 uses: those that are read, ...
LINE, QUADRILATERAL = 3, 9
# ... and those that are refused.
OTHERS: Final = {5: "triangle", 10: "tetrahedron", 12: "hexahedron", 13: "prism", 14: "pyramid"}

# Lines with a keyword, at most.
MAX_KEYS: Final = 10_000

_COMMENT = re.compile(rb"%[^\n]*")
_KEY = re.compile(rb"^[^\S\n]*([A-Z_]+)[^\S\n]*=[^\S\n]*(\S*)", re.MULTILINE)


@dataclass(frozen=True)
class _Entry:
    """A line ``key= value``, and the rows below it; ``line`` is the number of the line of the key."""

    key: str
    value: str
    rows: bytes
    line: int

    def count(self) -> int:
        """The value as a number of rows."""
        try:
            count = int(self.value)
        except ValueError:
            count = -1
        if count < 0:
            raise bad_file(f"line {self.line}: {self.key}= {self.value[:20]!r} is no number of rows")
        return count


def read_su2(data: bytes) -> PlainMesh:
    """The mesh of an SU2 file of dimension 2; its markers are the sides.

    Raises :class:`~equimesh.errors.InputError` for cells that are no quadrilaterals, and for a broken file, with the
    line.

    Source: SU2 documentation, "Mesh file".
    """
    entries = _entries(_COMMENT.sub(b"", data))
    single = {entry.key: entry for entry in entries}
    for key in ("NDIME", "NELEM", "NPOIN"):
        if key not in single:
            raise bad_file(f"the SU2 file has no {key}=")
    if single["NDIME"].value != "2":
        line = single["NDIME"].line
        raise bad_file(f"line {line}: the SU2 mesh has {single['NDIME'].value} dimensions, not 2")
    points = _points(single["NPOIN"])
    sides: dict[str, list[IntArray]] = {}
    name = ""
    for entry in entries:
        if entry.key == "MARKER_TAG":
            name = entry.value
        elif entry.key == "MARKER_ELEMS" and (entry.count() or entry.rows.strip()):  # others are empty
            sides.setdefault(name, []).append(_elements(entry, LINE, points))
    cells = _elements(single["NELEM"], QUADRILATERAL, points)
    return PlainMesh.of(points, cells, {name: np.concatenate(edges) for name, edges in sides.items()})


def _entries(data: bytes) -> list[_Entry]:
    found = list(islice(_KEY.finditer(data), MAX_KEYS + 1))
    if len(found) > MAX_KEYS:
        raise bad_file(f"the SU2 file has more than {MAX_KEYS} lines with a keyword: no mesh has so many")
    ends = [head.start() for head in found[1:]] + [len(data)] * bool(found)
    result, line, at = [], 1, 0
    for head, end in zip(found, ends, strict=True):
        line, at = line + line_of(data[at : head.start(1)], head.start(1) - at) - 1, head.start(1)
        after = data.find(b"\n", head.end())
        rows = data[after + 1 : end] if 0 <= after < end else b""
        result.append(_Entry(head[1].decode(), head[2].decode("latin-1"), rows, line))
    return result


def _points(entry: _Entry) -> Array:
    """The coordinates, shape ``(n, 2)``; rows may end with the number of the point."""
    count = entry.count()
    flat = floats(entry.rows, entry.line + 1, "the points")
    columns = len(flat) // count if count else 0
    if columns not in (2, 3) or len(flat) != count * columns:
        raise bad_file(f"line {entry.line}: {count} points with x and y are told, but {len(flat)} numbers follow")
    rows = flat.reshape(count, columns)
    if columns == 3 and not np.array_equal(rows[:, 2], np.arange(count)):
        ordered = np.empty((count, 2))
        numbers = rows[:, 2].astype(np.int64)
        if not np.array_equal(np.sort(numbers), np.arange(count)):
            raise bad_file(f"line {entry.line}: the points are not numbered from 0 to {count - 1}")
        ordered[numbers] = rows[:, :2]
        return ordered
    return np.ascontiguousarray(rows[:, :2])


def _elements(entry: _Entry, wanted: int, points: Array) -> IntArray:
    """The nodes of elements of one kind; rows may end with the number of the element."""
    count = entry.count()
    flat = integers(entry.rows, entry.line + 1, "the elements")
    corners = 4 if wanted == QUADRILATERAL else 2
    columns = len(flat) // count if count else 0
    if columns in (corners + 1, corners + 2) and len(flat) == count * columns:
        rows = flat.reshape(count, columns)
        if (rows[:, 0] == wanted).all():
            return np.ascontiguousarray(rows[:, 1 : corners + 1])
    for k, row in enumerate(entry.rows.split(b"\n")):
        words = row.split()
        if words and int(words[0]) != wanted:
            kind = OTHERS.get(int(words[0]), f"element of the type {words[0].decode()}")
            if wanted == LINE:
                raise bad_file(f"line {entry.line + 1 + k}: a {kind} in a marker: the sides of a plane mesh are lines")
            raise refuse_cell(kind, k, points, np.array([int(word) for word in words[1:4]], dtype=np.int64))
    raise bad_file(f"line {entry.line}: {count} elements of {corners} nodes are told, but {len(flat)} numbers follow")
