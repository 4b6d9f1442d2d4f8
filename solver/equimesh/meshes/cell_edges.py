"""The edges between the cells of any mesh of quadrilaterals: which cells lie on their two sides."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from equimesh.errors import InputError
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import BoolArray, IntArray

NO_CELL = -1
"""What stands for the second cell of an edge on the boundary."""


@dataclass(frozen=True, eq=False)
class CellEdges:
    """Every edge of some cells once, in the order of the first cell that has it.

    ``cells`` are the two cells of each edge, shape ``(k, 2)``, the lower number first; on the boundary the second is
    ``NO_CELL``. ``places`` are the corners of the two cells where the edge begins, counter-clockwise around each, shape
    ``(k, 2)``. ``of_cells`` are the numbers of the edges of each cell, shape ``(m, 4)``; edge j leads from corner j to
    the next.
    """

    cells: IntArray
    places: IntArray
    of_cells: IntArray

    @classmethod
    def of(cls, cells: IntArray, count: int, ties: IntArray | None = None) -> CellEdges:
        """The edges of ``cells``, shape ``(m, 4)``, with ``count`` nodes.

        ``ties``, shape ``(k, 2)``, are pairs of nodes that count as one: a copy and its original. Raises
        :class:`~equimesh.errors.InputError` where an edge belongs to more than two cells.
        """
        originals = originals_of(count, ties)
        corners = np.ascontiguousarray(cells if originals is None else originals[cells])
        sides, places = np.full((4 * len(cells), 2), NO_CELL), np.zeros((4 * len(cells), 2), dtype=np.int64)
        of_cells = np.empty((len(cells), 4), dtype=np.int64)
        found = find_edges(corners, count, sides, places, of_cells)
        if found < 0:
            cell, place = divmod(-found - 1, 4)
            a, b = cells[cell, place], cells[cell, (place + 1) % 4]
            raise InputError(
                f"the edge from node {a} to node {b} has more than two cells, one of them cell {cell}", field="cells"
            )
        return cls(sides[:found], places[:found], of_cells)

    @property
    def is_outer(self) -> BoolArray:
        """Whether each edge is on the boundary, shape ``(k,)``."""
        return np.asarray(self.cells[:, 1] == NO_CELL)

    @property
    def neighbours(self) -> IntArray:
        """The cell across each edge of each cell, shape ``(m, 4)``; ``NO_CELL`` on the boundary."""
        both = self.cells[self.of_cells]
        own = np.arange(len(self.of_cells))[:, None]
        return np.where(both[..., 0] == own, both[..., 1], both[..., 0])


def originals_of(count: int, ties: IntArray | None) -> IntArray | None:
    """The node that each of ``count`` nodes is a copy of, or itself; ``None`` where no node is a copy."""
    if ties is None or not len(ties):
        return None
    originals = np.arange(count)
    originals[ties[:, 0]] = ties[:, 1]
    while not np.array_equal(further := originals[originals], originals):  # a copy of a copy
        originals = further
    return originals


@compiled
def find_edges(cells: IntArray, count: int, sides: IntArray, places: IntArray, of_cells: IntArray) -> int:
    """The number of edges, whose rows are written; or -1 minus the place of a third cell, ``4 cell + corner``.

    Edges are kept in a list for each lower node.
    """
    first, after = np.full(count, -1), np.empty(4 * len(cells), dtype=np.int64)
    higher, found = np.empty(4 * len(cells), dtype=np.int64), 0
    for k in range(len(cells)):
        for j in range(4):
            a, b = cells[k, j], cells[k, (j + 1) % 4]
            low, high = min(a, b), max(a, b)
            edge = first[low]
            while edge >= 0 and higher[edge] != high:
                edge = after[edge]
            if edge < 0:
                edge = found
                higher[edge], after[edge], first[low] = high, first[low], edge
                sides[edge, 0], places[edge, 0] = k, j
                found += 1
            elif sides[edge, 1] >= 0:
                return -1 - (4 * k + j)
            else:
                sides[edge, 1], places[edge, 1] = k, j
            of_cells[k, j] = edge
    return found
