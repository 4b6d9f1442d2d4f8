"""Samples from an uploaded file: npz, npy, csv, json, vtu, vtk or xdmf."""

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
from equimesh.io.zip_members import open_zip
from equimesh.numerics.types import Array
from equimesh.upload.limits import MAX_COLUMNS, Limits
from equimesh.upload.nodal import BlockNodes, block_nodes, is_nodal, nodal_samples
from equimesh.upload.vtk import read_legacy_vtk, read_vtu
from equimesh.upload.xdmf import read_xdmf

Samples: TypeAlias = GridSamples | ScatteredSamples | NodalField | BlockNodes

MAX_BYTES: Final = 256 * 2**20
GRID_KEYS = ("x", "y", "values")
SCATTERED_KEYS = ("points", "values")
BLOCK_KEYS = ("nodes", "values")
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
NEEDED = "give x, y and values (a grid), points and values (scattered samples), or nodes and values (a mesh of blocks)"


def read_samples(
    data: bytes, filename: str, *, max_bytes: int = MAX_BYTES, max_samples: int = sys.maxsize, box: Box | None = None
) -> Samples:
    """u from the contents ``data`` of a file; the suffix of ``filename`` determines the format.

    The samples must cover ``box = ((x0, x1), (y0, y1))``, that of the domain: the unit square unless given.

    ========= ==========================================================================================
    npz       arrays ``x``, ``y``, ``values`` (grid; nodes of a mesh where all are 2-D) or ``points``, ``values``;
              ``nodes``, ``values`` at the nodes of a mesh of blocks, in its order
    npy       ``values`` alone, 2-D: u on the uniform grid of the box, first index along x
    csv       rows ``x, y, u``; a header naming them may change their order, ``#`` starts a comment
    json      ``{"grid": {...}}``, ``nodal``, ``scattered`` or ``block_nodes`` with the keys of the npz, or these alone
    vtu, vtk  the first two coordinates of the points, and the point data ``u``, or the only one there is
    xdmf, zip the same: a zip of ``.xdmf`` and ``.h5``, or ``.xdmf`` alone with its numbers as text
    ========= ==========================================================================================

    The points of a csv, vtu, vtk or xdmf file that fill a rectilinear grid become :class:`GridSamples`, others
    :class:`ScatteredSamples`. Nothing is ever unpickled, and arrays of more than ``max_bytes`` are not
    unpacked. Reading stops after ``max_samples``. Raises :class:`~equimesh.errors.SamplesError`, whose message names
    the remedy.
    """
    return samples_of(read_arrays(data, filename, max_bytes=max_bytes, max_samples=max_samples), box=box)


def read_arrays(
    data: bytes, filename: str, *, max_bytes: int = MAX_BYTES, max_samples: int = sys.maxsize
) -> dict[str, Any]:
    """The arrays of a file, for :func:`samples_of`; the domain is not needed yet.

    Their keys are ``x, y, values`` (a grid), ``points, values`` (scattered), ``nodes, values`` (blocks), or ``values``
    (2-D) alone. Raises the errors of :func:`read_samples` where the file cannot be read; the arrays themselves are not
    checked.
    """
    suffix = PurePath(filename).suffix.lower().removeprefix(".")
    if suffix not in READERS:
        raise SamplesError(f"{filename!r} is not a file of samples: its suffix must be one of {', '.join(READERS)}")
    if len(data) > max_bytes:
        raise SamplesError(f"{filename!r} has {len(data)} bytes, more than the {max_bytes} allowed")
    if not data.strip():
        raise SamplesError(f"{filename!r} is empty")
    limits = Limits(max_bytes=max_bytes, max_samples=max_samples)
    arrays = READERS[suffix](data, limits)
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


def _read_npz(data: bytes, limits: Limits) -> dict[str, Any]:
    with open_zip(data, "npz", limits.max_bytes, "write it with numpy.savez") as members:
        files = {name.removesuffix(".npy"): name for name in members.names}
        chosen = _choose(list(files))
        for key in chosen:
            limits.check(members.size(files[key]), limits.max_npy_bytes)
        return {key: _parse_npy(members.read(files[key]), key) for key in chosen}


def _read_npy(data: bytes, _: Limits) -> dict[str, Any]:
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


