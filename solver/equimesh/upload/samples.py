"""Samples from an uploaded file: npz, npy, csv, txt, json, vtu or vtk."""

from __future__ import annotations

import io
import json
import math
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import PurePath
from typing import Any, Final, TypeAlias

import numpy as np
import numpy.typing as npt

from equimesh.domains.domain import Box
from equimesh.errors import SamplesError
from equimesh.fields.nodal_field import NodalField
from equimesh.fields.samples import UNIT_BOX, GridSamples
from equimesh.fields.scattered_samples import ScatteredSamples
from equimesh.io.reading.bounds import open_zip
from equimesh.numerics.types import Array
from equimesh.upload.columns import MATRIX, MAX_COLUMNS, Limits, choose, header_columns, numbered_columns
from equimesh.upload.nodal import OF_BLOCKS, BlockNodes, block_nodes, is_nodal, nodal_samples
from equimesh.upload.vtk import read_legacy_vtk, read_vtu

Samples: TypeAlias = GridSamples | ScatteredSamples | NodalField | BlockNodes

MAX_BYTES: Final = 256 * 2**20
PLACES = (("x", "y"), ("points",), ("nodes",))
"""The keys of the places of a grid or of columns, of scattered samples, and of a mesh of blocks."""
NPY_TYPES: Final = {
    f"{order}{code}" for code in ("f2", "f4", "f8", "i2", "i4", "i8", "u2", "u4", "u8") for order in "<>="
}
NPY_TYPES.update({"|i1", "|u1"})
NPY_TEXT: Final = re.compile(r"[<>=]U[1-9][0-9]{0,7}|\|S[1-9][0-9]{0,7}")
NPY_HEADER: Final = {
    "descr": r"""['"]descr['"]\s*:\s*['"]([^'"]*)['"]""",
    "fortran_order": r"""['"]fortran_order['"]\s*:\s*(True|False)""",
    "shape": r"""['"]shape['"]\s*:\s*\(([\d\s,]{0,99})\)""",
}
# The suffixes of XDMF files, and of what they are packed in.
XDMF: Final = ("xdmf", "zip")
NEEDED = "give x, y and values (a grid), points and values (scattered samples), or nodes and values (a mesh of blocks)"


def read_samples(
    data: bytes,
    filename: str,
    *,
    column: str | None = None,
    max_bytes: int = MAX_BYTES,
    max_samples: int = sys.maxsize,
    box: Box | None = None,
) -> Samples:
    """u from the contents ``data`` of a file; the suffix of ``filename`` determines the format.

    The samples must cover ``box = ((x0, x1), (y0, y1))``, that of the domain: the unit square unless given.

    ========= ==========================================================================================
    npz       arrays ``x``, ``y``, ``values`` (grid; scattered where all are 1-D; nodes of a mesh where all are 2-D) or
              ``points``, ``values``; ``nodes``, ``values`` at the nodes of a mesh of blocks, in its order, with
              ``block_cells`` ``(b, 2)`` where it has others than the domain; ``u`` may take the place of ``values``
    npy       ``values`` alone, 2-D: u on the uniform grid of the box, first index along x
    csv, txt  rows ``x, y, u``; a header naming them may change their order, ``#`` starts a comment
    json      ``{"grid": {...}}``, ``nodal``, ``scattered`` or ``block_nodes`` with the keys of the npz, or these alone
    vtu, vtk  the first two coordinates of the points, and the point data ``u``, or the only one there is
    ========= ==========================================================================================

    ``column`` is the name of u among the columns, arrays or point data of the file; of a table without a header its
    number, from 1, or ``"matrix"``, which takes the table as values on the uniform grid of the box, the first line
    those at the smallest x. Without it u is the one of this name, or the only one; otherwise the error lists them in
    its ``columns``.

    The points of a csv, vtu or vtk file that fill a rectilinear grid become :class:`GridSamples`, others
    :class:`ScatteredSamples`. Nothing is ever unpickled, and arrays of more than ``max_bytes`` are not
    unpacked. Reading stops after ``max_samples``. Raises :class:`~equimesh.errors.SamplesError`, whose message names
    the remedy.
    """
    arrays = read_arrays(data, filename, column=column, max_bytes=max_bytes, max_samples=max_samples)
    return samples_of(arrays, box=box)


