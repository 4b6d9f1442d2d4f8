"""A mesh that some program made, and its measures: errors of interpolation, angles, folded cells, tags of the sides."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from costs import peers
from costs.quadrature import errors

import equimesh as em

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

LEFT, RIGHT, BOTTOM, TOP = 1, 2, 3, 4
"""The tags of the sides."""
ON_SIDE = 1e-9
"""A node with this distance from a side is on it."""


@dataclass(frozen=True, kw_only=True)
class Made:
    """A mesh of the unit square from some program, with the CPU seconds that the program took.

    ``points`` has shape ``(v, 2)``, ``cells`` ``(c, 3)`` or ``(c, 4)``, counter-clockwise. ``edges``, of shape
    ``(e, 2)``, are those which the program says are on the boundary, and ``tags`` their tags.
    """

    points: Array
    cells: IntArray
    edges: IntArray
    tags: IntArray
    seconds: float
    note: str = ""


@dataclass(frozen=True, kw_only=True)
class Measured:
    """The measures of one mesh. The errors are over those of the uniform mesh of quadrilaterals."""

    vertices: int
    l2: float
    h1: float
    seconds: float
    smallest_angle: float
    largest_angle: float
    folded: int
    sides_kept: int
    note: str

    @property
    def rate(self) -> float:
        """Vertices per second of CPU time."""
        return self.vertices / self.seconds


class Timer:
    """The CPU seconds of this process within blocks ``with timer.on():``."""

    seconds = 0.0

    @contextmanager
    def on(self) -> Iterator[None]:
        begun = time.process_time()
        try:
            yield
        finally:
            self.seconds += time.process_time() - begun


def uniform(n: int) -> Made:
    """The uniform mesh of ``n`` x ``n`` vertices, the cells quadrilaterals, the nodes of a column in a row."""
    mesh = em.Mesh.uniform(em.Grid(n_xi=n, n_eta=n))
    edges, tags = sides_of_grid(n)
    return Made(points=mesh.points, cells=mesh.cells.astype(np.int64), edges=edges, tags=tags, seconds=0.0)


def sides_of_grid(n: int) -> tuple[IntArray, IntArray]:
    """The edges on the sides of a grid whose nodes are numbered column by column, and their tags."""
    number = np.arange(n * n, dtype=np.int64).reshape(n, n)
    lines = {LEFT: number[0], RIGHT: number[-1], BOTTOM: number[:, 0], TOP: number[:, -1]}
    edges = np.concatenate([np.column_stack([line[:-1], line[1:]]) for line in lines.values()])
    return edges, np.repeat(np.array([*lines], dtype=np.int64), n - 1)


def split(cells: IntArray) -> IntArray:
    """Two triangles for each quadrilateral."""
    return np.concatenate([cells[:, [0, 1, 2]], cells[:, [0, 2, 3]]])


def with_vertices(make: Callable[[float], Made], n: int) -> Made:
    """The mesh of the scale of the metric that gives ``n`` x ``n`` vertices, to 3 percent."""
    scale = peers.first_scale(n)
    for _ in range(peers.MAX_ATTEMPTS):
        made = make(scale)
        if abs(len(made.points) / n**2 - 1.0) <= peers.MAX_VERTEX_DEVIATION_SHARE:
            break
        scale *= n**2 / len(made.points)
    return made


def measure(made: Made, u: em.Expression, n: int) -> Measured:
    """The measures of a mesh, next to the uniform one of ``n`` x ``n`` vertices."""

    def with_gradient(x: Array, y: Array) -> tuple[Array, ...]:
        return tuple(u.evaluate(x, y, order=1))

    reference = uniform(n)
    l2, h1 = errors(made.points, made.cells, with_gradient)
    uniform_l2, uniform_h1 = errors(reference.points, reference.cells, with_gradient)
    areas, angles = corners(made)
    return Measured(
        vertices=len(made.points),
        l2=l2 / uniform_l2,
        h1=h1 / uniform_h1,
        seconds=made.seconds,
        smallest_angle=float(angles.min()),
        largest_angle=float(angles.max()),
        folded=int((areas.min(axis=1) <= 0.0).sum()),
        sides_kept=sides_kept(made),
        note=made.note,
    )


def corners(made: Made) -> tuple[Array, Array]:
    """The oriented areas of the parallelograms at the corners of each cell, and the angles there in degrees."""
    nodes = made.points[made.cells]
    ahead, back = np.roll(nodes, -1, axis=1) - nodes, np.roll(nodes, 1, axis=1) - nodes
    areas = ahead[..., 0] * back[..., 1] - ahead[..., 1] * back[..., 0]
    angles = np.degrees(np.arctan2(areas, (ahead * back).sum(axis=2))) % 360.0
    return areas, angles


def sides_kept(made: Made) -> int:
    """How many of the four sides are covered by edges of their tag, and by no others."""
    kept = 0
    for tag, (axis, place) in {LEFT: (0, 0.0), RIGHT: (0, 1.0), BOTTOM: (1, 0.0), TOP: (1, 1.0)}.items():
        nodes = made.points[made.edges[made.tags == tag]]
        length = np.abs(nodes[:, 0] - nodes[:, 1]).sum(axis=0)[1 - axis]
        kept += bool(np.abs(nodes[..., axis] - place).max(initial=0.0) < ON_SIDE and abs(length - 1.0) < ON_SIDE)
    return kept
