"""Values at the nodes and cells of a part of a mesh, written in blocks."""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from equimesh.errors import InputError
from equimesh.meshes.mesh_part import MeshPart
from equimesh.numerics.types import Array

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


def node_block(values: NodeValues, part: MeshPart, rows: slice, columns: slice = slice(None)) -> Array:
    """The values at a block of the nodes, in double precision."""
    if callable(values):
        x, y = (np.ascontiguousarray(axis[rows, columns]) for axis in (part.x, part.y))
        found = np.asarray(values(x, y), dtype=np.float64)
        return np.broadcast_to(found, x.shape)
    return np.asarray(values[rows, columns], dtype=np.float64)


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
