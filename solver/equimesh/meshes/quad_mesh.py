"""A mesh of quadrilaterals in blocks: node coordinates, named sides, and properties of geometry alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import ClassVar

import numpy as np

from equimesh.errors import InputError
from equimesh.meshes.cell_edges import Join, joins_of
from equimesh.meshes.mesh import ComparedWith, Mesh, largest_difference, smallest_of_cells
from equimesh.numerics.threads import run_on_threads
from equimesh.numerics.types import Array, IntArray
from equimesh_coupling.coupled import Coupled
from equimesh_coupling.parts import Cells, MeshParts, triangles_of_cells

# Fewer cells are not worth a second thread.
MIN_SHARED_CELLS = 16_384


def _no_ties() -> IntArray:
    return np.empty((0, 2), dtype=np.int64)


@dataclass(frozen=True, kw_only=True, eq=False)
class QuadMesh(Coupled):
    """A mesh of quadrilaterals, whose nodes and cells have one number each.

    - ``points``: coordinates of the nodes, shape ``(n, 2)``.
    - ``cells``: nodes of every cell, counter-clockwise, shape ``(m, 4)``: block by block, or in the order of the file
      that the mesh was read from.
    - ``sides``: boundary edges by the name of their side, shape ``(k, 2)`` each, with the domain on their left, in
      their order along the side.
    - ``blocks``: for each block the numbers of its nodes, shape ``(n_i, n_j)``. Where i runs to the right, j runs
      upwards. Blocks that touch have the numbers of their common nodes in common.
    - ``block_names``: a name for each block.
    - ``ties``: pairs of nodes that are one unknown, shape ``(k, 2)``: a copy and its original, which lie apart by the
      translation of a periodic join. Empty where nothing is joined.

    Raises :class:`~equimesh.errors.InputError` for arrays of other shapes, and for numbers that are no nodes.
    """

    points: Array
    cells: IntArray
    sides: Mapping[str, IntArray]
    blocks: tuple[IntArray, ...] = ()
    block_names: tuple[str, ...] = ()
    ties: IntArray = field(default_factory=_no_ties)

    def __post_init__(self) -> None:
        if self.points.ndim != 2 or self.points.shape[1] != 2:
            raise InputError(f"points has shape {self.points.shape}: it must be (n, 2)", field="points")
        tables = {"cells": (self.cells, 4), "ties": (self.ties, 2)}
        tables |= {f"sides.{name}": (edges, 2) for name, edges in self.sides.items()}
        for name, (table, columns) in tables.items():
            if table.ndim != 2 or table.shape[1] != columns:
                raise InputError(f"{name} has shape {table.shape}: it must be (k, {columns})", field=name)
            _check_numbers(table, name, len(self.points))
        for k, block in enumerate(self.blocks):
            if block.ndim != 2 or min(block.shape) < 2:
                raise InputError(
                    f"blocks[{k}] has shape {block.shape}: at least 2 nodes each way", field=f"blocks[{k}]"
                )
        numbers = np.concatenate([block.reshape(-1) for block in self.blocks]) if self.blocks else np.empty(0)
        if numbers.size and not (numbers.min() >= 0 and numbers.max() < len(self.points)):
            for k, block in enumerate(self.blocks):
                _check_numbers(block, f"blocks[{k}]", len(self.points))
        if len(self.block_names) != len(self.blocks):
            names = tuple(f"block{k}" for k in range(len(self.blocks)))
            if self.block_names:
                message = f"{len(self.block_names)} names for {len(self.blocks)} blocks: one name for each block"
                raise InputError(message, field="block_names")
            object.__setattr__(self, "block_names", names)

    compared_with: ClassVar[ComparedWith] = "initial"
    """The name of the mesh with which others on the same domain are compared."""

    @property
    def periodic(self) -> tuple[Join, ...]:
        """The pairs of sides that are joined by a translation, with their ``nodes``; none where nothing is joined.

        Raises :class:`~equimesh.errors.InputError` where a side is joined in part, to several sides, or to itself.
        """
        return joins_of(self.points, self.sides, self.ties)

    @property
    def x(self) -> Array:
        """The first coordinate of the nodes, shape ``(n,)``."""
        return self.points[:, 0]

    @property
    def y(self) -> Array:
        """The second coordinate of the nodes, shape ``(n,)``."""
        return self.points[:, 1]

    @property
    def node_shape(self) -> tuple[int]:
        """The shape of one value at each node: ``(n,)``."""
        return (len(self.points),)

    @property
    def cell_shape(self) -> tuple[int]:
        """The shape of one value on each cell: ``(m,)``."""
        return (len(self.cells),)

    def moved(self, points: Array) -> QuadMesh:
        """The same mesh with its nodes at other ``points``, shape ``(n, 2)``."""
        if points.shape != self.points.shape:
            raise InputError(f"points has shape {points.shape}, this mesh needs {self.points.shape}", field="points")
        moved = object.__new__(type(self))  # numbers that have been checked need not be checked again
        vars(moved).update({own.name: getattr(self, own.name) for own in fields(self)} | {"points": points})
        if "block_cells" in vars(self):
            vars(moved)["block_cells"] = self.block_cells
        return moved

    @cached_property
    def block_cells(self) -> tuple[IntArray, ...]:
        """For each block the numbers of its cells, shape ``(n_i - 1, n_j - 1)``.

        Raises :class:`~equimesh.errors.InputError` where a block has a cell that the mesh does not have.
        """
        if not self.blocks:
            return ()
        corners = [quads_of_block(block) for block in self.blocks]
        ends = np.cumsum([len(block) for block in corners])
        wanted = np.concatenate(corners)
        if len(wanted) == len(self.cells) and np.array_equal(wanted, self.cells):
            found = np.arange(len(self.cells))
        else:
            found = _places(np.sort(self.cells, axis=1), np.sort(wanted, axis=1))
        pieces = np.split(found, ends[:-1])
        shapes = [(block.shape[0] - 1, block.shape[1] - 1) for block in self.blocks]
        return tuple(piece.reshape(shape) for piece, shape in zip(pieces, shapes, strict=True))

    def block_mesh(self, k: int) -> Mesh:
        """Block ``k`` as a structured mesh of its own."""
        block = self.blocks[k]
        return Mesh(self.x[block], self.y[block])

    def triangles(self) -> IntArray:
        """The cells cut into triangles, counter-clockwise, shape ``(2 m, 3)``.

        Cell ``k`` gives the rows ``2 k`` and ``2 k + 1``. Each quadrilateral is cut along the diagonal that leaves the
        larger smallest angle. A cell with two boundary edges that meet is cut through their corner.
        """
        return triangles_of_cells(self.points, self.cells)

    def mesh_parts(self, cells: Cells | None = None) -> MeshParts:
        """Points, cells and sides as plain arrays; quadrilaterals, unless ``cells`` is ``"triangle"``.

        Raises :class:`~equimesh_coupling.BadValues` for another kind of cells.
        """
        return MeshParts(points=self.points, cells=self.cells, sides=self.sides, shape=None).mesh_parts(cells)

    def distance(self, other: QuadMesh) -> float:
        """The largest difference of a coordinate to another mesh with as many nodes."""
        return float(largest_difference(self.points, other.points))

    def cell_areas(self) -> Array:
        """The area of every cell, shape ``(m,)``, half the cross product of its diagonals; negative if inverted."""
        a, b, c, d = (self.points[self.cells[:, k]] for k in range(4))
        one, other = c - a, d - b
        return np.asarray(0.5 * (one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]))

    def corner_jacobians(self) -> Array:
        """The cross product of the two edges at each corner of a cell, over the mean area of cells, shape ``(4, m)``.

        Corner k is ``cells[:, k]``. A bilinear cell is valid (its map one to one) exactly when all four are positive.
        """
        at = self.points[self.cells]
        ahead, behind = np.roll(at, -1, axis=1) - at, np.roll(at, 1, axis=1) - at
        cross = ahead[..., 0] * behind[..., 1] - ahead[..., 1] * behind[..., 0]
        return np.asarray(cross.T / self.cell_areas().mean())

    @property
    def min_jacobian(self) -> float:
        """The smallest of :meth:`corner_jacobians`; not positive for a folded mesh."""
        return float(smallest_of_cells(self.points, self.cells) / self.cell_areas().mean())

    @property
    def is_folded(self) -> bool:
        """Whether some cell is inverted, degenerate, or has a coordinate that is not finite."""
        return self.is_folded_on(1)

    def is_folded_on(self, threads: int) -> bool:
        """Whether a cell is folded, as :attr:`is_folded`; the ``threads`` share the cells."""
        count = max(1, min(threads, len(self.cells) // MIN_SHARED_CELLS))
        ends = np.linspace(0, len(self.cells), count + 1).astype(np.int64)
        smallest = np.full(count, np.nan)

        def work(k: int) -> None:
            smallest[k] = smallest_of_cells(self.points, self.cells[ends[k] : ends[k + 1]])

        run_on_threads(count, work)
        return not smallest.min() > 0.0


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
