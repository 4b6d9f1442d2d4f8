"""Meshes in parts in files: every part written by the process that holds it, then the head; read back row by row."""

from __future__ import annotations

import os
import shutil
import socket
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, Protocol

import numpy.typing as npt

from equimesh.errors import InputError
from equimesh.meshes.mesh import Grid
from equimesh_cluster.mesh_part import MeshPart
from equimesh_cluster.part_files.formats import (
    PartData,
    PartedFormat,
    PartedGrid,
    blocks,
    check_names,
    part_folder,
    part_path,
    parted_format,
    staged,
)

# Writing a mesh in parts: every part by the process that holds it, then the head.

# How long the caller waits for the file of a worker: network folders show new files late.
WAIT_SECONDS = 5.0
# How often it looks.
LOOK_SECONDS = 0.05


def write_part(
    path: str | os.PathLike[str], part: MeshPart, data: PartData | None = None, *, format: str | None = None
) -> Path:
    """Write the rows of ``part``, and return the path of their file. ``path`` is the head, which is written at the end.

    The file is ``part-0003.vtu`` in the folder ``mesh``, for part 3 of ``mesh.pvtu``; that folder is made. ``format``
    is a name in :data:`~equimesh_cluster.PARTED_FORMATS`; without it the suffix of ``path`` decides. The file appears
    whole or not at all, and one that was there is replaced. Only some rows are copied at a time.

    This runs in the process that holds the part, which may be on another machine. The folder of ``path`` must be one
    that all these processes and the one that writes the head reach by the same name;
    :func:`~equimesh_cluster.part_files.parted_mesh.require_probe` finds out.

    Raises :class:`~equimesh.errors.InputError` for an unknown format, arrays that do not fit, and a folder that does
    not exist; ``OSError`` where a file cannot be written.
    """
    kind, head = parted_format(path, format), Path(path)
    contents = PartData() if data is None else data
    contents.check(part)
    require_folder(head)
    if kind.name == "zarr":
        from equimesh_cluster.part_files import zarr_parts

        zarr_parts.write_part(head, part, contents)
        return head
    file = part_path(head, part.number, kind)
    file.parent.mkdir(exist_ok=True)
    with staged(file) as unfinished:
        _writer(kind).write_part(unfinished, part, contents)
    return file


def write_head(
    path: str | os.PathLike[str],
    *,
    grid: Grid,
    cuts: Sequence[int],
    nodes: Sequence[str] = (),
    cells: Sequence[str] = (),
    format: str | None = None,
    parts_exist: bool = True,
) -> Path:
    """Write the head of a mesh whose parts are written, and return its path.

    The parts begin at row 0 and at the rows ``cuts`` of ``grid``; ``nodes`` and ``cells`` are the names of their
    arrays, in the order in which they are listed. No part is opened. With ``parts_exist=False`` the files of the parts
    may still be missing, except for zarr, whose head is made of what the parts left.

    Raises :class:`~equimesh.errors.InputError` as :func:`write_part`, and where a part is not there; ``OSError`` where
    a file cannot be written.
    """
    kind, head = parted_format(path, format), Path(path)
    parted = PartedGrid.of(grid, cuts)
    check_names(nodes, cells)
    require_folder(head)
    if kind.name == "zarr":
        from equimesh_cluster.part_files import zarr_parts

        zarr_parts.write_head(head, parted, nodes, cells)
        return head
    if parts_exist:
        _require_parts(head, kind, parted)
    with staged(head) as unfinished:
        _writer(kind).write_head(unfinished, head, parted, nodes, cells)
    return head


def remove_parted(path: str | os.PathLike[str], *, format: str | None = None) -> None:
    """Remove the head and all parts of an older mesh of this name, if there is one.

    Call it before the first part is written: otherwise the old head shows old and new parts together.
    """
    kind, head = parted_format(path, format), Path(path)
    if kind.name == "zarr":
        from equimesh_cluster.part_files import zarr_parts

        zarr_parts.remove(head)
        return
    head.unlink(missing_ok=True)
    folder = part_folder(head)
    for file in folder.glob(f"part-*{kind.part_suffix}"):
        file.unlink(missing_ok=True)
    if folder.is_dir() and not any(folder.iterdir()):
        shutil.rmtree(folder)


def _writer(kind: PartedFormat) -> ModuleType:
    """The module of a format whose parts are files; HDF5 is loaded for its own alone."""
    if kind.name == "pvtu":
        from equimesh_cluster.part_files import pvtu

        return pvtu
    from equimesh_cluster.part_files import vtkhdf

    return vtkhdf


def require_folder(head: Path) -> None:
    """Raise :class:`~equimesh.errors.InputError` where the folder of a head is not on this machine."""
    if not head.parent.is_dir():
        raise InputError(
            f"there is no folder {head.parent} on this machine: make it, or choose one that all workers reach",
            field="path",
        )


def _require_parts(head: Path, kind: PartedFormat, parted: PartedGrid) -> None:
    for number in range(parted.count):
        file = part_path(head, number, kind)
        if not file.is_file():
            raise InputError(
                f"part {number} of {parted.count} is not at {file}: write it first, in a folder that all workers and"
                " the caller reach",
                field="path",
            )


def leave_probe(path: str | os.PathLike[str], token: str) -> str:
    """Write a small file next to ``path``, named by ``token``; returns the name of this machine. Runs on a worker.

    Raises :class:`~equimesh.errors.InputError` where this machine has no such folder, or may not write there.
    """
    machine, probe = socket.gethostname(), _probe(Path(path), token)
    try:
        probe.write_text(machine)
    except OSError as error:
        raise InputError(
            f"the worker on {machine} cannot write to {probe.parent}: {error.strerror or error}. Give a folder that all"
            " workers reach, such as a network folder with the same name everywhere",
            field="path",
        ) from error
    return machine


def require_probe(path: str | os.PathLike[str], token: str, machine: str, *, seconds: float = WAIT_SECONDS) -> None:
    """Return when the file that a worker on ``machine`` left with ``token`` is here too, and remove it.

    Runs in the process that writes the head. Raises :class:`~equimesh.errors.InputError` where it does not appear
    within ``seconds``: the worker wrote to another folder of the same name, which is on its own machine.
    """
    probe, end = _probe(Path(path), token), time.monotonic() + seconds
    while not _is_there(probe):
        if time.monotonic() >= end:
            raise InputError(
                f"what the worker on {machine} wrote to {probe.parent} is not seen on {socket.gethostname()}: the"
                " folder is on its own machine. Give a folder that all workers and the caller reach",
                field="path",
            )
        time.sleep(LOOK_SECONDS)
    probe.unlink(missing_ok=True)


def _is_there(probe: Path) -> bool:
    """Whether the file exists; the folder is listed first, which makes network folders look again."""
    try:
        return probe.name in os.listdir(probe.parent)
    except OSError:
        return False


def _probe(path: Path, token: str) -> Path:
    return path.parent / f".equimesh-{token}.probe"


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
    """A mesh in parts in files. An array is read when it is used.

    ``nodes`` are the names of its arrays at nodes besides ``x`` and ``y``, ``cells`` the names of its arrays in cells.
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
