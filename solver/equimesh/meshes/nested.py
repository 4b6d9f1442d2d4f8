"""Nested grids, from coarse to fine, and the interpolation of a mesh from one to the next."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from equimesh.meshes.grid import MIN_POINTS, Grid
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array, IntArray

MAX_COARSEST_POINTS = 17  # of the coarsest grid, in each direction
# Cells of one direction over those of the other, up to which their numbers are alike.
MAX_SQUARE_RATIO = 1.25


def nested_grids(grid: Grid) -> list[Grid]:
    """Grids from coarse to fine, each with about half the cells a side of the next, down to 17 points or fewer."""
    grids = [grid]
    while max(grids[0].shape) > MAX_COARSEST_POINTS:
        grids.insert(0, halved(grids[0]))
    return grids


def square_grids(grid: Grid) -> list[Grid]:
    """Nested grids to ``grid`` that have like numbers of points in both directions for as long as possible.

    The direction with fewer points reaches its number first, and stays there. :func:`nested_grids` where the numbers
    are like from the beginning.
    """
    most, least = max(grid.shape), min(grid.shape)
    if most - 1 <= MAX_SQUARE_RATIO * (least - 1):
        return nested_grids(grid)
    sizes = [square.n_xi for square in nested_grids(Grid(n_xi=most, n_eta=most))]
    return [Grid(n_xi=min(size, grid.n_xi), n_eta=min(size, grid.n_eta)) for size in sizes]


def halved(grid: Grid) -> Grid:
    """The grid with about half the cells a side, in directions with enough points."""
    n_xi, n_eta = (n // 2 + 1 if n >= 2 * MIN_POINTS else n for n in grid.shape)
    return Grid(n_xi=n_xi, n_eta=n_eta)


def prolong(mesh: Mesh, grid: Grid, coarser: Mesh | None = None) -> Mesh:
    """The mesh interpolated to another grid: cubic, else linear if that folds, else the uniform mesh.

    With ``coarser``, the solution on the next coarser grid, the difference of the two is extrapolated. For a method of
    second order the result is nearer to the solution than the interpolant alone.
    """
    shape = grid.shape
    if coarser is not None:
        candidate = _interpolated(_extrapolated(mesh, coarser, grid), shape, _CUBIC)
        if not candidate.is_folded:
            return candidate
    for width in (_CUBIC, _LINEAR):
        candidate = _interpolated(mesh, shape, width)
        if not candidate.is_folded:
            return candidate
    return Mesh.uniform(grid)


def distance(mesh: Mesh, coarse: Mesh) -> float:
    """Largest difference of a coordinate between a mesh and the cubic interpolant of one on a coarser grid.

    Where every other node lies on the coarser grid, at those nodes.
    """
    steps = [(fine - 1) // (rough - 1) for fine, rough in zip(mesh.x.shape, coarse.x.shape, strict=True)]
    if mesh.x[:: steps[0], :: steps[1]].shape == coarse.x.shape:
        common = (slice(None, None, steps[0]), slice(None, None, steps[1]))
        pairs = ((mesh.x[common], coarse.x), (mesh.y[common], coarse.y))
        return max(float(np.abs(one - other).max()) for one, other in pairs)
    rules = [_rule(m, n, _CUBIC) for m, n in zip(coarse.x.shape, mesh.x.shape, strict=True)]
    pairs = ((coarse.x, mesh.x), (coarse.y, mesh.y))
    return max(interpolate(q, *rules[0], *rules[1], fine, False) for q, fine in pairs)


def refinement(fine: Grid, coarse: Grid) -> float:
    """The square of the ratio of the spacings: the factor by which an error of second order falls."""
    return max(coarse.d_xi / fine.d_xi, coarse.d_eta / fine.d_eta) ** 2


def is_refined(fine: Grid, coarse: Grid) -> bool:
    """Whether the spacing is smaller in both directions: only then does the difference of two meshes show its error."""
    return fine.n_xi > coarse.n_xi and fine.n_eta > coarse.n_eta


_CUBIC, _LINEAR = 4, 2


def _extrapolated(mesh: Mesh, coarser: Mesh, grid: Grid) -> Mesh:
    """The mesh plus the expected difference to the solution on the finer ``grid``."""
    here, before = refinement(grid, mesh.grid), refinement(mesh.grid, coarser.grid)
    share = (1.0 - 1.0 / here) / (before - 1.0)
    lifted = _interpolated(coarser, mesh.x.shape, _CUBIC)
    return Mesh(mesh.x + share * (mesh.x - lifted.x), mesh.y + share * (mesh.y - lifted.y))


def interpolated_values(values: Array, shape: tuple[int, ...], *, cubic: bool = True) -> Array:
    """Nodal ``values`` of shape ``(n_xi, n_eta)`` on a grid of another shape, by cubic or linear interpolation."""
    rules = [_rule(m, n, _CUBIC if cubic else _LINEAR) for m, n in zip(values.shape, shape, strict=True)]
    fine = np.empty(shape)
    interpolate(np.ascontiguousarray(values), *rules[0], *rules[1], fine, True)
    return fine


def _interpolated(mesh: Mesh, shape: tuple[int, ...], width: int) -> Mesh:
    x, y = (interpolated_values(q, shape, cubic=width == _CUBIC) for q in (mesh.x, mesh.y))
    x[0], x[-1], y[:, 0], y[:, -1] = 0.0, 1.0, 0.0, 1.0
    return Mesh(x, y)


@dataclass(frozen=True)
class _Points:
    """The points of one uniform grid of [0, 1] on another: the cell, and the place in it."""

    cell: IntArray
    place: Array

    @classmethod
    def of(cls, coarse: int, fine: int) -> _Points:
        at = np.arange(fine) * (coarse - 1) / (fine - 1)
        cell = np.minimum(at.astype(np.int64), coarse - 2)
        return cls(cell, at - cell)


@lru_cache(maxsize=64)
def _rule(coarse: int, fine: int, width: int) -> tuple[IntArray, Array]:
    """First coarse points and Lagrange weights, of shape ``(fine, width)``, for every point of a finer uniform grid."""
    points = _Points.of(coarse, fine)
    first = np.clip(points.cell - (width // 2 - 1), 0, coarse - width)
    at = (points.cell - first) + points.place
    weights = np.ones((fine, width))
    for k in range(width):
        for other in range(width):
            if other != k:
                weights[:, k] *= (at - other) / (k - other)
    first.setflags(write=False)
    weights.setflags(write=False)
    return first, weights


@compiled
def interpolate(
    coarse: Array,
    xi_at: IntArray,
    xi_weights: Array,
    eta_at: IntArray,
    eta_weights: Array,
    fine: Array,
    write: bool,
) -> float:
    """Nodal values on a finer grid, in ``fine``, by a product of one-dimensional rules.

    Row i of the fine grid takes ``xi_weights[i]`` of the coarse rows from ``xi_at[i]`` on, likewise in eta. Returns the
    largest difference to the previous values of ``fine``, which are kept if ``write`` is false.
    """
    rows, columns = fine.shape
    width = xi_weights.shape[1]
    # Coarse rows, interpolated along eta when they are first needed; row r is held in lines[r % width].
    lines, ready, largest = np.empty((width, columns)), 0, 0.0
    row = np.empty(columns)
    for i in range(rows):
        first = xi_at[i]
        for r in range(max(ready, first), first + width):
            source, line = coarse[r], lines[r % width]
            for j in range(columns):
                value, at = 0.0, eta_at[j]
                for k in range(width):
                    value += eta_weights[j, k] * source[at + k]
                line[j] = value
        ready = first + width
        row[:] = 0.0
        for k in range(width):
            weight, line = xi_weights[i, k], lines[(first + k) % width]
            for j in range(columns):
                row[j] += weight * line[j]
        target = fine[i]
        for j in range(columns):
            largest = max(largest, abs(row[j] - target[j]))
        if write:
            target[:] = row
    return largest
