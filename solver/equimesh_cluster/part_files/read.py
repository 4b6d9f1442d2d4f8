"""Reading a mesh in parts row by row: no more of it is in memory than is asked for."""

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy.typing as npt

from equimesh.errors import InputError
from equimesh.meshes.grid import Grid
from equimesh.meshes.mesh_part import MeshPart
from equimesh_cluster.part_files.contents import blocks
from equimesh_cluster.part_files.formats import PartedFormat, PartedGrid, part_path, parted_format

# Numbers that are read at a time, 16 MB.
READ_NUMBERS = 1 << 21


class Rows(Protocol):
    """The arrays of one format: the rows of the parts, the names of the arrays, and their rows."""

    @property
    def parted(self) -> PartedGrid:
        """The rows of the parts."""
        ...

    @property
    def nodes(self) -> tuple[str, ...]:
        """The names of the arrays at nodes, without x and y."""
        ...

    @property
    def cells(self) -> tuple[str, ...]:
        """The names of the arrays in cells."""
        ...

    def rows(self, name: str, first: int, last: int) -> npt.NDArray[Any]:
        """The rows ``first`` to ``last - 1`` of an array."""
        ...


@dataclass(frozen=True, kw_only=True, eq=False)
class PartedMesh:
    """A mesh in parts in files, whose arrays are read when they are asked for.

    ``nodes`` are the names of its arrays at nodes besides ``x`` and ``y``, ``cells`` those of its arrays in cells.
    """

    path: Path
    format: PartedFormat
    _source: Rows

    @property
    def grid(self) -> Grid:
        """The grid of the whole mesh."""
        return self._source.parted.grid

    @property
    def cuts(self) -> tuple[int, ...]:
        """The first rows of all parts but part 0."""
        return self._source.parted.cuts

    @property
    def nodes(self) -> tuple[str, ...]:
        """The names of the arrays at nodes, without x and y."""
        return self._source.nodes

    @property
    def cells(self) -> tuple[str, ...]:
        """The names of the arrays in cells."""
        return self._source.cells

    def rows(self, name: str, first: int, last: int) -> npt.NDArray[Any]:
        """The rows ``first`` to ``last - 1`` of ``x``, ``y`` or another array, whatever parts they are of.

        The shape is ``(last - first, n_eta)`` at nodes and ``(last - first, n_eta - 1)`` in cells. Raises
        :class:`~equimesh.errors.InputError` for an unknown name, and for rows that the array does not have.
        """
        if name not in ("x", "y", *self.nodes, *self.cells):
            raise InputError(
                f"{self.path.name} has no array {name!r}; it has {', '.join(('x', 'y', *self.nodes, *self.cells))}",
                field="name",
            )
        count = self.grid.n_xi - (name in self.cells)
        if not 0 <= first <= last <= count:
            raise InputError(f"{name} has the rows 0 to {count - 1}, not {first} to {last - 1}", field="name")
        return self._source.rows(name, first, last)

    def blocks(self, name: str) -> Iterator[tuple[int, npt.NDArray[Any]]]:
        """All rows of an array, some at a time: the number of the first, and the rows."""
        count = self.grid.n_xi - (name in self.cells)
        for some in blocks(count, self.grid.n_eta, READ_NUMBERS):
            yield some.start, self.rows(name, some.start, some.stop)

    def part(self, number: int) -> MeshPart:
        """Part ``number``, with its x and y in memory."""
        first, last = self._source.parted.ends[number]
        end = min(last + 1, self.grid.n_xi)
        return MeshPart(
            grid=self.grid,
            number=number,
            count=self._source.parted.count,
            first=first,
            last=last,
            x=self.rows("x", first, end),
            y=self.rows("y", first, end),
        )


def read_parts(path: str | os.PathLike[str], *, format: str | None = None) -> PartedMesh:
    """The mesh in parts whose head is ``path``, as :func:`~equimesh_cluster.write_head` wrote it; reads no arrays yet.

    Raises :class:`~equimesh.errors.InputError` where the head or a part is missing, or is not of this project.
    """
    kind, head = parted_format(path, format), Path(path)
    if not head.exists():
        raise InputError(f"there is no file {head} on this machine", field="path")
    try:
        source = _source(kind, head)
    except InputError:
        raise
    except (KeyError, ValueError, IndexError, OSError, SyntaxError) as error:  # ParseError is a SyntaxError
        raise InputError(
            f"{head.name} is not a mesh in parts written by equimesh: {str(error)[:200]}", field="path"
        ) from error
    for number in range(source.parted.count if kind.part_suffix else 0):
        if not part_path(head, number, kind).is_file():
            raise InputError(
                f"{head.name} has {source.parted.count} parts, and part {number} is not at"
                f" {part_path(head, number, kind)}: keep the head and its folder together",
                field="path",
            )
    return PartedMesh(path=head, format=kind, _source=source)


def _source(kind: PartedFormat, head: Path) -> Rows:
    match kind.name:
        case "pvtu":
            from equimesh_cluster.part_files.pvtu import Pieces

            return Pieces.of(head)
        case "vtkhdf":
            from equimesh_cluster.part_files.vtkhdf import FlatDatasets

            return FlatDatasets.of(head)
        case _:
            from equimesh_cluster.part_files.zarr_parts import Chunks

            return Chunks.of(head)
