"""The gradient map on one grid: an iteration for the equation of Monge and Ampere.

The map ``x = xi + grad phi`` is sought for which all cells have equal shares ``m = rho J`` of the density, J the area
of the cell. As in C. J. Budd and J. F. Williams, *Moving mesh generation using the parabolic Monge-Ampere equation*
(SIAM J. Sci. Comput. 31, 2009), phi moves with the velocity that

    (I - gamma Laplacian) phi_t = sqrt(m) - mean,

with cosine transforms for the inverse. Time is only the counter of an iteration, so steps are accelerated by Anderson's
method. Densities are averaged over neighbouring cells of the mesh: sizes of neighbours then differ little.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from scipy.fft import dctn, idctn

from equimesh.gradient_map.kernels import average, look_up, measure_cells, move_nodes, product
from equimesh.meshes.grid import Grid
from equimesh.numerics.types import Array

SMOOTHING = 0.1
"""gamma, in units of the area of the domain."""
TIME_STEP = 0.1
"""The time of a step, where it is not shortened."""
MIN_TIME_STEP = 0.0005
"""A shorter time means that the iteration fails."""
TIME_GROWTH = 1.15
"""A step that succeeds may be longer than the one before by this factor."""
MAX_DEVIATION = 0.03
"""The root mean square of the relative deviations of the shares from their mean, on a solution."""
MAX_MOVES = 200
"""Meshes that are tried on one grid."""
MAX_SHORTENED = 3
"""Times that a step is halved where it leads to a folded mesh."""
MAX_GROWTH = 1.5
"""A step may lead to a deviation that is larger than the smallest so far by this factor."""
MIN_JACOBIAN = 1e-4
"""The smallest corner Jacobian of an accepted mesh, 1 on the uniform mesh."""
PASSES = 4
"""Times that densities are averaged over neighbouring cells."""
DEPTH = 8
"""Steps that Anderson's method remembers."""
MAX_REMEMBERED = 32_000_000
"""Numbers that it remembers, at most: fewer steps on large grids."""
RIDGE = 1e-10
"""Share of the trace that is added to the matrix of its least squares."""
SHRINKING = 0.7
"""A potential that folds the mesh is multiplied by this until it does not. A smaller gradient never folds more."""
MAX_SHRINKINGS = 20
"""Times that this is tried."""


class Placed(NamedTuple):
    """A mesh of the reference square: its potential, its nodes, and how far shares deviate from their mean."""

    phi: Array
    x: Array
    y: Array
    shares: Array
    deviation: float


