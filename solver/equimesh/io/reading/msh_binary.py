"""The nodes and elements of binary Gmsh files, as arrays."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from equimesh.errors import InputError
from equimesh.numerics.types import Array, IntArray

# Blocks of nodes or elements, at most.
MAX_BLOCKS: Final = 100_000

Numbers = npt.NDArray[Any]


@dataclass
class Bytes:
    """Numbers in the bytes of a section, one after another; ``order`` is ``<`` or ``>``."""

    data: bytes
    order: str
    at: int = 0

    def take(self, kind: str, count: int) -> Numbers:
        """The next ``count`` numbers of a kind of NumPy, ``i4``, ``u8`` or ``f8``."""
        dtype = np.dtype(f"{self.order}{kind}")
        if not 0 <= count <= (len(self.data) - self.at) // dtype.itemsize:
            raise InputError("a section of the binary Gmsh file ends too early", field="file")
        found = np.frombuffer(self.data, dtype, count, self.at)
        self.at += count * dtype.itemsize
        return found

    def line(self) -> int:
        """The number in the next line of text."""
        end = self.data.find(b"\n", self.at, self.at + 30)
        word = self.data[self.at : end].strip()
        if end < 0 or not word.isdigit():
            raise InputError("a section of the binary Gmsh file does not begin with a number", field="file")
        self.at = end + 1
        return int(word)


def order_of(head: bytes) -> str:
    """The order of bytes, from the text of ``$MeshFormat``: the number 1 stands in its second line."""
    mark = head.partition(b"\n")[2][:4]
    if mark not in (b"\x01\x00\x00\x00", b"\x00\x00\x00\x01"):
        raise InputError("the binary Gmsh file does not tell the order of its bytes: save it again", field="file")
    return "<" if mark[0] else ">"


def nodes_22(data: Bytes) -> tuple[Array, IntArray]:
    """Coordinates, shape ``(n, 3)``, and numbers of the nodes of version 2."""
    count = data.line()
    rows = data.take("i4", 7 * count).reshape(count, 7)
    places = np.ascontiguousarray(rows[:, 1:]).view(f"{data.order}f8")
    return places.astype(np.float64), rows[:, 0].astype(np.int64)


def elements_22(data: Bytes, width_of: Callable[[int], int]) -> Iterator[tuple[int, Numbers]]:
    """Blocks of elements of version 2: their type, and rows of number, group (0 for none) and nodes.

    ``width_of`` has the number of nodes of a type. Some programs write a block for each element: those are joined.
    """
    left = data.line()
    for _ in range(MAX_BLOCKS):
        if left == 0:
            return
        kind, count, tags = data.take("i4", 3).tolist()
        if count < 1 or tags < 0:
            raise InputError("a block of the binary Gmsh file has no elements: save it again", field="file")
        width = 1 + tags + width_of(kind)
        rows = data.take("i4", count * width).reshape(count, width)
        if count == 1:
            rows = np.concatenate([rows, _single(data, (kind, 1, tags), width, left - 1)])
        left -= len(rows)
        group = rows[:, 1:2] if tags else np.zeros_like(rows[:, :1])
        yield kind, np.concatenate([rows[:, :1], group, rows[:, 1 + tags :]], axis=1).astype(np.int64)
    raise InputError(f"the binary Gmsh file has more than {MAX_BLOCKS} blocks of elements", field="file")


def _single(data: Bytes, head: tuple[int, int, int], width: int, most: int) -> Numbers:
    """The rows of the blocks of one element that follow with this head."""
    kind = np.dtype(f"{data.order}i4")
    possible = min(most, (len(data.data) - data.at) // (kind.itemsize * (3 + width)))
    size = min(64, possible)
    while True:
        table = np.frombuffer(data.data, kind, size * (3 + width), data.at).reshape(size, 3 + width)
        other = (table[:, :3] != head).any(axis=1)
        same = int(other.argmax()) if other.any() else size
        if same < size or size == possible:
            data.at += same * (3 + width) * kind.itemsize
            return table[:same, 3:]
        size = min(2 * size, possible)


def groups_of_entities(data: Bytes, most: int) -> dict[tuple[int, int], list[int]]:
    """The physical groups of points and curves of version 4.1, by dimension and number of the entity.

    An entity has ``most`` of them at most.
    """
    counts = data.take("u8", 4).tolist()
    if counts[0] + counts[1] > MAX_BLOCKS:
        raise InputError(f"the binary Gmsh file has more than {MAX_BLOCKS} points and curves", field="file")
    found = {}
    for dimension, count in enumerate(counts[:2]):
        for _ in range(count):
            entity = int(data.take("i4", 1)[0])
            data.take("f8", 6 if dimension else 3)
            number = int(data.take("u8", 1)[0])
            if number > most:
                message = f"{number} physical groups of one entity: {most} are possible"
                raise InputError(message, field="file")
            found[dimension, entity] = np.abs(data.take("i4", number)).tolist()
            if dimension:
                data.take("i4", int(data.take("u8", 1)[0]))
    return found


def nodes_41(data: Bytes) -> tuple[Array, IntArray]:
    """Coordinates, shape ``(n, 3)``, and numbers of the nodes of version 4.1, which has them by entity."""
    points, tags = [np.empty((0, 3))], [np.empty(0, np.int64)]
    for _ in range(_blocks(data)):
        dimension, _, parametric = data.take("i4", 3).tolist()
        count = int(data.take("u8", 1)[0])
        if not 0 <= dimension <= 3:
            raise InputError("the nodes of the binary Gmsh file are on an unknown entity", field="file")
        tags.append(data.take("u8", count).astype(np.int64))
        columns = 3 + (dimension if parametric else 0)
        points.append(data.take("f8", count * columns).reshape(count, columns)[:, :3].astype(np.float64))
    return np.concatenate(points), np.concatenate(tags)


def elements_41(data: Bytes, width_of: Callable[[int], int]) -> Iterator[tuple[tuple[int, int], int, Numbers]]:
    """Blocks of elements of version 4.1: dimension and number of the entity, type, and rows of number and nodes."""
    for _ in range(_blocks(data)):
        dimension, entity, kind = data.take("i4", 3).tolist()
        count, width = int(data.take("u8", 1)[0]), 1 + width_of(kind)
        yield (dimension, entity), kind, data.take("u8", count * width).reshape(count, width).astype(np.int64)


def _blocks(data: Bytes) -> int:
    """The number of blocks of a section of version 4.1."""
    count = int(data.take("u8", 4)[0])
    if count > MAX_BLOCKS:
        raise InputError(
            f"a section of the binary Gmsh file has {count} blocks: {MAX_BLOCKS} are possible", field="file"
        )
    return count
