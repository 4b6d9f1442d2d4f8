"""The gradient map by nested iteration: from a coarse grid to the requested one.

Where the shares of a density do not become equal, the map is that of a weaker density: a power of it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import scipy

from equimesh.domains.domain import Domain
from equimesh.equations.problem import Problem
from equimesh.meshes.mesh import Grid, Mesh
from equimesh.monitors.monitor import Monitor
from equimesh.numerics.compiled import compiled, vectorised
from equimesh.numerics.types import Array
from equimesh.single_domain.continuation import Relaxation
from equimesh.single_domain.level import Step

# The compiled loops of the gradient map.
#
# The potential ``phi`` has one value for each cell. A node moves by the gradient of the bilinear interpolant in the
# middle of its four cells; beyond a side the values are those of the cells at the side, so nodes stay on their sides.
# Cells that differ in turns, as on a chess board, move no node.


@compiled
def move_nodes(phi: Array, along: float, across: float, x: Array, y: Array) -> None:
    """Write the nodes of the reference square, shape ``(n_xi, n_eta)``, that the potential gives.

    ``along`` and ``across`` scale the two partial derivatives.
    """
    cells_xi, cells_eta = phi.shape
    by_xi, by_eta = 0.5 * along * cells_xi, 0.5 * across * cells_eta
    for i in range(cells_xi + 1):
        west, east = max(i - 1, 0), min(i, cells_xi - 1)
        for j in range(cells_eta + 1):
            south, north = max(j - 1, 0), min(j, cells_eta - 1)
            first = phi[east, north] - phi[west, south]
            second = phi[east, south] - phi[west, north]
            x[i, j] = i / cells_xi + by_xi * (first + second)
            y[i, j] = j / cells_eta + by_eta * (first - second)


@compiled
def measure_cells(x: Array, y: Array, area: Array) -> float:
    """Write the areas of the cells over that of a cell of the uniform mesh; returns the smallest corner Jacobian.

    The Jacobians have the same unit: all are 1 on the uniform mesh. The result is NaN where a node is not finite.
    """
    smallest, unit = np.inf, float(area.size)
    for i in range(area.shape[0]):
        for j in range(area.shape[1]):
            x00, x10, x11, x01 = x[i, j], x[i + 1, j], x[i + 1, j + 1], x[i, j + 1]
            y00, y10, y11, y01 = y[i, j], y[i + 1, j], y[i + 1, j + 1], y[i, j + 1]
            a = (x10 - x00) * (y01 - y00) - (x01 - x00) * (y10 - y00)
            b = (x10 - x00) * (y11 - y10) - (x11 - x10) * (y10 - y00)
            c = (x11 - x01) * (y11 - y10) - (x11 - x10) * (y11 - y01)
            d = (x11 - x01) * (y01 - y00) - (x01 - x00) * (y11 - y01)
            area[i, j] = 0.25 * (a + b + c + d) * unit
            if np.isnan(area[i, j]):
                return np.nan
            smallest = min(smallest, a, b, c, d)
    return smallest * unit


@compiled
def look_up(table: Array, x: Array, y: Array, out: Array) -> None:
    """Write the densities at the centres of the cells with these nodes, from a ``table`` over the unit square."""
    last_xi, last_eta = table.shape[0] - 1, table.shape[1] - 1
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            a = 0.25 * (x[i, j] + x[i + 1, j] + x[i + 1, j + 1] + x[i, j + 1]) * last_xi
            b = 0.25 * (y[i, j] + y[i + 1, j] + y[i + 1, j + 1] + y[i, j + 1]) * last_eta
            k, m = min(max(int(a), 0), last_xi - 1), min(max(int(b), 0), last_eta - 1)
            s, t = a - k, b - m
            low = (1.0 - s) * table[k, m] + s * table[k + 1, m]
            high = (1.0 - s) * table[k, m + 1] + s * table[k + 1, m + 1]
            out[i, j] = (1.0 - t) * low + t * high


@compiled
def average(values: Array, work: Array, mirrored: bool) -> None:
    """Average ``values`` over neighbours in both directions, with weights 1/4, 1/2, 1/4; ``work`` is overwritten.

    Beyond a side lies the value at the side, or the second one if ``mirrored``: that keeps the integral of values at
    cells, or at nodes.
    """
    rows, columns = values.shape
    shift = 1 if mirrored else 0
    for i in range(rows):
        before = i - 1 if i > 0 else shift
        after = i + 1 if i < rows - 1 else rows - 1 - shift
        for j in range(columns):
            work[i, j] = 0.25 * (values[before, j] + values[after, j]) + 0.5 * values[i, j]
    for i in range(rows):
        for j in range(columns):
            before = j - 1 if j > 0 else shift
            after = j + 1 if j < columns - 1 else columns - 1 - shift
            values[i, j] = 0.25 * (work[i, before] + work[i, after]) + 0.5 * work[i, j]


@vectorised
def product(one: Array, other: Array) -> float:
    """The inner product of two arrays of one shape, on one thread."""
    result = 0.0
    for i in range(one.shape[0]):
        for j in range(one.shape[1]):
            result += one[i, j] * other[i, j]
    return result


# The density of a monitor on the reference square, as tables for grids of all sizes.

MIN_TABLE_CELLS = 128
"""Cells a side of the table, at least: a density that is thinner than the cells of a coarse grid is seen."""
MAX_TABLE_CELLS = 1024
"""Cells a side of the table, at most."""
MIN_DENSITY_SHARE = 1e-12
"""Smaller densities count as this share of the largest."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Density:
    """``sqrt(det M)`` times the Jacobian of the domain's map, at the nodes of a uniform grid of the reference square.

    ``table`` has shape ``(m_xi + 1, m_eta + 1)``, both m powers of 2, and a largest value of 1. ``extents`` are the
    mean lengths of the images of the lines along xi and along eta.
    """

    table: Array
    extents: tuple[float, float]

    @classmethod
    def of(cls, monitor: Monitor, domain: Domain, grid: Grid) -> Density:
        """The density of a bound monitor, on a table fine enough for ``grid``."""
        axes = [np.linspace(0.0, 1.0, _table_cells(n - 1) + 1) for n in grid.shape]
        s, t = np.meshgrid(*axes, indexing="ij")
        m11, m12, m22 = monitor.metric(*domain.map(s, t))
        x_s, x_t, y_s, y_t = domain.jacobian(s, t)
        density = np.sqrt(m11 * m22 - m12**2) * (x_s * y_t - x_t * y_s)
        density /= density.max()
        extents = float(np.hypot(x_s, y_s).mean()), float(np.hypot(x_t, y_t).mean())
        return cls(table=np.maximum(density, MIN_DENSITY_SHARE), extents=extents)

    @property
    def is_finite(self) -> bool:
        """Whether the density is finite everywhere."""
        return bool(np.isfinite(self.table).all())

    def on(self, grid: Grid) -> Array:
        """The table for the cells of ``grid``, averaged so that no detail is much finer than its cells."""
        table = self.table
        for axis, n in enumerate(grid.shape):
            while table.shape[axis] - 1 >= 2 * (n - 1):
                table = _halved(table, axis)
        smooth = np.array(table, order="C")
        average(smooth, np.empty_like(smooth), True)
        return smooth