@dataclass(frozen=True, kw_only=True, eq=False)
class MapLevel:
    """The iteration on the cells of ``grid``, for the density ``table`` and the ``extents`` of the domain."""

    grid: Grid
    table: Array
    extents: tuple[float, float]
    _inverse: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        along, across = self._scales
        eigenvalues = [_laplacian(n - 1) for n in self.grid.shape]
        sums = along * eigenvalues[0][:, None] + across * eigenvalues[1]
        object.__setattr__(self, "_inverse", 1.0 / (1.0 + SMOOTHING * sums))

    @property
    def _scales(self) -> tuple[float, float]:
        """The factors of the partial derivatives: a gradient of the physical domain, with an area of 1."""
        width, height = self.extents
        return height / width, width / height

    def place(self, phi: Array) -> Placed | None:
        """The mesh of a potential; ``None`` where a cell is folded, or nearly."""
        x, y = np.empty(self.grid.shape), np.empty(self.grid.shape)
        move_nodes(phi, *self._scales, x, y)
        area = np.empty(phi.shape)
        if not measure_cells(x, y, area) > MIN_JACOBIAN:
            return None
        shares = np.empty(phi.shape)
        look_up(self.table, x, y, shares)
        work = np.empty(phi.shape)
        for _ in range(PASSES):
            average(shares, work, False)
        shares *= area
        shares /= shares.mean()
        return Placed(phi, x, y, shares, float(np.sqrt(np.mean((shares - 1.0) ** 2))))

    def start(self, phi: Array) -> Placed:
        """The mesh of a potential, or of the part of it that does not fold the mesh."""
        for _ in range(MAX_SHRINKINGS):
            placed = self.place(phi)
            if placed is not None:
                return placed
            phi = SHRINKING * phi
        uniform = self.place(np.zeros_like(phi))
        if uniform is None:
            raise AssertionError("the uniform mesh does not fold")
        return uniform

    def steps(self, phi: Array) -> Iterator[Placed]:
        """The meshes of the iteration, each better than those before; the first is that of ``phi``.

        The last one is a solution if its deviation is at most ``MAX_DEVIATION``.
        """
        best = here = self.start(phi)
        yield best
        moves, time, memory = 0, TIME_STEP, _Memory(phi.size)
        while best.deviation > MAX_DEVIATION and moves < MAX_MOVES and time >= MIN_TIME_STEP:
            velocity = np.sqrt(here.shares)
            move = self._inverted(velocity - velocity.mean()) * time
            reached, tried = self._advance(here, memory.accelerated(here.phi, move))
            moves += tried
            if reached is None or reached.deviation > MAX_GROWTH * best.deviation:
                time, here = 0.5 * time, best
                memory.clear()
                continue
            here = reached
            if reached.deviation < best.deviation:
                best = reached
                time = min(TIME_GROWTH * time, TIME_STEP) if memory.is_empty else time
                yield best

    def _advance(self, here: Placed, move: Array) -> tuple[Placed | None, int]:
        """The mesh after the move or a part of it that does not fold, and the number of meshes tried."""
        for tried in range(1, MAX_SHORTENED + 1):
            reached = self.place(here.phi + move)
            if reached is not None:
                return reached, tried
            move = 0.5 * move
        return None, MAX_SHORTENED

    def _inverted(self, values: Array) -> Array:
        """``(I - gamma Laplacian)^-1`` of values at cells."""
        transformed = dctn(values, type=2)
        transformed *= self._inverse
        result: Array = idctn(transformed, type=2, overwrite_x=True)
        return result


class _Memory:
    """Anderson's method: the combination of the last steps whose moves cancel best.

    D. G. Anderson, *Iterative procedures for nonlinear integral equations* (J. ACM 12, 1965).
    """

    def __init__(self, size: int) -> None:
        self._depth = max(min(DEPTH, MAX_REMEMBERED // (2 * size) - 1), 1)
        self._potentials: list[Array] = []
        self._moves: list[Array] = []

    @property
    def is_empty(self) -> bool:
        return not self._moves

    def clear(self) -> None:
        self._potentials, self._moves = [], []

    def accelerated(self, phi: Array, move: Array) -> Array:
        """The move to make from ``phi``, where the iteration would make ``move``."""
        self._potentials = [*self._potentials, phi][-self._depth - 1 :]
        self._moves = [*self._moves, move][-self._depth - 1 :]
        if len(self._moves) == 1:
            return move
        turns = [after - before for before, after in zip(self._moves, self._moves[1:], strict=False)]
        ways = [after - before for before, after in zip(self._potentials, self._potentials[1:], strict=False)]
        gram = np.array([[product(one, other) for other in turns] for one in turns])
        gram += RIDGE * np.trace(gram) * np.eye(len(turns))
        if not np.trace(gram) > 0.0:
            return move
        shares = np.linalg.solve(gram, [product(turn, move) for turn in turns])
        return move - sum((c * (way + turn) for c, way, turn in zip(shares, ways, turns, strict=True)), np.zeros(()))


def _laplacian(cells: int) -> Array:
    """The eigenvalues of minus the second difference over values at cells of a side of length 1."""
    values: Array = 2.0 * cells**2 * (1.0 - np.cos(np.pi * np.arange(cells) / cells))
    return values
