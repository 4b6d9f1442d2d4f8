"""The formats of meshes in parts, the rows of the parts, and their files in a folder next to the head.

The parts of ``mesh.pvtu`` are ``mesh/part-0000.vtu``, ``mesh/part-0001.vtu`` and so on. The head refers to them by
these relative names, so head and folder can be moved together.
"""

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Final
from uuid import uuid4

from equimesh.errors import InputError
from equimesh.meshes.grid import Grid


@dataclass(frozen=True, kw_only=True)
class PartedFormat:
    """A format of a mesh in parts: its short ``name``, and the ``suffix`` and ``media_type`` of its head.

    Every part is a file with ``part_suffix`` and ``part_media_type``; both are empty where the parts are chunks of one
    store. ``readers`` are the programs that read the head, and ``sides`` says how the four sides are found.
    ``shares_rows`` says whether two neighbouring parts both hold the nodes between them.
    """

    name: str
    suffix: str
    media_type: str
    part_suffix: str
    part_media_type: str
    readers: str
    sides: str
    shares_rows: bool = False


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
            shares_rows=True,
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
    """The format with this ``name``, or without one that of the suffix of ``path``.

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
    def of(cls, grid: Grid, cuts: Sequence[int]) -> "PartedGrid":
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
