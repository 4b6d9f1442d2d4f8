"""Which nodes a mesh connects: its cells, sides and blocks, and the nodes that are one; checked."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from equimesh.errors import InputError
from equimesh.numerics.types import Array, IntArray


def no_ties() -> IntArray:
    """No pairs of nodes that are one."""
    return np.empty((0, 2), dtype=np.int64)


class Connected(NamedTuple):
    """Which nodes a mesh connects: all that it has besides their coordinates."""

    cells: IntArray
    sides: Mapping[str, IntArray]
    blocks: tuple[IntArray, ...]
    block_names: tuple[str, ...]
    ties: IntArray

    @classmethod
    def of(
        cls,
        points: Array,
        cells: IntArray,
        sides: Mapping[str, IntArray],
        blocks: tuple[IntArray, ...],
        block_names: tuple[str, ...],
        ties: IntArray,
    ) -> Connected:
        """The same, checked; raises :class:`~equimesh.errors.InputError` for other shapes and what is no node."""
        if points.ndim != 2 or points.shape[1] != 2:
            raise InputError(f"points has shape {points.shape}: it must be (n, 2)", field="points")
        edges = {f"sides.{name}": (found, 2) for name, found in sides.items()}
        for name, (table, columns) in {"cells": (cells, 4), "ties": (ties, 2), **edges}.items():
            check_table(table, name, columns, len(points))
        _check_blocks(blocks, len(points))
        return cls(cells, sides, blocks, _names_of(blocks, block_names), ties)


def check_table(table: IntArray, name: str, columns: int, count: int) -> None:
    """Refuse another number of columns, and what is no number of a node."""
    if table.size and table.dtype.kind not in "iu":
        raise InputError(f"{name} has values of the type {table.dtype}: give the numbers of nodes", field=name)
    if table.ndim != 2 or table.shape[1] != columns:
        raise InputError(f"{name} has shape {table.shape}: it must be (k, {columns})", field=name)
    _check_numbers(table, name, count)


def _check_blocks(blocks: tuple[IntArray, ...], count: int) -> None:
    """Refuse blocks of other shapes, and numbers that are no nodes."""
    for k, block in enumerate(blocks):
        if block.ndim != 2 or min(block.shape) < 2:
            raise InputError(f"blocks[{k}] has shape {block.shape}: at least 2 nodes each way", field=f"blocks[{k}]")
    numbers = np.concatenate([block.reshape(-1) for block in blocks]) if blocks else np.empty(0)
    if numbers.size and not (numbers.min() >= 0 and numbers.max() < count):
        for k, block in enumerate(blocks):
            _check_numbers(block, f"blocks[{k}]", count)


def _names_of(blocks: tuple[IntArray, ...], names: tuple[str, ...]) -> tuple[str, ...]:
    """A name for each block."""
    if names and len(names) != len(blocks):
        message = f"{len(names)} names for {len(blocks)} blocks: one name for each block"
        raise InputError(message, field="block_names")
    return names or tuple(f"block{k}" for k in range(len(blocks)))


def cells_of_blocks(blocks: tuple[IntArray, ...], cells: IntArray) -> tuple[IntArray, ...]:
    """For each block the places of its cells among ``cells``, shape ``(n_i - 1, n_j - 1)``."""
    if not blocks:
        return ()
    corners = [quads_of_block(block) for block in blocks]
    ends = np.cumsum([len(block) for block in corners])
    wanted = np.concatenate(corners)
    if len(wanted) == len(cells) and np.array_equal(wanted, cells):
        found = np.arange(len(cells))
    else:
        found = _places(np.sort(cells, axis=1), np.sort(wanted, axis=1))
    pieces = np.split(found, ends[:-1])
    shapes = [(block.shape[0] - 1, block.shape[1] - 1) for block in blocks]
    return tuple(piece.reshape(shape) for piece, shape in zip(pieces, shapes, strict=True))


def quads_of_block(block: IntArray) -> IntArray:
    """The nodes of every cell of a block, counter-clockwise, shape ``(m, 4)``; j runs fastest."""
    corners = block[:-1, :-1], block[1:, :-1], block[1:, 1:], block[:-1, 1:]
    return np.stack([corner.ravel() for corner in corners], axis=1)


def _check_numbers(table: IntArray, name: str, count: int) -> None:
    """Refuse numbers that are no nodes."""
    if table.size and not (table.min() >= 0 and table.max() < count):
        place = np.unravel_index(int(((table < 0) | (table >= count)).argmax()), table.shape)
        where = "".join(f"[{int(k)}]" for k in place)
        raise InputError(f"{name}{where} = {table[place]}: the nodes have the numbers 0 to {count - 1}", field=name)


def _places(rows: IntArray, wanted: IntArray) -> IntArray:
    """The place among ``rows`` of each of the ``wanted`` rows; both have four sorted columns."""
    both = np.concatenate([rows, wanted])
    order = np.lexsort(both.T[::-1])
    ordered = both[order]
    starts = np.concatenate([[True], (ordered[1:] != ordered[:-1]).any(axis=1)])
    group = np.empty(len(both), dtype=np.int64)
    group[order] = np.cumsum(starts) - 1
    place = np.full(group.max() + 1, -1)
    place[group[: len(rows)]] = np.arange(len(rows))
    found = place[group[len(rows) :]]
    if found.size and found.min() < 0:
        cell = wanted[found.argmin()].tolist()
        raise InputError(f"a block has a cell with the nodes {cell}, which is no cell of the mesh", field="blocks")
    return found
