"""Formats of meshes in parts: rows and files of the parts, and values at their nodes and cells.

The parts of ``mesh.pvtu`` are ``mesh/part-0000.vtu``, ``mesh/part-0001.vtu`` and so on. The head refers to them by
these relative names, so head and folder can be moved together.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias
from uuid import uuid4

import numpy as np
import numpy.typing as npt

from equimesh.errors import InputError
from equimesh.numerics.types import Array

if TYPE_CHECKING:
    from equimesh.meshes.mesh import Grid
    from equimesh_cluster.mesh_part import MeshPart

# Values at the nodes and cells of a part of a mesh, written in blocks.

NodeValues: TypeAlias = Array | Callable[[Array, Array], Array]
"""Values at the nodes of a part, or the function of x and y that returns them."""
# Numbers of a block of rows or columns that is in memory at a time, for every component.
BLOCK_NUMBERS = 1 << 17
# Names of arrays that files have already.
RESERVED = frozenset({"x", "y", "xi", "eta", "sides", "subdomain", "node_groups", "GlobalNodeIds", "Points"})
# Names that every format can hold.
NAME = re.compile(r"[A-Za-z]\w{0,63}", re.ASCII)
# The field data with the rows: n_xi and n_eta of the whole mesh, and the first rows of parts.
ROWS = "equimesh_rows"


@dataclass(frozen=True, kw_only=True, eq=False)
class PartData:
    """Values at the nodes and cells of a part, by name, for :func:`~equimesh_cluster.write_part`.

    ``nodes`` have the shape of ``part.x``, the first row of the next part included, or are functions of x and y, which
    are evaluated block by block. ``cells`` have one less in both directions. All become double precision. The cell
    array ``subdomain``, the number of the part, is always written.
    """

    nodes: Mapping[str, NodeValues] = field(default_factory=dict)
    cells: Mapping[str, Array] = field(default_factory=dict)

    def check(self, part: MeshPart) -> None:
        """Raise :class:`~equimesh.errors.InputError` for a name or a shape that does not fit ``part``."""
        check_names(self.nodes, self.cells)
        rows, columns = part.x.shape
        for values_of, shape in ((self.nodes, (rows, columns)), (self.cells, (rows - 1, columns - 1))):
            for name, values in values_of.items():
                if not callable(values) and np.shape(values) != shape:
                    raise InputError(
                        f"{name} has shape {np.shape(values)}: part {part.number} needs {shape}", field=name
                    )


def check_names(nodes: Iterable[str], cells: Iterable[str]) -> None:
    """Raise :class:`~equimesh.errors.InputError` for a name that is used already, or that a format cannot hold."""
    seen = set(RESERVED)
    for name in (*nodes, *cells):
        if not isinstance(name, str) or not NAME.fullmatch(name):
            raise InputError(
                f"{str(name)[:80]!r} cannot be the name of an array: use a letter, then letters, digits and _",
                field="data",
            )
        if name in seen:
            raise InputError(f"there is an array {name!r} already: choose another name", field=name)
        seen.add(name)


def blocks(count: int, width: int, numbers: int | None = None) -> Iterator[slice]:
    """Slices that cover ``count`` rows of ``width``, each of at most ``numbers``, or ``BLOCK_NUMBERS``, or one row."""
    step = max(1, (BLOCK_NUMBERS if numbers is None else numbers) // max(1, width))
    return (slice(first, min(first + step, count)) for first in range(0, count, step))


def node_block(values: NodeValues, part: MeshPart, rows: slice) -> Array:
    """The values at a block of the nodes, in double precision."""
    if callable(values):
        x, y = (np.ascontiguousarray(axis[rows]) for axis in (part.x, part.y))
        found = np.asarray(values(x, y), dtype=np.float64)
        return np.broadcast_to(found, x.shape)
    return np.asarray(values[rows], dtype=np.float64)


def cell_arrays(data: PartData, part: MeshPart) -> dict[str, npt.NDArray[Any]]:
    """The arrays of the cells, with the number of the part, which takes no memory."""
    shape = (part.x.shape[0] - 1, part.x.shape[1] - 1)
    return {**data.cells, "subdomain": np.broadcast_to(np.int32(part.number), shape)}


def cell_type(name: str) -> npt.DTypeLike:
    """The type of the numbers of a cell array."""
    return np.int32 if name == "subdomain" else np.float64


def side_digits(part: MeshPart, rows: slice) -> npt.NDArray[np.uint8]:
    """The sides of the nodes in some rows of the part: 0 inside, 1 left, 2 right, 3 bottom, 4 top, both at a corner."""
    number = np.arange(part.first, part.first + part.x.shape[0])[rows]
    digits = np.zeros((number.size, part.x.shape[1]), dtype=np.uint8)
    digits[number == 0] = 1
    digits[number == part.grid.n_xi - 1] = 2
    digits[:, 0] = 10 * digits[:, 0] + 3
    digits[:, -1] = 10 * digits[:, -1] + 4
    return digits


def corners(first: int, last: int, columns: int, dtype: npt.DTypeLike) -> npt.NDArray[Any]:
    """The nodes of the cells in the cell rows ``first`` to ``last - 1``, counter-clockwise, shape ``(k, 4)``."""
    start = np.arange(first, last, dtype=dtype)[:, None] * columns + np.arange(columns - 1, dtype=dtype)
    table = np.empty((*start.shape, 4), dtype=dtype)
    for corner, step in enumerate((0, columns, columns + 1, 1)):
        np.add(start, step, out=table[:, :, corner])
    return table.reshape(-1, 4)


@dataclass(frozen=True, kw_only=True)
class PartedFormat:
    """A format of a mesh in parts: its short ``name``, and the ``suffix`` and ``media_type`` of its head.

    Every part is a file with ``part_suffix`` and ``part_media_type``; both are empty where the parts are chunks of one
    store. ``readers`` are the programs that read the head, and ``sides`` says how the four sides are found.
    """

    name: str
    suffix: str
    media_type: str
    part_suffix: str
    part_media_type: str
    readers: str
    sides: str


PARTED_FORMATS: Final = {
    f.name: f
    for f in (
        PartedFormat(
            name="pvtu",
            suffix=".pvtu",
            media_type="application/vnd.vtk.pvtu+xml",
            part_suffix=".vtu",
            part_media_type="application/vnd.vtk.vtu+xml",
            readers="VTK, PyVista, ParaView",
            sides="point data node_groups: 0 inside, 1 left, 2 right, 3 bottom, 4 top, both digits at a corner",
        ),
        PartedFormat(
            name="vtkhdf",
            suffix=".vtkhdf",
            media_type="application/x-hdf5",
            part_suffix=".hdf",
            part_media_type="application/x-hdf5",
            readers="VTK, PyVista, ParaView; h5py",
            sides="point data node_groups: 0 inside, 1 left, 2 right, 3 bottom, 4 top, both digits at a corner",
        ),
        PartedFormat(
            name="zarr",
            suffix=".zarr",
            media_type="application/vnd+zarr",
            part_suffix="",
            part_media_type="",
            readers="zarr, xarray, Dask",
            sides="by index: left is the first row of an array, right the last, bottom the first column, top the last",
        ),
    )
}


def parted_format(path: str | os.PathLike[str], name: str | None = None) -> PartedFormat:
    """The format with this ``name``; without a name the format of the suffix of ``path``.

    Raises :class:`~equimesh.errors.InputError` for an unknown name or suffix, and for a path without the suffix of the
    format.
    """
    if name is not None and name not in PARTED_FORMATS:
        raise InputError(f"unknown format {name!r} of parts: choose one of {', '.join(PARTED_FORMATS)}", field="format")
    found = Path(path).name
    for known in PARTED_FORMATS.values():
        if name in (None, known.name) and found.endswith(known.suffix) and found != known.suffix:
            return known
    suffixes = ", ".join(known.suffix for known in PARTED_FORMATS.values() if name in (None, known.name))
    raise InputError(
        f"{found!r} cannot be the name of a mesh in parts: it must end in {suffixes}",
        field="path",
    )


@dataclass(frozen=True, kw_only=True)
class PartedGrid:
    """The rows of the parts of a ``grid``: part 0 begins at row 0, and the others at the rows ``cuts``.

    Raises :class:`~equimesh.errors.InputError` where the rows do not increase, or are outside of the grid.
    """

    grid: Grid
    cuts: tuple[int, ...]

    def __post_init__(self) -> None:
        if any(last <= first for first, last in self.ends):
            raise InputError(
                f"the parts begin at the rows {list(self.cuts)[:8]}: these must increase, within the {self.grid.n_xi}"
                " rows of the grid",
                field="cuts",
            )

    @classmethod
    def of(cls, grid: Grid, cuts: Sequence[int]) -> PartedGrid:
        """The parted grid with these cuts, which may be any whole numbers."""
        return cls(grid=grid, cuts=tuple(int(row) for row in cuts))

    @property
    def ends(self) -> tuple[tuple[int, int], ...]:
        """The first row of every part, and the row after its last."""
        return tuple(pairwise((0, *self.cuts, self.grid.n_xi)))

    @property
    def count(self) -> int:
        """The number of parts."""
        return len(self.cuts) + 1

    def cell_rows(self, number: int) -> tuple[int, int]:
        """The first row of cells of a part, and the row after its last."""
        first, last = self.ends[number]
        return first, min(last, self.grid.n_xi - 1)


def part_folder(head: Path) -> Path:
    """The folder of the parts: next to the head, with its name without the suffix."""
    return head.with_suffix("")


def part_name(number: int, kind: PartedFormat) -> str:
    """The name of the file of a part in the folder."""
    return f"part-{number:04d}{kind.part_suffix}"


def part_path(head: str | os.PathLike[str], number: int, kind: PartedFormat) -> Path:
    """The file of a part."""
    return part_folder(Path(head)) / part_name(number, kind)


def part_reference(head: Path, number: int, kind: PartedFormat) -> str:
    """The name by which the head refers to a part: relative to the folder of the head, with ``/`` on every system."""
    return f"{part_folder(head).name}/{part_name(number, kind)}"


@contextmanager
def staged(path: Path) -> Iterator[Path]:
    """A name next to ``path`` to write to; the file gets its own name at the end, and is removed after a failure."""
    unfinished = path.with_name(f".{path.name}.{uuid4().hex[:8]}.unfinished")
    try:
        yield unfinished
        os.replace(unfinished, path)
    except BaseException:
        unfinished.unlink(missing_ok=True)
        raise
