"""Nested grids, from coarse to fine, and the prolongation of a mesh from one to the next."""

import numpy as np

from equimesh.meshes.folding import largest_difference
from equimesh.meshes.grid import MIN_POINTS, Grid
from equimesh.meshes.interpolation import extrapolate, interpolate, rules
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.parts import Parts

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


def prolong(mesh: Mesh, grid: Grid, coarser: Mesh | None = None, *, threads: int = 1) -> Mesh:
    """The mesh interpolated to another grid: cubic, else linear if that folds, else the uniform mesh.

    With ``coarser``, the solution on the next coarser grid, the difference of the two is extrapolated. For a method of
    second order the result is nearer to the solution than the interpolant alone. The ``threads`` share the rows.
    """
    if coarser is not None:
        candidate = _interpolated(_extrapolated(mesh, coarser, grid, threads), grid, threads)
        if not candidate.is_folded_on(threads):
            return candidate
    for cubic in (True, False):
        candidate = _interpolated(mesh, grid, threads, cubic=cubic)
        if not candidate.is_folded_on(threads):
            return candidate
    return Mesh.uniform(grid)


def distance(mesh: Mesh, coarse: Mesh, threads: int = 1) -> float:
    """Largest difference of a coordinate between a mesh and the cubic interpolant of one on a coarser grid.

    Where every other node lies on the coarser grid, at those nodes.
    """
    pairs = ((mesh.x, coarse.x), (mesh.y, coarse.y))
    steps = [(fine - 1) // (rough - 1) for fine, rough in zip(mesh.x.shape, coarse.x.shape, strict=True)]
    if mesh.x[:: steps[0], :: steps[1]].shape == coarse.x.shape:
        parts = Parts.of(coarse.x.shape, threads)
        common = [(fine[:: steps[0], :: steps[1]], rough) for fine, rough in pairs]
        return parts.largest(lambda part: max(largest_difference(a[part.rows], b[part.rows]) for a, b in common))
    along, parts = rules(coarse.x.shape, mesh.x.shape), Parts.of(mesh.x.shape, threads)
    return parts.largest(lambda part: max(interpolate(b, *along, part.ends, a, False) for a, b in pairs))


def refinement(fine: Grid, coarse: Grid) -> float:
    """The square of the ratio of the spacings: the factor by which an error of second order falls."""
    return max(coarse.d_xi / fine.d_xi, coarse.d_eta / fine.d_eta) ** 2


def is_refined(fine: Grid, coarse: Grid) -> bool:
    """Whether the spacing is smaller in both directions: only then does the difference of two meshes show its error."""
    return fine.n_xi > coarse.n_xi and fine.n_eta > coarse.n_eta


def _extrapolated(mesh: Mesh, coarser: Mesh, grid: Grid, threads: int) -> Mesh:
    """The mesh plus the expected difference to the solution on the finer ``grid``."""
    here, before = refinement(grid, mesh.grid), refinement(mesh.grid, coarser.grid)
    share = (1.0 - 1.0 / here) / (before - 1.0)
    lifted = _interpolated(coarser, mesh.grid, threads)
    pairs = ((mesh.x, lifted.x), (mesh.y, lifted.y))
    Parts.of(mesh.x.shape, threads).each(lambda part: [extrapolate(a, b, share, part.ends) for a, b in pairs])
    return lifted


def _interpolated(mesh: Mesh, grid: Grid, threads: int, *, cubic: bool = True) -> Mesh:
    x, y, along = np.empty(grid.shape), np.empty(grid.shape), rules(mesh.x.shape, grid.shape, cubic=cubic)
    pairs = ((np.ascontiguousarray(mesh.x), x), (np.ascontiguousarray(mesh.y), y))
    Parts.of(grid.shape, threads).each(lambda part: [interpolate(a, *along, part.ends, b, True) for a, b in pairs])
    x[0], x[-1], y[:, 0], y[:, -1] = 0.0, 1.0, 0.0, 1.0
    return Mesh(x, y)
