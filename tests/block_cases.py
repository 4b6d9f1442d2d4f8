"""Small meshes of blocks that tests share: a grid taken apart, and an L of three blocks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from equimesh.meshes.cell_edges import quads_of_block
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.mesh_data import MeshData
from equimesh.numerics.types import Array, IntArray


@dataclass(frozen=True, eq=False)
class InBlocks:
    """A grid as two blocks: node k is the node ``nodes[k]`` of the grid, cell k its cell ``cells[k]``, both flat."""

    mesh: Mesh
    nodes: IntArray
    cells: IntArray


def in_blocks(mesh: Mesh, column: int = 3, *, turned: bool = True) -> InBlocks:
    """The same mesh cut at a column of nodes, the nodes in another order, the second block turned by a right angle."""
    grid = np.arange(mesh.x.size).reshape(mesh.x.shape)
    nodes = np.random.default_rng(7).permutation(mesh.x.size)
    number = np.empty_like(nodes)
    number[nodes] = np.arange(nodes.size)
    of_grid = np.arange(len(mesh.cells)).reshape(mesh.cell_shape)
    turns = int(turned)
    blocks = number[grid[: column + 1]], np.ascontiguousarray(np.rot90(number[grid[column:]], turns))
    cells = np.concatenate([of_grid[:column].ravel(), np.rot90(of_grid[column:], turns).ravel()])
    whole = Mesh(
        points=mesh.points[nodes],
        cells=np.concatenate([quads_of_block(block) for block in blocks]),
        sides={f"the {side}": number[edges] for side, edges in mesh.sides.items()},
        blocks=blocks,
    )
    return InBlocks(whole, nodes, cells)


def l_shape(n: int = 5, *, bend: float = 0.1) -> Mesh:
    """The square of side 2 without its upper right quarter, ``n`` nodes on an edge of a block, with bent lines.

    The sides are ``inlet`` on the left, ``outlet`` at the lower right, and ``wall``.
    """
    places = {(i, j): k for k, (i, j) in enumerate(_nodes_of_l(n))}
    blocks = tuple(
        np.array([[places[i, j] for j in range(y, y + n)] for i in range(x, x + n)])
        for x, y in ((0, 0), (n - 1, 0), (0, n - 1))
    )
    x, y = np.array([*places]).T / (n - 1)
    bump = bend * np.sin(np.pi * x) * np.sin(np.pi * y)
    low, right, high = blocks
    lines = [low[:, 0], right[:, 0], right[::-1, -1], high[-1], high[::-1, -1]]
    walls = [np.column_stack([line[:-1], line[1:]]) for line in lines]
    left, end = np.concatenate([high[0, :0:-1], low[0, ::-1]]), right[-1]
    return Mesh(
        points=np.column_stack([x + bump, y - 0.5 * bump]),
        cells=np.concatenate([quads_of_block(block) for block in blocks]),
        sides={
            "inlet": np.column_stack([left[:-1], left[1:]]),
            "outlet": np.column_stack([end[:-1], end[1:]]),
            "wall": np.concatenate(walls),
        },
        blocks=blocks,
        block_names=("low", "right", "high"),
    )


def channel(n: int = 5) -> Mesh:
    """One bent block whose left and right sides are joined, with the sides ``floor`` and ``roof``."""
    x, y = np.meshgrid(np.linspace(0, 2, 2 * n), np.linspace(0, 1, n), indexing="ij")
    mesh = Mesh(x + 0.1 * np.sin(3 * y), y + 0.1 * np.sin(np.pi * x))
    block = np.arange(x.size).reshape(x.shape)
    return Mesh(
        points=mesh.points,
        cells=mesh.cells,
        sides={"floor": mesh.sides["bottom"], "roof": mesh.sides["top"]},
        blocks=(block,),
        ties=np.column_stack([block[-1], block[0]]),
    )


def joined_channel() -> Mesh:
    """The channel with names for the two sides that are joined."""
    mesh = channel()
    block = mesh.blocks[0]
    ends = {"in": block[0, ::-1], "out": block[-1]}
    sides = {name: np.column_stack([line[:-1], line[1:]]) for name, line in ends.items()}
    return changed(mesh, sides={**mesh.sides, **sides})


def changed(mesh: Mesh, **parts: Any) -> Mesh:
    """The mesh with some other ``parts``: points, cells, sides, blocks, block_names or ties."""
    names = ("points", "cells", "sides", "blocks", "block_names", "ties")
    return Mesh(**{**{name: getattr(mesh, name) for name in names}, **parts})


def data_of(mesh: Mesh) -> MeshData:
    """The mesh with u, the number of the block of each cell, a scalar and a vector at nodes and in cells."""
    subdomain = np.empty(len(mesh.cells), dtype=np.int64)
    for number, cells in enumerate(mesh.block_cells):
        subdomain[cells] = number
    middles: Array = mesh.points[mesh.cells].mean(axis=1)
    return MeshData(
        mesh=mesh,
        u=np.sin(3 * mesh.x) + mesh.y,
        q_eq=1.0 + 0.1 * middles[:, 0],
        subdomain=subdomain,
        fields={"rho": mesh.x * mesh.y, "flow": mesh.points - 1.0},
        cell_fields={"mean": middles[:, 1], "way": middles},
    )


def _nodes_of_l(n: int) -> list[tuple[int, int]]:
    last = 2 * (n - 1)
    return [(i, j) for i in range(last + 1) for j in range(last + 1) if i < n or j < n]