def read_arrays(
    data: bytes,
    filename: str,
    *,
    column: str | None = None,
    max_bytes: int = MAX_BYTES,
    max_samples: int = sys.maxsize,
) -> dict[str, Any]:
    """The arrays of a file, for :func:`samples_of`; the domain is not needed yet.

    Their keys are ``x, y, values`` (a grid), ``points, values`` (scattered), ``nodes, values`` (blocks), or ``values``
    (2-D) alone. Raises the errors of :func:`read_samples` where the file cannot be read; the arrays themselves are not
    checked.
    """
    suffix = PurePath(filename).suffix.lower().removeprefix(".")
    if suffix in XDMF:
        raise SamplesError(
            f"{filename!r}: samples in XDMF are not read; save the points and the values of u as vtu, npz or csv"
        )
    if suffix not in READERS:
        raise SamplesError(f"{filename!r} is not a file of samples: its suffix must be one of {', '.join(READERS)}")
    if len(data) > max_bytes:
        raise SamplesError(f"{filename!r} has {len(data)} bytes, more than the {max_bytes} allowed")
    if not data.strip():
        raise SamplesError(f"{filename!r} is empty")
    limits = Limits(max_bytes=max_bytes, max_samples=max_samples)
    if column is not None and suffix == "npy":
        raise SamplesError("an npy file has one array: leave the column out")
    arrays = READERS[suffix](data, limits, column)
    limits.check(_count_samples(arrays["values"]))
    return arrays


def samples_of(arrays: Mapping[str, Any], *, box: Box | None = None) -> Samples:
    """u from arrays with the keys of :func:`read_arrays`."""
    if "points" in arrays:
        return ScatteredSamples(points=arrays["points"], values=arrays["values"], box=box)
    if "nodes" in arrays:
        return block_nodes(**arrays)
    if is_nodal(arrays):
        return nodal_samples(**arrays, box=box)
    values = arrays["values"]
    if "x" in arrays:
        return GridSamples(x=arrays["x"], y=arrays["y"], values=values, box=box)
    x, y = (np.linspace(*ends, n) for ends, n in zip(box or UNIT_BOX, values.shape, strict=True))
    return GridSamples(x=x, y=y, values=values, box=box)


def read_npz(data: bytes, *, max_bytes: int = MAX_BYTES, text: str = "") -> dict[str, npt.NDArray[Any]]:
    """All arrays of an npz file, by name; raises as :func:`read_samples`.

    The array named ``text`` may also be one text, as :func:`numpy.savez` writes a ``str`` or ``bytes``.
    """
    with open_zip(data, "npz", max_bytes, "write it with numpy.savez") as members:
        files = {name.removesuffix(".npy"): name for name in members.names}
        return {key: _parse_npy(members.read(name), key[:80], text=key == text) for key, name in files.items()}


def _count_samples(values: Any) -> int:
    """The number of the values of a reader, which json gives as lists."""
    if isinstance(values, np.ndarray):
        return values.size
    return sum(len(row) if isinstance(row, list) else 1 for row in values) if isinstance(values, list) else 1


def _read_npz(data: bytes, limits: Limits, column: str | None) -> dict[str, Any]:
    with open_zip(data, "npz", limits.max_bytes, "write it with numpy.savez") as members:
        files = {name.removesuffix(".npy"): name for name in members.names}
        chosen = _choose(list(files), column)
        for key in chosen.values():
            limits.check(members.size(files[key]), limits.max_npy_bytes)
        return _placed({name: _parse_npy(members.read(files[key]), key) for name, key in chosen.items()})


def _placed(arrays: dict[str, Any]) -> dict[str, Any]:
    """Columns x, y and u as scattered samples or a grid; x and y of numpy.meshgrid with the first index along x."""
    if "x" not in arrays:
        return arrays
    x, y, values = (arrays[key] for key in ("x", "y", "values"))
    if x.ndim == y.ndim == values.ndim == 1 and len(x) == len(y) == len(values):
        return _from_points(np.stack([x, y], axis=1).astype(np.float64), values)
    is_turned = x.ndim == 2 and x.shape == y.shape == values.shape and (x == x[:1]).all() and (y == y[:, :1]).all()
    return {key: array.T for key, array in arrays.items()} if is_turned else arrays


def _read_npy(data: bytes, _: Limits, _column: str | None) -> dict[str, Any]:
    values = _parse_npy(data, "values")
    if values.ndim != 2:
        raise SamplesError(
            f"the npy file has an array of shape {values.shape}: it must be 2-D, u on the uniform grid of the"
            " domain, first index along x; for other grids send an npz with x, y and values",
            field="values",
        )
    return {"values": values}


