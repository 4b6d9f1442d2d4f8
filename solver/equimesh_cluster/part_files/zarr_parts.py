"""A zarr group that all parts write into: arrays ``x``, ``y`` and those of the data, in chunks.

Arrays at nodes have the shape ``(n_xi, n_eta)`` and the dimensions ``xi`` and ``eta``, those in cells one less. ``xi``
and ``eta`` are arrays, too. Parts do not end where chunks end. So a part writes the chunks that lie in its own rows,
and leaves the rows at its ends in a file next to them. The head puts these rows together, which are less than two
chunks for every part. Until then the group has another name.
"""

import os
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast
from uuid import uuid4

import numpy as np
import numpy.typing as npt

from equimesh.errors import InputError
from equimesh.io.sample_arrays import import_zarr
from equimesh.meshes.mesh import Grid
from equimesh_cluster.mesh_part import MeshPart
from equimesh_cluster.part_files.formats import (
    NodeValues,
    PartData,
    PartedGrid,
    cell_arrays,
    cell_type,
    node_block,
    staged,
)

# Rows of a chunk. The rows at the ends of the parts, which the head writes, are fewer.
CHUNK_ROWS = 32
# Columns of a chunk, at most: a chunk of 1 MiB.
MAX_CHUNK_COLUMNS = 4096
# Numbers that are given to zarr at a time, at most.
MAX_NUMBERS = 1 << 18
# How hard the chunks are packed, from 0 to 9.
LEVEL = 1
# The folder, in the unfinished group, of the rows at the ends of the parts.
SEAMS = "seams"
# The array, in the file of a part there, of the first row of the part and the one after its last.
ENDS = "ends"


def unfinished(head: Path) -> Path:
    """The folder in which the parts write."""
    return head.with_name(f".{head.name}.unfinished")


def write_part(head: Path, part: MeshPart, data: PartData) -> None:
    """Write the own nodes of ``part`` and its cells into the unfinished group of ``head``."""
    store = unfinished(head)
    _add_missing(store, _metadata(part.grid, [*data.nodes], [*data.cells]))
    group = import_zarr().open_group(store, mode="r+")
    left_over: dict[str, npt.NDArray[Any]] = {ENDS: np.array([part.first, part.last])}
    for name, values in {"x": part.x, "y": part.y, **data.nodes}.items():
        left_over |= _write_rows(group[name], name, (part.first, part.last), _of_nodes(part, values))
    for name, array in cell_arrays(data, part).items():
        left_over |= _write_rows(group[name], name, part.cell_rows, _of_cells(part, array))
    (store / SEAMS).mkdir(exist_ok=True)
    with staged(_seam(store, part.number)) as path, path.open("wb") as file:
        np.savez(file, **cast(Any, left_over))


def write_head(head: Path, parted: PartedGrid, nodes: Sequence[str], cells: Sequence[str]) -> None:
    """Put the rows at the ends of the parts together, and give the group its name."""
    store = unfinished(head)
    expected = _metadata(parted.grid, nodes, cells)
    _require_parts(store, parted)
    for name, text in expected.items():
        if not (store / name).exists() or (store / name).read_text() != text:
            raise InputError(f"the parts below {store} are of another mesh, or have other arrays", field="path")
    group = import_zarr().open_group(store, mode="r+")
    for name in ("x", "y", *nodes):
        _join(store, group[name], name, parted.ends)
    inner = [parted.cell_rows(number) for number in range(parted.count)]
    for name in (*cells, "subdomain"):
        _join(store, group[name], name, inner)
    for name, count in (("xi", parted.grid.n_xi), ("eta", parted.grid.n_eta)):
        group[name][:] = np.linspace(0.0, 1.0, count)
    group.attrs["cuts"] = list(parted.cuts)
    shutil.rmtree(store / SEAMS)
    old = head.with_name(f".{head.name}.{uuid4().hex[:8]}.old")
    if head.exists():
        os.replace(head, old)
    os.replace(store, head)
    shutil.rmtree(old, ignore_errors=True)


def remove(head: Path) -> None:
    """Remove the group, and what parts have left of an unfinished one."""
    for folder in (head, unfinished(head)):
        if folder.exists():
            shutil.rmtree(folder)


