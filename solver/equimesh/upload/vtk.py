"""Points and point data of VTK files that a caller sends: ``.vtu`` (XML) and legacy ``.vtk``.

Only the data of samples is decoded, and at most as many bytes and samples of it as the limits allow: the size of an
expanded block is known from the number of points before it is expanded. Cells are skipped.
"""

import re
from collections.abc import Iterator
from typing import Any, TypeAlias

import numpy as np

from equimesh.errors import SamplesError
from equimesh.io.reading.vtk import BROKEN, VtkXml
from equimesh.numerics.types import Array
from equimesh.upload.columns import MAX_SECTIONS, Limits

Cloud: TypeAlias = tuple[Array, dict[str, Array]]

LEGACY_TYPES = {
    "char": "i1", "short": "i2", "int": "i4", "long": "i8", "vtkidtype": "i4", "vtktypeint64": "i8",
    "unsigned_char": "u1", "unsigned_short": "u2", "unsigned_int": "u4", "unsigned_long": "u8",
    "float": "f4", "double": "f8",
}  # fmt: skip
LEGACY_COMPONENTS = {"VECTORS": 3, "NORMALS": 3, "TENSORS": 9, "TENSORS6": 6}
_BLANK_LINE = re.compile(rb"\n[^\S\n]*(\n|\Z)")
_WORD = re.compile(rb"\S")
LEGACY_CELLS = {"CELLS", "VERTICES", "LINES", "POLYGONS", "TRIANGLE_STRIPS"}


def read_vtu(data: bytes, limits: Limits) -> Cloud:
    """Points, shape ``(n, 3)``, and the scalar point data by name, each ``(n,)``, of a VTK XML file.

    Reads every encoding: text, inline base64, appended base64 or raw, uncompressed or with zlib or LZMA.
    Raises :class:`~equimesh.errors.SamplesError`.
    """
    try:
        reader = VtkXml(data, limits.max_bytes)
        points, fields, total = [], [], 0
        for piece in reader.root.iter("Piece"):
            count = int(piece.attrib["NumberOfPoints"])
            total += max(count, 0)
            limits.check(total)
            points.append(reader.points(piece))
            scalars = [
                a for a in piece.iterfind("PointData/DataArray") if a.get("NumberOfComponents", "1") in ("", "1")
            ]
            fields.append({a.get("Name", ""): reader.array(a, count) for a in scalars})
    except BROKEN as error:
        if isinstance(error, SamplesError):
            raise
        raise SamplesError(f"the vtu file cannot be read: {str(error)[:200]}") from error
    if not points:
        raise SamplesError("the vtu file has no piece with points")
    common = [name for name in fields[0] if all(name in piece for piece in fields)]
    return np.concatenate(points), {name: np.concatenate([piece[name] for piece in fields]) for name in common}


def read_legacy_vtk(data: bytes, limits: Limits) -> Cloud:
    """Points, shape ``(n, 3)``, and the scalar point data by name, each ``(n,)``, of a legacy VTK file.

    Reads text and binary files of versions 1 to 5 whose dataset lists its points (unstructured or structured
    grid, poly data). Raises :class:`~equimesh.errors.SamplesError`.
    """
    try:
        return _LegacyReader(data, limits).read()
    except (KeyError, ValueError, IndexError) as error:
        if isinstance(error, SamplesError):
            raise
        raise SamplesError(f"the vtk file cannot be read: {str(error)[:200]}") from error