def _parse_npy(data: bytes, key: str, *, text: bool = False) -> npt.NDArray[Any]:
    """One array of an npy file, or one text; its size is checked before memory is reserved."""
    length = {b"\x01": 2, b"\x02": 4}.get(data[6:7])  # bytes that hold the header's length, by version
    if data[:6] != b"\x93NUMPY" or length is None:
        raise SamplesError(f"{key} is not a plain npy array: write it with numpy.save", field=key)
    start = 8 + length + int.from_bytes(data[8 : 8 + length], "little")
    header = data[8 + length : start].decode("latin-1")
    descr, order, extents = (re.search(NPY_HEADER[name], header) for name in ("descr", "fortran_order", "shape"))
    if descr is None or order is None or extents is None:
        raise SamplesError(f"{key} is not a plain npy array: {header.strip()[:80]!r} describes it", field=key)
    is_text = text and NPY_TEXT.fullmatch(descr[1]) is not None and not extents[1].strip()
    if descr[1] not in NPY_TYPES and not is_text:
        raise SamplesError(f"{key} holds data of type {descr[1]!r}: only real numbers are allowed", field=key)
    sizes = [n.strip() for n in extents[1].split(",") if n.strip()]
    if not all(n.isdecimal() for n in sizes):
        raise SamplesError(f"{key} is not a plain npy array: {header.strip()[:80]!r} describes it", field=key)
    dtype, shape = np.dtype(descr[1]), tuple(map(int, sizes))
    if max(shape, default=0) > len(data) or len(shape) > 3 or math.prod(shape) * dtype.itemsize != len(data) - start:
        raise SamplesError(f"{key} has {len(data) - start} bytes, not those of shape {shape}", field=key)
    return np.frombuffer(data, dtype, offset=start).reshape(shape, order="F" if order[1] == "True" else "C")


def _read_json(data: bytes, limits: Limits, column: str | None) -> dict[str, Any]:
    limits.check(data.count(b",") + 1, limits.max_values)  # at least; without building any of them
    try:
        found = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise SamplesError(f"the json file cannot be read: {str(error)[:200]}") from error
    for kind in ("u", "grid", "nodal", "scattered", "block_nodes"):
        if isinstance(found, dict) and kind in found and not isinstance(found[kind], list):
            found = found[kind]
    if not isinstance(found, dict):
        raise SamplesError(f"the json file must hold an object: {NEEDED}")
    return {name: found[key] for name, key in _choose(list(found), column).items()}


def _read_csv(data: bytes, limits: Limits, column: str | None) -> dict[str, Any]:
    lines = _Lines(data, limits)
    head = next(lines.cells(), None)
    if head is None:
        raise SamplesError("the csv file has no line of samples: it needs the columns x, y, u")
    number, _, cells = head
    order = _columns(cells, number, column)
    if order is None and column == MATRIX:
        return {"values": lines.matrix()}
    chosen = numbered_columns(len(cells), column) if order is None else order
    rows: list[tuple[float, ...]] = []
    for number, text, cells in lines.cells(skip=order is not None):
        if len(cells) <= max(chosen):
            raise SamplesError(f"line {number} of the csv file has {len(cells)} columns: x, y and u are needed")
        rows.append(_finite(number, text, [cells[k] for k in chosen]))
        limits.check(len(rows))
    if not rows:
        raise SamplesError("the csv file has no line of samples: it needs the columns x, y, u")
    table = np.array(rows)
    return _from_points(table[:, :2], table[:, 2])


def _finite(number: int, text: str, cells: list[str]) -> tuple[float, ...]:
    """The numbers of a line."""
    try:
        found = tuple(map(float, cells))
    except ValueError as error:
        comma = "; use a point as decimal mark" if any("," in cell for cell in cells) else ""
        cell = str(error).partition(": ")[2][:200]
        raise SamplesError(f"line {number} of the csv file: {cell} is not a number{comma}") from error
    if not all(map(math.isfinite, found)):
        raise SamplesError(
            f"line {number} of the csv file holds a number that is not finite ({text[:200]}): fill it in or"
            " leave the line out",
            field="values",
        )
    return found


