"""VTK XML files of structured grids: the nodes in rows, without a list of cells."""

import os
from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from equimesh.io.vtu import head, in_space, write_section

Array: TypeAlias = npt.NDArray[Any]


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
