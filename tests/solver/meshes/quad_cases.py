"""Meshes of quadrilaterals for tests: three blocks around a corner, a disc of five blocks, a ring, a periodic strip."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np

from equimesh.meshes.cell_edges import links_of, quads_of_block
from equimesh.meshes.mesh import Mesh

CORE = 0.35  # half the side of the square in the disc


def merged(blocks: Sequence[tuple[np.ndarray, np.ndarray]]) -> Mesh:
    """The mesh of blocks of points, of which equal ones are one node."""
    points = np.concatenate([np.column_stack([x.ravel(), y.ravel()]) for x, y in blocks])
    _, first, number = np.unique(np.round(points, 9), axis=0, return_index=True, return_inverse=True)
    ends = np.cumsum([x.size for x, _ in blocks])
    parts = np.split(number.reshape(-1), ends[:-1])
    nodes = tuple(part.reshape(x.shape) for part, (x, _) in zip(parts, blocks, strict=True))
    cells = np.concatenate([quads_of_block(block) for block in nodes])
    return Mesh(points=points[first], cells=cells, sides={}, blocks=nodes)


def box(x: tuple[float, float], y: tuple[float, float], n: int) -> tuple[np.ndarray, np.ndarray]:
    """A uniform block of n x n cells."""
    x_all, y_all = np.meshgrid(np.linspace(*x, n + 1), np.linspace(*y, n + 1), indexing="ij")
    return x_all, y_all


@cache
def corner(n: int) -> Mesh:
    """An L of three squares of n x n cells."""
    return merged([box((0, 1), (0, 1), n), box((1, 2), (0, 1), n), box((0, 1), (1, 2), n)])


@cache
def disc(n: int) -> Mesh:
    """The unit disc in five blocks of n x n cells: three cells meet in each corner of the square within."""
    t, blocks = np.linspace(0, 1, n + 1), [box((-CORE, CORE), (-CORE, CORE), n)]
    ends = CORE * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    for k in range(4):
        inner = np.outer(1 - t, ends[k]) + np.outer(t, ends[(k + 1) % 4])
        angle = (2 * k - 3) * np.pi / 4 + t * np.pi / 2
        outer = np.column_stack([np.cos(angle), np.sin(angle)])
        points = outer[:, None] * (1 - t[None, :, None]) + inner[:, None] * t[None, :, None]
        blocks.append((points[..., 0], points[..., 1]))
    return merged(blocks)


@cache
def ring(n: int) -> Mesh:
    """A closed ring of n x 4n cells with the radii 0.5 and 1."""
    radius, angle = np.meshgrid(np.linspace(0.5, 1, n + 1), np.linspace(0, 2 * np.pi, 4 * n + 1), indexing="ij")
    return merged([(radius * np.cos(angle), radius * np.sin(angle))])


def strip(n: int, shift: float = 0.0, wave: float = 0.0, *, both: bool = False) -> Mesh:
    """The unit square of n x n cells, periodic along x or both ways; its seams are shifted and bent."""
    x, y = box((0, 1), (0, 1), n)
    across = wave * np.sin(2 * np.pi * x) if both else 0.0
    x, y = x + shift + wave * np.sin(2 * np.pi * y) + 0.3 * wave * np.sin(2 * np.pi * x), y + across
    number = np.arange(x.size).reshape(x.shape)
    ties = [np.column_stack([number[-1], number[0]])]
    if both:
        ties.append(np.column_stack([number[:-1, -1], number[:-1, 0]]))
    return Mesh(
        points=np.column_stack([x.ravel(), y.ravel()]),
        cells=quads_of_block(number),
        sides={},
        blocks=(number,),
        ties=np.concatenate(ties),
    )


def bent(mesh: Mesh, size: float) -> Mesh:
    """The mesh with its inner nodes moved by a smooth function of this size."""
    links = links_of(mesh.cells, len(mesh.points))
    edges, inner = links.boundary(), np.ones(len(mesh.points))
    for step in (0, 1):
        inner[mesh.cells[edges // 4, (edges + step) % 4]] = 0.0
    move = np.column_stack([np.sin(3 * mesh.y), np.cos(4 * mesh.x)])
    return mesh.moved(mesh.points + size * inner[:, None] * move)


def turned(mesh: Mesh, angle: float) -> Mesh:
    """The mesh turned around the origin."""
    c, s = np.cos(angle), np.sin(angle)
    return mesh.moved(mesh.points @ np.array([[c, s], [-s, c]]))


def inner_points(mesh: Mesh, count: int = 500) -> np.ndarray:
    """Points in the cells of a mesh, in no order, shape ``(count, 2)``."""
    rng = np.random.default_rng(3)
    corners = mesh.points[mesh.cells[rng.integers(0, len(mesh.cells), count)]]
    return (corners * rng.dirichlet(np.ones(4), count)[..., None]).sum(axis=1)