class _Lines:
    """The lines of a table as cells; the first line tells what is between them."""

    def __init__(self, data: bytes, limits: Limits) -> None:
        self.data, self.limits = data, limits

    def cells(self, *, skip: bool = False) -> Iterator[tuple[int, str, list[str]]]:
        """The number, the text and the cells of each line, from the first one or the one behind it."""
        delimiter: str | None = None
        is_first = True
        for number, text in _lines_of(self.data, self.limits):
            if is_first:
                delimiter = next((c for c in ";\t," if c in text), None)  # else white space
            cells = [cell.strip().strip('"') for cell in text.split(delimiter, MAX_COLUMNS)]
            if len(cells) > MAX_COLUMNS:
                raise SamplesError(
                    f"line {number} of the csv file has more than {MAX_COLUMNS} columns: send x, y and u, or a matrix"
                    " as npy"
                )
            if not (is_first and skip):
                yield number, text, cells
            is_first = False

    def matrix(self) -> Array:
        """All numbers, as a matrix of values."""
        rows: list[tuple[float, ...]] = []
        for number, text, cells in self.cells():
            if rows and len(cells) != len(rows[0]):
                raise SamplesError(f"line {number} of the csv file has {len(cells)} values, the first {len(rows[0])}")
            rows.append(_finite(number, text, cells))
            self.limits.check(len(rows) * len(cells))
        return np.array(rows)


def _lines_of(data: bytes, limits: Limits) -> Iterator[tuple[int, str]]:
    """The lines of a csv file that are not empty, without their comments, with their numbers; one after the other."""
    try:
        for number, line in enumerate(io.TextIOWrapper(io.BytesIO(data), "utf-8-sig"), start=1):
            limits.check(number, limits.max_lines)
            text = line.partition("#")[0].strip()
            if text:
                yield number, text
    except UnicodeDecodeError:
        try:
            data.decode("utf-8-sig")  # for the place in the file
        except UnicodeDecodeError as error:
            raise SamplesError(f"the csv file is not UTF-8 text (byte {error.start}): save it as UTF-8") from error


def _columns(cells: list[str], number: int, column: str | None) -> tuple[int, int, int] | None:
    """The columns of x, y and u according to a header; none when the line holds numbers."""
    try:
        for cell in cells:
            float(cell)
    except ValueError:
        found = header_columns(cells, column)
        if found is not None:
            return found
        if any(cell[:1].isalpha() and cell.lower() not in ("nan", "inf", "infinity") for cell in cells):
            raise SamplesError(
                f"line {number} of the csv file is a header {', '.join(cells)[:60]!r}: name the columns x, y and u"
            ) from None
    return None


def _read_vtu(data: bytes, limits: Limits, column: str | None) -> dict[str, Any]:
    return _from_cloud(*read_vtu(data, limits), column)


def _read_vtk(data: bytes, limits: Limits, column: str | None) -> dict[str, Any]:
    return _from_cloud(*read_legacy_vtk(data, limits), column)


def _from_cloud(points: Array, fields: dict[str, Array], column: str | None) -> dict[str, Any]:
    if not fields:
        raise SamplesError("the file has no scalar point data: add the values of u at the points", field="values")
    return _from_points(points[:, :2], fields[choose(sorted(fields), column, ("the points",), "scalar point data")])


def _from_points(points: Array, values: Array) -> dict[str, Any]:
    """A grid when the points fill one, each place once; else scattered samples."""
    (x, i), (y, j) = (np.unique(column, return_inverse=True) for column in points.T)
    scattered = {"points": points, "values": values}
    if min(x.size, y.size) < 2 or x.size * y.size != len(values) or not np.all(np.isfinite(points)):
        return scattered
    table = np.full((x.size, y.size), np.nan)
    taken = np.zeros(table.shape, dtype=bool)
    table[i, j], taken[i, j] = values, True
    return {"x": x, "y": y, "values": table} if taken.all() else scattered


def _choose(found: list[str], column: str | None) -> dict[str, str]:
    """The keys to read, by the names of :func:`read_arrays`."""
    for places in PLACES:
        others = [key for key in found if key not in places and key != OF_BLOCKS]
        if not set(places) <= set(found) or not others:
            continue
        u = "values" if "values" in others and column is None else choose(others, column, places, "array")
        counts = {OF_BLOCKS: OF_BLOCKS} if places == ("nodes",) and OF_BLOCKS in found else {}
        return {**{key: key for key in places}, "values": u, **counts}
    raise SamplesError(f"the file holds {', '.join(map(repr, sorted(found)[:10])) or 'nothing'}: {NEEDED}")


READERS: Final[dict[str, Callable[[bytes, Limits, str | None], dict[str, Any]]]] = {
    "npz": _read_npz,
    "npy": _read_npy,
    "csv": _read_csv,
    "txt": _read_csv,
    "json": _read_json,
    "vtu": _read_vtu,
    "vtk": _read_vtk,
}
