"""Unstructured grids of VTK in parts: a ``.vtu`` file for every part, and a ``.pvtu`` head.

Nodes and cells are in our order. Neighbouring parts share the row of nodes between them; the point data
``GlobalNodeIds`` are the numbers of the nodes in the whole mesh, by which a program can join them.
"""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
import numpy.typing as npt

from equimesh.io.by_parts.contents import NodeValues, PartData, blocks, cell_arrays, cell_type, node_block, side_digits
from equimesh.io.by_parts.formats import PARTED_FORMATS
from equimesh.io.by_parts.layout import PartedGrid, part_reference
from equimesh.io.by_parts.vtk_raw import GLOBAL_IDS, Blocks, RawArray, described, head_text, write_raw
from equimesh.io.vtu import CELL_TYPES
from equimesh.meshes.mesh_part import MeshPart

# VTK's number of a quadrilateral.
QUADRILATERAL = CELL_TYPES[4]
# The field data of a part: n_xi and n_eta of the whole mesh, and the first row of the part.
ROWS = "equimesh_rows"


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
        "UnstructuredGrid",
        "",
        f'NumberOfPoints="{part.x.size}" NumberOfCells="{count}"',
        {"Points": [points], "Cells": table, "PointData": nodes, "CellData": cells},
        extra=f'<FieldData><DataArray type="Int64" Name="{ROWS}" NumberOfTuples="3" format="ascii">{where}</DataArray>'
        "</FieldData>\n",
    )


def head_of(path: Path, parted: PartedGrid, nodes: Sequence[str], cells: Sequence[str]) -> str:
    """The text of the ``.pvtu`` head with this path."""
    kind = PARTED_FORMATS["pvtu"]
    pieces = (f"<Piece Source={quoteattr(part_reference(path, number, kind))}/>" for number in range(parted.count))
    at_nodes = [described(name, np.float64) for name in nodes]
    sections = {
        "PPointData": [*at_nodes, described("node_groups", np.uint8), described(GLOBAL_IDS, np.int64)],
        "PCellData": [described(name, cell_type(name)) for name in (*cells, "subdomain")],
        "PPoints": [described("Points", np.float64, 3)],
    }
    return head_text("PUnstructuredGrid", "", sections, pieces)


def corners(first: int, last: int, columns: int, dtype: npt.DTypeLike) -> npt.NDArray[Any]:
    """The nodes of the cells in the cell rows ``first`` to ``last - 1``, counter-clockwise, shape ``(k, 4)``."""
    start = np.arange(first, last, dtype=dtype)[:, None] * columns + np.arange(columns - 1, dtype=dtype)
    table = np.empty((*start.shape, 4), dtype=dtype)
    for corner, step in enumerate((0, columns, columns + 1, 1)):
        np.add(start, step, out=table[:, :, corner])
    return table.reshape(-1, 4)


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
    return lambda: (np.full(some.stop - some.start, QUADRILATERAL, dtype=np.uint8) for some in blocks(count, 1))