def _table_cells(cells: int) -> int:
    """The smallest power of 2 that is enough, within the limits."""
    return int(min(max(1 << (cells - 1).bit_length(), MIN_TABLE_CELLS), MAX_TABLE_CELLS))


def _halved(table: Array, axis: int) -> Array:
    """Every second node along an axis, with the average of its neighbourhood."""
    rows = np.moveaxis(table, axis, 0)
    half = 0.5 * rows[::2]
    half[1:-1] += 0.25 * (rows[1:-2:2] + rows[3::2])
    half[0] += 0.5 * rows[1]
    half[-1] += 0.5 * rows[-2]
    result: Array = np.moveaxis(half, 0, axis)
    return result


# The gradient map on one grid: an iteration for the equation of Monge and Ampere.
#
# The map ``x = xi + grad phi`` is sought for which all cells have equal shares ``m = rho J`` of the density, J the
# area of the cell. As in C. J. Budd and J. F. Williams, *Moving mesh generation using the parabolic Monge-Ampere
# equation* (SIAM J. Sci. Comput. 31, 2009), phi moves with the velocity that
#
# (I - gamma Laplacian) phi_t = sqrt(m) - mean,
#
# with cosine transforms for the inverse. Time is only the counter of an iteration, so steps are accelerated by
# Anderson's method. Densities are averaged over neighbouring cells of the mesh: sizes of neighbours then differ
# little.

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
        transformed = scipy.fft.dctn(values, type=2)
        transformed *= self._inverse
        result: Array = scipy.fft.idctn(transformed, type=2, overwrite_x=True)
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


