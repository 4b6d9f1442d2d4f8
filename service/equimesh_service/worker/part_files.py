"""The files of a mesh in parts: written where the parts are, read back for other formats."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from equimesh import Field, Grid
from equimesh.numerics.types import Array
from equimesh_cluster.mesh_part import MeshPart
from equimesh_cluster.part_files.formats import NodeValues, PartData
from equimesh_cluster.part_files.parted_mesh import write_head, write_part
from equimesh_cluster.part_files.pvtu import Piece
from equimesh_service.worker.part_formats import PART_FORMATS


@dataclass(frozen=True, kw_only=True)
class PartsLayout:
    """The parts of a mesh: their first rows, the name in the files, and the names of arrays at nodes."""

    name: str
    grid: Grid
    firsts: tuple[int, ...]
    nodes: tuple[str, ...]

    @classmethod
    def of(cls, parts: Mapping[str, Any], grid: Grid) -> PartsLayout:
        """The layout that the result of a mesh describes, as :meth:`record` does."""
        firsts = tuple(int(first) for first, _ in parts["rows"])
        return cls(name=str(parts["name"]), grid=grid, firsts=firsts, nodes=tuple(parts["nodes"]))

    def record(self) -> dict[str, Any]:
        """The layout as JSON, without the grid."""
        return {"name": self.name, "rows": [list(rows) for rows in self.rows], "nodes": list(self.nodes)}

    @property
    def rows(self) -> tuple[tuple[int, int], ...]:
        """The first row of each part, and that of the next one."""
        return tuple(pairwise((*self.firsts, self.grid.n_xi)))


def write_part_file(path: Path, part: MeshPart, nodes: Mapping[str, NodeValues], format: str) -> None:
    """Write a part to ``path``; ``nodes`` are values at its nodes, or functions of x and y."""
    if format == "npz":
        values: dict[str, Any] = {
            name: found(part.x, part.y) if callable(found) else found for name, found in nodes.items()
        }
        with path.open("wb") as file:
            np.savez(file, x=part.x, y=part.y, **values)
        return
    with TemporaryDirectory(dir=path.parent) as folder:
        head = Path(folder) / PART_FORMATS[format].head_name("mesh")
        os.replace(write_part(head, part, PartData(nodes=nodes), format=format), path)


def write_head_file(path: Path, layout: PartsLayout, format: str) -> None:
    """Write the head to ``path``; it refers to the parts by the name of the layout."""
    with TemporaryDirectory(dir=path.parent) as folder:
        head = Path(folder) / PART_FORMATS[format].head_name(layout.name)
        write_head(head, grid=layout.grid, cuts=layout.firsts[1:], nodes=layout.nodes, format=format, parts_exist=False)
        os.replace(head, path)


@dataclass(frozen=True)
class _Values:
    """The values of a field at nodes."""

    field: Field

    def __call__(self, x: Array, y: Array) -> Array:
        return self.field.evaluate(x, y)[0]


def values_of(u: Field | None) -> dict[str, NodeValues]:
    """The arrays at the nodes of a part: u, where there is one, evaluated for some rows at a time."""
    return {} if u is None else {"u": _Values(u)}


def convert_part_file(source: Path, path: Path, layout: PartsLayout, number: int, format: str) -> None:
    """Write a part in another format; ``source`` is its file as it was written at first."""
    (first, last), n_eta = layout.rows[number], layout.grid.n_eta
    rows, piece = min(last + 1, layout.grid.n_xi) - first, Piece(path=source)
    points = piece.array("Points", "Points", (rows, n_eta, 3))  # mapped, so that little of it is in memory
    part = MeshPart(
        grid=layout.grid,
        number=number,
        count=len(layout.rows),
        first=first,
        last=last,
        x=points[:, :, 0],
        y=points[:, :, 1],
    )
    nodes = {name: piece.array("PointData", name, (rows, n_eta)) for name in layout.nodes}
    write_part_file(path, part, nodes, format)
