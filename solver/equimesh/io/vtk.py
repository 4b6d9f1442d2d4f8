"""Files of VTK: unstructured grids in XML and HDF5, structured grids, and heads of several blocks."""

from __future__ import annotations

import binascii
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, BinaryIO, Final, TypeAlias
from xml.sax.saxutils import quoteattr

import numpy as np
import numpy.typing as npt

from equimesh.numerics.compiled import compiled

# VTK XML files of unstructured grids, their arrays as base64 within the text.
#
# Written piece by piece, so that a file of any size takes little memory.

Array: TypeAlias = npt.NDArray[Any]
Bytes: TypeAlias = npt.NDArray[np.uint8]
Pairs: TypeAlias = npt.NDArray[np.uint16]

# VTK's numbers of triangles and quadrilaterals, by their nodes: linear ones, and those of second order.
CELL_TYPES: Final = {3: 5, 4: 9, 6: 22, 9: 28}
NUMBERS: Final = {"f": "Float", "i": "Int", "u": "UInt"}
NO_FIELD_DATA: Final[Mapping[str, Array]] = MappingProxyType({})
PIECE: Final = 3 << 16  # bytes encoded at a time; three become four characters
_LETTERS = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/"
_PAIRS: Final = np.frombuffer(b"".join(bytes((a, b)) for a in _LETTERS for b in _LETTERS), np.uint16)


def write_vtu(
    path: str | os.PathLike[str],
    points: npt.NDArray[np.float64],
    cells: npt.NDArray[np.int64],
    *,
    point_data: Mapping[str, Array],
    cell_data: Mapping[str, Array],
    field_data: Mapping[str, Array] = NO_FIELD_DATA,
) -> None:
    """Write ``points`` of shape ``(n, 2)``, in the plane z = 0, and ``cells`` with their data.

    ``cells`` have 3 or 4 nodes, or 6 or 9 of second order: first the corners, then the middles of the edges, then the
    centre.

    Data are flat arrays of numbers, by name; ``field_data`` are arrays of any length. Raises ``OSError`` where the
    file cannot be written.
    """
    index = np.int32 if cells.size <= np.iinfo(np.int32).max else np.int64
    count, corners = cells.shape
    with open(path, "wb") as file:
        file.write(f"{head('UnstructuredGrid')}<UnstructuredGrid>\n".encode())
        if field_data:
            write_section(file, "FieldData", field_data, tuples=True)
        file.write(f'<Piece NumberOfPoints="{len(points)}" NumberOfCells="{count}">\n'.encode())
        write_section(file, "Points", {"Points": in_space(points)})
        offsets = np.arange(corners, cells.size + 1, corners, dtype=index)
        types = np.full(count, CELL_TYPES[corners], dtype=np.uint8)
        write_section(
            file, "Cells", {"connectivity": cells.astype(index).reshape(-1), "offsets": offsets, "types": types}
        )
        write_section(file, "PointData", point_data)
        write_section(file, "CellData", cell_data)
        file.write(b"</Piece>\n</UnstructuredGrid>\n</VTKFile>\n")


def head(kind: str) -> str:
    """The first two lines of a VTK XML file."""
    order = "LittleEndian" if sys.byteorder == "little" else "BigEndian"
    return f'<?xml version="1.0"?>\n<VTKFile type="{kind}" version="1.0" byte_order="{order}" header_type="UInt64">\n'


def in_space(points: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """The points with z = 0; ``np.pad`` takes three times as long."""
    result = np.zeros((len(points), 3))
    result[:, 0], result[:, 1] = points[:, 0], points[:, 1]
    return result


def write_section(file: BinaryIO, name: str, arrays: Mapping[str, Array], *, tuples: bool = False) -> None:
    """Write arrays, flat or with one column for each component, as the section ``name`` of a file.

    With ``tuples`` each array says how many rows it has, which field data must.
    """
    file.write(f"<{name}>\n".encode())
    for label, values in arrays.items():
        kind = f"{NUMBERS[values.dtype.kind]}{8 * values.itemsize}"
        components = f' NumberOfComponents="{values.shape[1]}"' if values.ndim == 2 else ""
        rows = f' NumberOfTuples="{len(values)}"' if tuples else ""
        file.write(f'<DataArray type="{kind}" Name={quoteattr(label)}{components}{rows} format="binary">'.encode())
        native = np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("="))
        _encode_bytes(file, native.reshape(-1).view(np.uint8))
        file.write(b"</DataArray>\n")
    file.write(f"</{name}>\n".encode())