class _LegacyReader:
    """A cursor over a legacy file: lines of words, and arrays in the file's encoding."""

    def __init__(self, data: bytes, limits: Limits) -> None:
        self.data, self.at, self.limits, self.sections = data, 0, limits, 0
        self.points: Array | None = None
        self.fields: dict[str, Array] = {}
        if not self._line().startswith(b"# vtk DataFile"):
            raise SamplesError("the file does not start with '# vtk DataFile Version': it is no legacy vtk file")
        self._line()  # the title
        encoding = self._words()
        if encoding not in (["ASCII"], ["BINARY"]):
            raise SamplesError(f"the third line of the vtk file is {' '.join(encoding)[:30]!r}, not ASCII or BINARY")
        self.ascii = encoding == ["ASCII"]

    def read(self) -> Cloud:
        on_points, count = False, 0
        while words := self._words():
            self._count_section()
            key = words[0].upper()
            if key in ("POINT_DATA", "CELL_DATA"):
                on_points, count = key == "POINT_DATA", int(words[1])
            elif key in ("SCALARS", "FIELD") or key in LEGACY_COMPONENTS or key == "TEXTURE_COORDINATES":
                self._attribute(key, words, count, on_points)
            else:
                self._geometry(key, words)
        if self.points is None:
            raise SamplesError("the vtk file has no POINTS: save it as an unstructured grid")
        n = len(self.points)
        wrong = [name for name, values in self.fields.items() if len(values) != n]
        if wrong:
            raise SamplesError(f"point data {wrong[0]!r} has {len(self.fields[wrong[0]])} values for {n} points")
        return self.points, self.fields

    def _geometry(self, key: str, words: list[str]) -> None:
        if key == "POINTS":
            self.limits.check(int(words[1]))
            self.points = self._array(words[2], 3 * int(words[1])).reshape(-1, 3)
        elif key in LEGACY_CELLS:
            before, line = self.at, self._words()
            if line and line[0].upper() == "OFFSETS":  # version 5
                self._skip(line[1], int(words[1]))
                self._skip(self._words()[1], int(words[2]))
            else:
                self.at = before
                self._skip("int", int(words[2]))
        elif key == "CELL_TYPES":
            self._skip("int", int(words[1]))
        elif key == "METADATA":
            blank = _BLANK_LINE.search(self.data, self.at - 1)
            self.at = len(self.data) if blank is None else blank.end()
        elif key == "LOOKUP_TABLE":
            self._skip("unsigned_char" if not self.ascii else "float", 4 * int(words[2]))
        elif key not in ("DATASET", "DIMENSIONS"):
            raise SamplesError(
                f"section {words[0][:30]!r} of the vtk file is not known: save it as an unstructured grid"
            )

    def _attribute(self, key: str, words: list[str], count: int, on_points: bool) -> None:
        if key == "FIELD":
            for _ in range(int(words[2])):
                self._count_section()
                line = self._words()
                if line[0].upper() == "METADATA":
                    self._geometry("METADATA", line)
                    line = self._words()
                self._take(line[0], line[3], int(line[1]), int(line[2]), on_points)
            return
        components = LEGACY_COMPONENTS.get(key, 1)
        dtype = words[2]
        if key == "TEXTURE_COORDINATES":
            components, dtype = int(words[2]), words[3]
        if key == "SCALARS":
            components = int(words[3]) if len(words) > 3 else 1
            self._words()  # LOOKUP_TABLE and its name
        self._take(words[1], dtype, components, count, on_points)

    def _take(self, name: str, dtype: str, components: int, count: int, on_points: bool) -> None:
        """Read an attribute if it is a number at each point, and skip it otherwise."""
        if on_points and components == 1:
            self.limits.check(count)
            self.fields[name] = self._array(dtype, count)
        else:
            self._skip(dtype, components * count)

    def _count_section(self) -> None:
        self.sections += 1
        if self.sections > MAX_SECTIONS:
            raise SamplesError(f"the vtk file has more than {MAX_SECTIONS} sections and arrays")

    def _line(self) -> bytes:
        end = self.data.find(b"\n", self.at)
        end = len(self.data) if end < 0 else end
        line, self.at = self.data[self.at : end], end + 1
        return line

    def _words(self) -> list[str]:
        """The words of the next line that is not blank; none at the end of the file."""
        found = _WORD.search(self.data, self.at)  # any number of blank lines before it, in one step
        if found is None:
            self.at = len(self.data)
            return []
        self.at = found.start()
        return self._line().decode("latin-1").split()

    def _array(self, type_name: str, size: int) -> Array:
        """The next ``size`` numbers."""
        dtype = self._checked(type_name, size)
        if self.ascii:
            return np.array([word for line in self._lines(size) for word in line], dtype=np.float64)
        values = np.frombuffer(self.data, dtype, count=size, offset=self.at).astype(np.float64)
        self.at += size * dtype.itemsize
        return values

    def _skip(self, type_name: str, size: int) -> None:
        """Go past the next ``size`` numbers, and keep none of them."""
        dtype = self._checked(type_name, size)
        if self.ascii:
            for _ in self._lines(size):
                pass
        else:
            self.at += size * dtype.itemsize

    def _checked(self, type_name: str, size: int) -> np.dtype[Any]:
        """The type of an array that the file is long enough for."""
        dtype = np.dtype(LEGACY_TYPES[type_name.lower()]).newbyteorder(">")
        if size < 0 or size * (2 if self.ascii else dtype.itemsize) > len(self.data) - self.at + 2:
            raise SamplesError(f"the vtk file ends before the {size} numbers of an array")
        return dtype

    def _lines(self, size: int) -> Iterator[list[str]]:
        """The words of the lines that hold the next ``size`` numbers of a text file."""
        count = 0
        while count < size:
            line = self._words()
            if not line:
                raise SamplesError(f"the vtk file ends before the {size} numbers of an array")
            count += len(line)
            if count > size:
                raise SamplesError(f"the vtk file has {count} numbers where {size} are expected")
            yield line
