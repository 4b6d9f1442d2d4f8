"""VTKHDF files in parts: a ``.hdf`` file for every part, and a ``.vtkhdf`` head of virtual datasets.

The head is one unstructured grid, version 1.0 of the format. No node is in two files: the cells between two parts refer
to nodes of both, by their numbers in the whole mesh.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from equimesh.io.vtk import CELL_TYPES, HDF_VERSION
from equimesh.io.vtk import HDF_GROUP as ROOT
from equimesh.meshes.mesh import Grid
from equimesh_cluster.mesh_part import MeshPart
from equimesh_cluster.part_files.formats import (
    PARTED_FORMATS,
    ROWS,
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

# The format of the files. What HDF5 writes as "latest" has a heap that the HDF5 library of VTK refuses.
LIBRARY = ("v110", "v110")


@dataclass(frozen=True, kw_only=True)
class Source:
    """Rows of a dataset in the file ``file``, named relative to the head; they become ``first`` to ``last - 1``."""

    file: str
    first: int
    last: int


def write_part(path: Path, part: MeshPart, data: PartData) -> None:
    """Write the own nodes of ``part`` and its cells, by numbers of the whole mesh."""
    own, columns = part.last - part.first, part.grid.n_eta
    with create(path) as file:
        root = file.create_group(ROOT)
        points = root.create_dataset("Points", (own * columns, 3), np.float64)
        sides = root.create_dataset("PointData/node_groups", (own * columns,), np.uint8)
        arrays = {name: root.create_dataset(f"PointData/{name}", (own * columns,), np.float64) for name in data.nodes}
        for rows in blocks(own, columns):
            flat = slice(rows.start * columns, rows.stop * columns)
            block = np.zeros((rows.stop - rows.start, columns, 3))
            block[:, :, 0], block[:, :, 1] = part.x[rows], part.y[rows]
            points[flat] = block.reshape(-1, 3)
            sides[flat] = side_digits(part, rows).ravel()
            for name, values in data.nodes.items():
                arrays[name][flat] = node_block(values, part, rows).ravel()
        _write_cells(root, part, data)


def _write_cells(root: h5py.Group, part: MeshPart, data: PartData) -> None:
    rows, columns = part.x.shape[0] - 1, part.grid.n_eta - 1
    count, first = rows * columns, part.first * columns
    table = root.create_dataset("Connectivity", (4 * count,), np.int64)
    ends = root.create_dataset("Offsets", (count,), np.int64)
    root.create_dataset("Types", data=np.full(count, CELL_TYPES[4], dtype=np.uint8))
    for block in blocks(rows, 4 * columns):
        a, b = block.start * columns, block.stop * columns
        nodes = corners(part.first + block.start, part.first + block.stop, columns + 1, np.int64)
        table[4 * a : 4 * b] = nodes.ravel()
        ends[a:b] = 4 * np.arange(first + a + 1, first + b + 1, dtype=np.int64)
    for name, values in cell_arrays(data, part).items():
        dataset = root.create_dataset(f"CellData/{name}", (count,), cell_type(name))
        for block in blocks(rows, columns):
            dataset[block.start * columns : block.stop * columns] = values[block].ravel()


def write_head(path: Path, head: Path, parted: PartedGrid, nodes: Sequence[str], cells: Sequence[str]) -> None:
    """Write the virtual datasets of the head ``head`` to ``path``."""
    grid, kind = parted.grid, PARTED_FORMATS["vtkhdf"]
    files = [part_reference(head, number, kind) for number in range(parted.count)]
    at_nodes = [_source(file, *ends, grid.n_eta) for file, ends in zip(files, parted.ends, strict=True)]
    rows = [parted.cell_rows(number) for number in range(parted.count)]
    in_cells = [_source(file, *ends, grid.n_eta - 1) for file, ends in zip(files, rows, strict=True)]
    in_corners = [_source(file, *ends, 4 * (grid.n_eta - 1)) for file, ends in zip(files, rows, strict=True)]
    after_zero = [_source(file, *ends, grid.n_eta - 1, shift=1) for file, ends in zip(files, rows, strict=True)]
    with create(path) as file:
        root = file.create_group(ROOT)
        root.attrs["Version"] = np.array(HDF_VERSION, dtype=np.int64)
        root.attrs.create("Type", np.bytes_("UnstructuredGrid"))
        counts = {"Points": grid.points, "Cells": grid.cells, "ConnectivityIds": 4 * grid.cells}
        for name, number in counts.items():
            root[f"NumberOf{name}"] = np.array([number], dtype=np.int64)
        add_virtual(file, f"{ROOT}/Points", (grid.points, 3), np.float64, at_nodes)
        add_virtual(file, f"{ROOT}/Connectivity", (4 * grid.cells,), np.int64, in_corners)
        add_virtual(file, f"{ROOT}/Offsets", (grid.cells + 1,), np.int64, after_zero)
        add_virtual(file, f"{ROOT}/Types", (grid.cells,), np.uint8, in_cells)
        for name in (*nodes, "node_groups"):
            dtype = np.uint8 if name == "node_groups" else np.float64
            add_virtual(file, f"{ROOT}/PointData/{name}", (grid.points,), dtype, at_nodes)
        for name in (*cells, "subdomain"):
            add_virtual(file, f"{ROOT}/CellData/{name}", (grid.cells,), cell_type(name), in_cells)
        root[f"FieldData/{ROWS}"] = np.array([grid.n_xi, grid.n_eta, *parted.cuts], dtype=np.int64)


def _source(file: str, first: int, last: int, width: int, *, shift: int = 0) -> Source:
    return Source(file=file, first=first * width + shift, last=last * width + shift)


def add_virtual(
    file: h5py.File, name: str, shape: tuple[int, ...], dtype: npt.DTypeLike, sources: Sequence[Source]
) -> None:
    """Add the dataset ``name`` of the sources, which all have it by the same name, and nothing else in its rows.

    Where a file is missing, numbers are NaN, and whole numbers 0.
    """
    layout = h5py.VirtualLayout(shape=shape, dtype=dtype)
    for source in sources:
        rows = source.last - source.first
        if rows:
            layout[source.first : source.last] = h5py.VirtualSource(
                source.file, name, shape=(rows, *shape[1:]), dtype=dtype
            )
    file.create_virtual_dataset(name, layout, fillvalue=np.nan if np.dtype(dtype).kind == "f" else 0)


def create(path: Path) -> h5py.File:
    """A new HDF5 file that old libraries can read."""
    return h5py.File(path, "w", libver=LIBRARY)


@dataclass(frozen=True, kw_only=True)
class FlatDatasets:
    """The datasets of a VTKHDF head, in which the nodes and cells of all rows follow each other."""

    path: Path
    parted: PartedGrid
    nodes: tuple[str, ...]
    cells: tuple[str, ...]

    @classmethod
    def of(cls, path: Path) -> "FlatDatasets":
        """The flat datasets of the file."""
        with h5py.File(path, "r") as file:
            root = file[ROOT]
            n_xi, n_eta, *cuts = root[f"FieldData/{ROWS}"][:].tolist()
            return cls(
                path=path,
                parted=PartedGrid.of(Grid(n_xi=n_xi, n_eta=n_eta), cuts),
                nodes=tuple(name for name in root["PointData"] if name != "node_groups"),
                cells=tuple(root["CellData"]),
            )

    def rows(self, name: str, first: int, last: int) -> npt.NDArray[Any]:
        """Some rows of an array."""
        in_cells = name in self.cells
        width = self.parted.grid.n_eta - in_cells
        flat = slice(first * width, last * width)
        with h5py.File(self.path, "r") as file:
            root = file[ROOT]
            if name in ("x", "y"):
                values = root["Points"][flat][:, "xy".index(name)]  # HDF5 takes columns one number at a time
            else:
                values = root["CellData" if in_cells else "PointData"][name][flat]
        return np.asarray(values).reshape(-1, width)