def _encode_bytes(file: BinaryIO, data: Bytes) -> None:
    """Write the number of bytes and the bytes, as one base64 text."""
    head = np.frombuffer(np.uint64(data.size).tobytes(), np.uint8)
    text = np.empty(min(PIECE, head.size + data.size) // 3 * 2, np.uint16)
    start = -head.size
    while start < data.size:
        piece = data[max(start, 0) : start + PIECE]
        if start < 0:
            piece = np.concatenate([head, piece])
        whole = piece.size // 3
        encode(piece, _PAIRS, text)
        file.write(text[: 2 * whole].data)
        file.write(binascii.b2a_base64(piece[3 * whole :].tobytes(), newline=False))
        start += PIECE


@compiled
def encode(data: Bytes, pairs: Pairs, text: Pairs) -> None:
    """The base64 text of all whole triples of ``data``, by ``pairs``: the two characters of every 12 bits."""
    for k in range(data.size // 3):
        a, b, c = data[3 * k], data[3 * k + 1], data[3 * k + 2]
        text[2 * k] = pairs[(a << 4) | (b >> 4)]
        text[2 * k + 1] = pairs[((b & 15) << 8) | c]


# VTK XML files of structured grids: the nodes in rows, without a list of cells.


def write_vts(
    path: str | os.PathLike[str],
    x: npt.NDArray[np.float64],
    y: npt.NDArray[np.float64],
    *,
    point_data: Mapping[str, Array],
    cell_data: Mapping[str, Array],
) -> None:
    """Write the nodes ``x``, ``y`` of shape ``(n_xi, n_eta)``, in the plane z = 0, with their data.

    ``point_data`` have the shape of ``x``, ``cell_data`` one less in both directions, and three components may follow.
    VTK's index i runs along xi, its j along eta: left is i = 0, right the last i, bottom j = 0, top the last j. In VTK
    i runs fastest, so node ``(i, j)`` is the point ``i + n_xi j`` of the file. Raises ``OSError`` where the file
    cannot be written.
    """
    extent = f"0 {x.shape[0] - 1} 0 {x.shape[1] - 1} 0 0"
    points = in_space(np.column_stack([_in_rows(x), _in_rows(y)]))
    with open(path, "wb") as file:
        file.write(f'{head("StructuredGrid")}<StructuredGrid WholeExtent="{extent}">\n'.encode())
        file.write(f'<Piece Extent="{extent}">\n'.encode())
        write_section(file, "Points", {"Points": points})
        write_section(file, "PointData", {name: _in_rows(values) for name, values in point_data.items()})
        write_section(file, "CellData", {name: _in_rows(values) for name, values in cell_data.items()})
        file.write(b"</Piece>\n</StructuredGrid>\n</VTKFile>\n")


def _in_rows(values: Array) -> Array:
    """The values with the index along xi fastest."""
    return np.ascontiguousarray(values.swapaxes(0, 1)).reshape(-1, *values.shape[2:])


def vtm_text(blocks: Sequence[tuple[str, str]]) -> str:
    """The head: each block has a name, and the name of a ``vts`` file in the same folder."""
    rows = [
        f"  <DataSet index={quoteattr(str(number))} name={quoteattr(name)} file={quoteattr(file)}/>"
        for number, (name, file) in enumerate(blocks)
    ]
    lines = ['<?xml version="1.0"?>', '<VTKFile type="vtkMultiBlockDataSet" version="1.0">', "<vtkMultiBlockDataSet>"]
    return "\n".join([*lines, *rows, "</vtkMultiBlockDataSet>", "</VTKFile>"]) + "\n"


# VTKHDF files of unstructured grids.

HDF_GROUP: Final = "VTKHDF"
"""The group of all data."""
HDF_VERSION: Final = (1, 0)


def write_hdf(
    path: str | os.PathLike[str],
    points: npt.NDArray[np.float64],
    cells: npt.NDArray[np.int64],
    *,
    point_data: Mapping[str, Array],
    cell_data: Mapping[str, Array],
) -> None:
    """Write an unstructured grid, whose arguments are those of :func:`write_vtu`, as VTKHDF 1.0."""
    import h5py

    count, nodes = cells.shape
    datasets = {
        "NumberOfPoints": np.array([len(points)]),
        "NumberOfCells": np.array([count]),
        "NumberOfConnectivityIds": np.array([cells.size]),
        "Points": in_space(points),
        "Connectivity": cells.astype(np.int64).reshape(-1),
        "Offsets": np.arange(0, cells.size + 1, nodes, dtype=np.int64),
        "Types": np.full(count, CELL_TYPES[nodes], dtype=np.uint8),
        **{f"PointData/{name}": values for name, values in point_data.items()},
        **{f"CellData/{name}": values for name, values in cell_data.items()},
    }
    # In memory first, as HDF5 ends the process where the disk is full. Newer formats hold the time of writing.
    with h5py.File(path, "w", libver="earliest", driver="core", backing_store=False) as file:
        root = file.create_group(HDF_GROUP)
        root.attrs["Version"] = np.array(HDF_VERSION, dtype=np.int64)
        root.attrs.create("Type", np.bytes_("UnstructuredGrid"))
        for name, values in datasets.items():
            root[name] = values
        file.flush()
        Path(path).write_bytes(file.id.get_file_image())