def _write_rows(array: Any, name: str, ends: tuple[int, int], block: Any) -> dict[str, npt.NDArray[Any]]:
    """Write the whole chunks between the rows ``ends``; returns the rows of other chunks, by the number of the chunk.

    ``block(a, b)`` are the values of the rows a to b - 1 of the array.
    """
    count, step = array.shape[0], CHUNK_ROWS * max(1, MAX_NUMBERS // (CHUNK_ROWS * array.shape[1]))
    left_over, whole = {}, []
    for chunk, (a, b) in _by_chunk(ends):
        if b - a == min(CHUNK_ROWS, count - chunk * CHUNK_ROWS):
            whole += [a, b]
        else:
            left_over[f"{name} {chunk}"] = block(a, b)
    if whole:
        for row in range(whole[0], whole[-1], step):
            stop = min(row + step, whole[-1])
            array[row:stop] = block(row, stop)
    return left_over


def _by_chunk(ends: tuple[int, int]) -> list[tuple[int, tuple[int, int]]]:
    """The chunks that rows lie in, and these rows."""
    first, last = ends
    chunks = range(first // CHUNK_ROWS, -(-last // CHUNK_ROWS)) if last > first else range(0)
    return [(chunk, (max(first, chunk * CHUNK_ROWS), min(last, (chunk + 1) * CHUNK_ROWS))) for chunk in chunks]


def _join(store: Path, array: Any, name: str, ends: Sequence[tuple[int, int]]) -> None:
    """Write the chunks whose rows are of several parts."""
    of_chunk: dict[int, list[int]] = {}
    for number, part in enumerate(ends):
        for chunk, _ in _by_chunk(part):
            of_chunk.setdefault(chunk, []).append(number)
    for chunk, numbers in of_chunk.items():
        if len(numbers) == 1:
            continue  # written by the part
        pieces = []
        for number in numbers:
            with np.load(_seam(store, number)) as file:
                pieces.append(file[f"{name} {chunk}"])
        first = chunk * CHUNK_ROWS
        array[first : first + sum(map(len, pieces))] = np.concatenate(pieces)


def _require_parts(store: Path, parted: PartedGrid) -> None:
    for number, ends in enumerate(parted.ends):
        if not _seam(store, number).exists():
            raise InputError(
                f"part {number} of {parted.count} has written nothing below {store.parent}: write it first, in a folder"
                " that all workers and the caller reach",
                field="path",
            )
        with np.load(_seam(store, number)) as file:
            if tuple(file[ENDS].tolist()) != ends:
                raise InputError(f"part {number} below {store} has other rows: write all parts again", field="cuts")


def _of_nodes(part: MeshPart, values: NodeValues) -> Any:
    return lambda a, b: np.ascontiguousarray(node_block(values, part, slice(a - part.first, b - part.first)))


def _of_cells(part: MeshPart, values: npt.NDArray[Any]) -> Any:
    return lambda a, b: np.ascontiguousarray(values[a - part.first : b - part.first])


def _seam(store: Path, number: int) -> Path:
    return store / SEAMS / f"part-{number:04d}.npz"


def _metadata(grid: Grid, nodes: Sequence[str], cells: Sequence[str]) -> dict[str, str]:
    """The texts that describe the group and its arrays, by their names in the folder."""
    zarr = import_zarr()
    memory = zarr.storage.MemoryStore()
    group = zarr.create_group(memory, zarr_format=3)
    group.attrs["sides"] = {"left": {"xi": 0}, "right": {"xi": -1}, "bottom": {"eta": 0}, "top": {"eta": -1}}
    group.attrs["nodes"], group.attrs["cells"] = list(nodes), [*cells, "subdomain"]
    for name, count in (("xi", grid.n_xi), ("eta", grid.n_eta)):
        group.create_array(name, shape=(count,), chunks=(count,), dtype="float64", dimension_names=(name,))
    chunk = CHUNK_ROWS, MAX_CHUNK_COLUMNS
    packing = zarr.codecs.BloscCodec(cname="zstd", clevel=LEVEL, shuffle="shuffle")
    for names, shape, dimensions in (
        (("x", "y", *nodes), grid.shape, ("xi", "eta")),
        ((*cells, "subdomain"), (grid.n_xi - 1, grid.n_eta - 1), ("xi_cell", "eta_cell")),
    ):
        for name in names:
            dtype = np.dtype(cell_type(name))
            group.create_array(
                name,
                shape=shape,
                chunks=(min(chunk[0], shape[0]), min(chunk[1], shape[1])),
                dtype=dtype,
                dimension_names=dimensions,
                compressors=packing,
                fill_value=np.nan if dtype.kind == "f" else -1,
            )
    return {name: data.to_bytes().decode() for name, data in memory._store_dict.items()}


def _add_missing(store: Path, texts: Mapping[str, str]) -> None:
    """Write these texts to files, each whole or not at all: every part writes the same ones."""
    for name, text in texts.items():
        path = store / name
        if not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            with staged(path) as file:
                file.write_text(text, encoding="utf-8", newline="\n")


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