def _read_json(data: bytes, limits: Limits) -> dict[str, Any]:
    limits.check(data.count(b",") + 1, limits.max_values)  # at least; without building any of them
    try:
        found = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise SamplesError(f"the json file cannot be read: {str(error)[:200]}") from error
    for kind in ("u", "grid", "nodal", "scattered", "block_nodes"):
        if isinstance(found, dict) and kind in found:
            found = found[kind]
    if not isinstance(found, dict):
        raise SamplesError(f"the json file must hold an object: {NEEDED}")
    return {key: found[key] for key in _choose(list(found))}


def _read_csv(data: bytes, limits: Limits) -> dict[str, Any]:
    order: list[int] | None = None
    rows: list[tuple[float, float, float]] = []
    delimiter: str | None = None
    for number, text in _lines_of(data, limits):
        if not rows and order is None:
            delimiter = next((c for c in ";\t," if c in text), None)  # else white space
        cells = [cell.strip().strip('"') for cell in text.split(delimiter, MAX_COLUMNS)]
        if len(cells) > MAX_COLUMNS:
            raise SamplesError(f"line {number} of the csv file has more than {MAX_COLUMNS} columns: send x, y and u")
        if order is None:
            order = _columns(cells, number)
            if order is not None:
                continue
            order = [0, 1, 2]
        if len(cells) <= max(order):
            raise SamplesError(f"line {number} of the csv file has {len(cells)} columns: x, y and u are needed")
        try:
            x, y, u = (float(cells[i]) for i in order)
        except ValueError as error:
            comma = "; use a point as decimal mark" if any("," in cell for cell in cells) else ""
            cell = str(error).partition(": ")[2][:200]
            raise SamplesError(f"line {number} of the csv file: {cell} is not a number{comma}") from error
        if not (math.isfinite(x) and math.isfinite(y) and math.isfinite(u)):
            raise SamplesError(
                f"line {number} of the csv file holds a number that is not finite ({text}): fill it in or"
                " leave the line out",
                field="values",
            )
        rows.append((x, y, u))
        limits.check(len(rows))
    if not rows:
        raise SamplesError("the csv file has no line of samples: it needs the columns x, y, u")
    table = np.array(rows)
    return _from_points(table[:, :2], table[:, 2])


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


def _columns(cells: list[str], number: int) -> list[int] | None:
    """The columns of x, y and u according to a header; none when the line holds numbers."""
    try:
        for cell in cells:
            float(cell)
    except ValueError:
        names = [cell.lower() for cell in cells]
        if {"x", "y"} <= set(names):
            value = next((name for name in ("u", "value", "values") if name in names), None)
            others = [i for i, name in enumerate(names) if name not in ("x", "y")]
            if value is not None or len(others) == 1:
                return [names.index("x"), names.index("y"), names.index(value) if value else others[0]]
        if any(cell[:1].isalpha() and cell.lower() not in ("nan", "inf", "infinity") for cell in cells):
            raise SamplesError(
                f"line {number} of the csv file is a header {', '.join(cells)[:60]!r}: name the columns x, y and u"
            ) from None
    return None


def _read_vtu(data: bytes, limits: Limits) -> dict[str, Any]:
    return _from_cloud(*read_vtu(data, limits))


def _read_vtk(data: bytes, limits: Limits) -> dict[str, Any]:
    return _from_cloud(*read_legacy_vtk(data, limits))


def _read_xdmf(data: bytes, limits: Limits) -> dict[str, Any]:
    return _from_cloud(*read_xdmf(data, limits))


def _from_cloud(points: Array, fields: dict[str, Array]) -> dict[str, Any]:
    if "u" not in fields and len(fields) != 1:
        found = ", ".join(sorted(fields)) or "none"
        raise SamplesError(f"the file must have scalar point data named u (it has: {found})", field="values")
    values = fields["u"] if "u" in fields else next(iter(fields.values()))
    return _from_points(points[:, :2], values)


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


def _choose(found: list[str]) -> tuple[str, ...]:
    """The keys to read."""
    for keys in (GRID_KEYS, SCATTERED_KEYS, BLOCK_KEYS):
        if set(keys) <= set(found):
            return keys
    raise SamplesError(f"the file holds {', '.join(map(repr, sorted(found)[:10])) or 'nothing'}: {NEEDED}")


READERS: Final[dict[str, Callable[[bytes, Limits], dict[str, Any]]]] = {
    "npz": _read_npz,
    "npy": _read_npy,
    "csv": _read_csv,
    "json": _read_json,
    "vtu": _read_vtu,
    "vtk": _read_vtk,
    "xdmf": _read_xdmf,
    "zip": _read_xdmf,
}
