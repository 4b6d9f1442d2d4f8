"""The lines of a mesh of blocks in a picture, and cells with colours for any mesh."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from equimesh.meshes.mesh import Mesh
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.numerics.types import Array, IntArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable


def step_of(mesh: QuadMesh, most: int) -> int:
    """Every how many lines one is drawn, so that no block has more than about ``most`` lines in a direction."""
    return max((math.ceil((max(block.shape) - 1) / most) for block in mesh.blocks), default=1)


def block_lines(mesh: QuadMesh, block: int, step: int) -> list[Array]:
    """Every ``step``-th line of a block in both directions, its four edges among them; shape ``(nodes, 2)`` each."""
    numbers = mesh.blocks[block]
    rows, columns = (np.unique([*range(0, n, step), n - 1]) for n in numbers.shape)
    return [mesh.points[numbers[i]] for i in rows] + [mesh.points[numbers[:, j]] for j in columns]


def outlines(mesh: QuadMesh) -> list[Array]:
    """The four edges of every block, shape ``(nodes, 2)`` each."""
    edges = [(block[0], block[-1], block[:, 0], block[:, -1]) for block in mesh.blocks]
    return [mesh.points[line] for four in edges for line in four]


def all_edges(mesh: QuadMesh) -> list[Array]:
    """The edges of all cells, for a mesh whose blocks are not known; one closed line for each cell."""
    return [*mesh.points[np.column_stack([mesh.cells, mesh.cells[:, 0]])]]


def drawn_lines(mesh: QuadMesh, most: int) -> tuple[list[Array], int]:
    """The lines of all blocks, about ``most`` in a direction of each, and every how many lines one is drawn."""
    if not mesh.blocks:
        return all_edges(mesh), 1
    step = step_of(mesh, most)
    return [line for k in range(len(mesh.blocks)) for line in block_lines(mesh, k, step)], step


def colour_cells(axes: Axes, mesh: Mesh | QuadMesh, values: Array, **style: Any) -> ScalarMappable:
    """Draw every cell with the colour of its value, an array of the ``cell_shape`` of the mesh, perhaps masked.

    ``style`` is that of matplotlib's ``pcolormesh``, with a ``norm``.
    """
    if isinstance(mesh, Mesh):
        return axes.pcolormesh(mesh.x, mesh.y, values, **style)
    if not mesh.blocks:
        from matplotlib.collections import PolyCollection

        cells = PolyCollection([*mesh.points[mesh.cells]], array=values, edgecolors="face", linewidths=0.1, **style)
        axes.add_collection(cells)
        return cells
    drawn = [
        axes.pcolormesh(mesh.x[block], mesh.y[block], values[cells], **style)
        for block, cells in zip(mesh.blocks, mesh.block_cells, strict=True)
    ]
    return drawn[0]


def owners_of_blocks(mesh: QuadMesh, of_cell: IntArray) -> list[int] | None:
    """The subdomain of every block; ``None`` where a block has cells of several."""
    owners = []
    for cells in mesh.block_cells:
        found = np.unique(of_cell[cells])
        if len(found) > 1:
            return None
        owners.append(int(found[0]))
    return owners