MAX_COARSEST_CELLS = 15
"""Cells a side of the coarsest grid, at most."""
WEAKENING = 0.8
"""The power of a density that is tried next where the iteration fails."""
MIN_STRENGTH = 0.05
"""Smaller powers are not tried."""


def gradient_map_steps(problem: Problem) -> Iterator[Step]:
    """The steps up the nested grids to the gradient map of the problem's monitor.

    The last step has ``converged`` or ``failed`` set; its mesh is valid in any case. ``residual`` is the root mean
    square of the relative deviations of the cells' shares of the density from their mean.
    """
    yield from _climb(problem.monitor, problem.domain, problem.grid)


def _climb(monitor: Monitor, domain: Domain, grid: Grid) -> Iterator[Step]:
    density = Density.of(monitor, domain, grid)
    grids = _grids(grid)
    phi, strength = np.zeros(tuple(n - 1 for n in grids[0].shape)), 1.0
    if not density.is_finite:
        yield replace(_step(0, [grid], Mesh.uniform(grid)), failed=True)
        return
    for level, here in enumerate(grids):
        table, phi = density.on(here), _lifted(phi, here)
        strength = min(1.0, strength / WEAKENING)
        count = 0
        while True:
            weak = table if strength == 1.0 else table**strength
            placed = None
            for placed in MapLevel(grid=here, table=weak, extents=density.extents).steps(phi):
                yield _step(level, grids, _mesh(placed), count, placed.deviation, strength)
                count += 1
            if placed is None:
                raise AssertionError("the iteration yields at least its start")
            phi, deviation = placed.phi, placed.deviation
            if deviation <= MAX_DEVIATION:
                break
            strength *= WEAKENING
            if strength < MIN_STRENGTH:
                yield replace(_step(level, grids, Mesh.uniform(grid), count, deviation, 0.0), failed=True)
                return
        yield replace(_step(level, grids, _mesh(placed), count - 1, deviation, strength), converged=True)


def _step(
    level: int,
    grids: list[Grid],
    mesh: Mesh,
    count: int = 0,
    deviation: float = np.nan,
    strength: float = 1.0,
) -> Step:
    return Step(
        level=level,
        levels=len(grids),
        grid=mesh.grid,
        step=count,
        residual=deviation,
        mesh=mesh,
        relaxation=Relaxation(strength=strength),
    )


def _mesh(placed: Placed) -> Mesh:
    return Mesh(placed.x, placed.y)


def _grids(grid: Grid) -> list[Grid]:
    """Grids from coarse to fine, each with half the cells of the next in directions that have many."""
    grids = [grid]
    while max(grids[0].shape) - 1 > MAX_COARSEST_CELLS:
        n_xi, n_eta = (n // 2 + 1 if n - 1 > MAX_COARSEST_CELLS else n for n in grids[0].shape)
        grids.insert(0, Grid(n_xi=n_xi, n_eta=n_eta))
    return grids


def _lifted(phi: Array, grid: Grid) -> Array:
    """The potential on the cells of a finer grid: the same sum of cosines."""
    shape = tuple(n - 1 for n in grid.shape)
    if phi.shape == shape:
        return phi
    waves = np.zeros(shape)
    waves[: phi.shape[0], : phi.shape[1]] = scipy.fft.dctn(phi, type=2, norm="ortho")
    finer: Array = scipy.fft.idctn(waves, type=2, norm="ortho") * np.sqrt(waves.size / phi.size)
    return finer
