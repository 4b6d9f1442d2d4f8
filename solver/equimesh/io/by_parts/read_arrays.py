"""Rows of meshes in parts in HDF5 and zarr. Files are open only while something is read."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from equimesh.io.by_parts.layout import PartedGrid
from equimesh.io.by_parts.pvtu import ROWS
from equimesh.io.by_parts.vtkhdf import ROOT
from equimesh.io.by_parts.zarr_parts import import_zarr
from equimesh.meshes.grid import Grid


@dataclass(frozen=True, kw_only=True)
class Datasets:
    """The datasets of the ``.h5`` file next to an XDMF head."""

    path: Path
    parted: PartedGrid
    nodes: tuple[str, ...]
    cells: tuple[str, ...]

    @classmethod
    def of(cls, path: Path) -> "Datasets":
        """The datasets of the file."""
        with h5py.File(path, "r") as file:
            n_xi, n_eta = file["x"].shape
            return cls(
                path=path,
                parted=PartedGrid.of(Grid(n_xi=n_xi, n_eta=n_eta), file.attrs["cuts"].tolist()),
                nodes=tuple(file.attrs["nodes"]),
                cells=tuple(file.attrs["cells"]),
            )

    def rows(self, name: str, first: int, last: int) -> npt.NDArray[Any]:
        """Some rows of an array."""
        with h5py.File(self.path, "r") as file:
            return np.asarray(file[name][first:last])


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


@dataclass(frozen=True, kw_only=True)
class Chunks:
    """The arrays of a zarr group."""

    path: Path
    parted: PartedGrid
    nodes: tuple[str, ...]
    cells: tuple[str, ...]

    @classmethod
    def of(cls, path: Path) -> "Chunks":
        """The chunks of the group in this folder."""
        group = import_zarr().open_group(path, mode="r")
        n_xi, n_eta = group["x"].shape
        return cls(
            path=path,
            parted=PartedGrid.of(Grid(n_xi=n_xi, n_eta=n_eta), group.attrs["cuts"]),
            nodes=tuple(group.attrs["nodes"]),
            cells=tuple(group.attrs["cells"]),
        )

    def rows(self, name: str, first: int, last: int) -> npt.NDArray[Any]:
        """Some rows of an array."""
        return np.asarray(import_zarr().open_array(self.path / name, mode="r")[first:last])
