"""Structured grids of VTK in parts: a ``.vts`` file for every part, and a ``.pvts`` head.

VTK's index i runs along xi and j along eta, as in the format ``vts`` of a whole mesh. i runs fastest in VTK, and eta in
our arrays, so a part is written in blocks of columns. Neighbouring parts share the row of nodes between them.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
import numpy.typing as npt

from equimesh.io.by_parts.contents import NodeValues, PartData, blocks, cell_arrays, cell_type, node_block
from equimesh.io.by_parts.formats import PARTED_FORMATS
from equimesh.io.by_parts.layout import PartedGrid, part_reference
from equimesh.io.by_parts.vtk_raw import Blocks, RawArray, described, head_text, write_raw
from equimesh.meshes.grid import Grid
from equimesh.meshes.mesh_part import MeshPart
from equimesh.numerics.types import Array


def write_part(path: Path, part: MeshPart, data: PartData) -> None:
    """Write the nodes and cells of ``part`` as a ``.vts`` file."""
    nodes = [
        RawArray(name=name, dtype=np.float64, count=part.x.size, blocks=_node_columns(part, values))
        for name, values in data.nodes.items()
    ]
    cells = [
        RawArray(name=name, dtype=cell_type(name), count=values.size, blocks=_columns(values))
        for name, values in cell_arrays(data, part).items()
    ]
    points = RawArray(name="Points", dtype=np.float64, count=3 * part.x.size, components=3, blocks=_points(part))
    write_raw(
        path,
        "StructuredGrid",
        f' WholeExtent="{_whole(part.grid)}"',
        f'Extent="{_extent(part.first, part.first + part.x.shape[0], part.grid)}"',
        {"Points": [points], "PointData": nodes, "CellData": cells},
    )


def head_of(path: Path, parted: PartedGrid, nodes: Sequence[str], cells: Sequence[str]) -> str:
    """The text of the ``.pvts`` head with this path."""
    kind, grid = PARTED_FORMATS["pvts"], parted.grid
    pieces = (
        f'<Piece Extent="{_extent(first, min(last + 1, grid.n_xi), grid)}"'
        f" Source={quoteattr(part_reference(path, number, kind))}/>"
        for number, (first, last) in enumerate(parted.ends)
    )
    sections = {
        "PPointData": [described(name, np.float64) for name in nodes],
        "PCellData": [described(name, cell_type(name)) for name in (*cells, "subdomain")],
        "PPoints": [described("Points", np.float64, 3)],
    }
    return head_text("PStructuredGrid", f' WholeExtent="{_whole(grid)}"', sections, pieces)


def _whole(grid: Grid) -> str:
    return _extent(0, grid.n_xi, grid)


def _extent(first: int, end: int, grid: Grid) -> str:
    return f"{first} {end - 1} 0 {grid.n_eta - 1} 0 0"


def _points(part: MeshPart) -> Blocks:
    def found() -> Iterator[Array]:
        rows, columns = part.x.shape
        for block in blocks(columns, rows):
            points = np.zeros((block.stop - block.start, rows, 3))
            points[:, :, 0], points[:, :, 1] = part.x[:, block].T, part.y[:, block].T
            yield points

    return found


def _node_columns(part: MeshPart, values: NodeValues) -> Blocks:
    def found() -> Iterator[Array]:
        rows, columns = part.x.shape
        return (node_block(values, part, slice(None), block).T for block in blocks(columns, rows))

    return found


def _columns(values: npt.NDArray[Any]) -> Blocks:
    rows, columns = values.shape
    return lambda: (values[:, block].T for block in blocks(columns, rows))
