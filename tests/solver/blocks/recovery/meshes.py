"""Meshes of quadrilaterals with irregular nodes, for the tests of their blocks."""

from __future__ import annotations

import numpy as np

from equimesh.numerics.types import Array, IntArray

Arrays = tuple[Array, IntArray]


def grid(n: int, m: int) -> Arrays:
    """The unit square with ``n`` by ``m`` cells; node ``(i, j)`` is ``i (m + 1) + j``."""
    i, j = np.meshgrid(np.arange(n + 1), np.arange(m + 1), indexing="ij")
    points = np.stack([i / n, j / m], axis=-1).reshape(-1, 2)
    number = np.arange((n + 1) * (m + 1)).reshape(n + 1, m + 1)
    corners = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    return points, np.stack([corner.ravel() for corner in corners], axis=1)


def without(mesh: Arrays, hole: tuple[float, float, float, float]) -> Arrays:
    """The mesh without the cells whose middle is in a box ``x0, x1, y0, y1``, and without nodes of no cell."""
    points, cells = mesh
    x, y = points[cells].mean(axis=1).T
    inside = (x > hole[0]) & (x < hole[1]) & (y > hole[2]) & (y < hole[3])
    kept = cells[~inside]
    used = np.unique(kept)
    return points[used], np.searchsorted(used, kept)


def disc(n: int) -> Arrays:
    """A square of ``n`` by ``n`` cells in four blocks of ``n`` by ``n`` around it: four nodes of three cells."""
    points, cells = grid(n, n)
    points = points - 0.5
    places, quads = [points], [cells]
    ring = np.concatenate(
        [[k * (n + 1) for k in range(n)], [n * (n + 1) + k for k in range(n)],
         [(n - k) * (n + 1) + n for k in range(n)], [n - k for k in range(n)]]
    )  # fmt: skip
    angle = -0.75 * np.pi + 0.5 * np.pi * np.arange(4 * n) / n
    rim = 1.5 * np.column_stack([np.cos(angle), np.sin(angle)])
    below, count = ring, len(points)
    for k in range(1, n + 1):
        places.append(points[ring] + (rim - points[ring]) * k / n)
        above = count + np.arange(4 * n)
        quads.append(np.column_stack([below, above, np.roll(above, -1), np.roll(below, -1)]))
        below, count = above, count + 4 * n
    return np.concatenate(places), np.concatenate(quads)


def ring(n: int, m: int) -> Arrays:
    """A ring with ``n`` cells around and ``m`` across; node ``(i, j)`` is ``i (m + 1) + j``, i around."""
    angle, radius = 2 * np.pi * np.arange(n) / n, 1 + np.arange(m + 1) / m
    points = np.stack([radius * np.cos(angle)[:, None], radius * np.sin(angle)[:, None]], axis=-1).reshape(-1, 2)
    number = np.arange(n * (m + 1)).reshape(n, m + 1)
    after = np.roll(number, -1, axis=0)
    corners = number[:, :-1], number[:, 1:], after[:, 1:], after[:, :-1]
    return points, np.stack([corner.ravel() for corner in corners], axis=1)


def boundary_of(mesh: Arrays) -> IntArray:
    """The edges of one cell alone, in the direction of this cell."""
    _, cells = mesh
    edges = np.stack([cells, np.roll(cells, -1, axis=1)], axis=-1).reshape(-1, 2)
    _, place, count = np.unique(np.sort(edges, axis=1), axis=0, return_index=True, return_counts=True)
    return edges[np.sort(place[count == 1])]
