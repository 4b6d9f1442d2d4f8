"""Nested grids, from coarse to fine, and the prolongation of a mesh from one to the next."""

import numpy as np

from equimesh.meshes.folding import largest_difference, smallest_in_parts
from equimesh.meshes.grid import MIN_POINTS, Grid
from equimesh.meshes.interpolation import extrapolate, interpolate, rule_on_rows, rules
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.mesh_rows import HeldMesh
from equimesh.meshes.parts import Part, Parts

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
    before = None if coarser is None else HeldMesh.of(coarser)
    found = prolong_rows(HeldMesh.of(mesh), grid, before, Parts.of(grid.shape, threads))
    return Mesh(found.x, found.y)


def prolong_rows(mesh: HeldMesh, grid: Grid, coarser: HeldMesh | None, parts: Parts) -> HeldMesh:
    """The rows of :func:`prolong` that a process holds; ``parts`` are those of ``grid``.

    ``mesh`` has the rows that :func:`~equimesh.meshes.interpolation.rows_needed` names for these, and no others,
    ``coarser`` at least those that it names for the rows of ``mesh``.
    """
    if coarser is not None:
        lifted = _extrapolated(mesh, coarser, grid, parts.communicator.size)
        candidate = _interpolated(lifted, grid, (parts.begin, parts.end), parts.communicator.size)
        if not _is_folded(candidate, parts):
            return candidate
    for cubic in (True, False):
        candidate = _interpolated(mesh, grid, (parts.begin, parts.end), parts.communicator.size, cubic=cubic)
        if not _is_folded(candidate, parts):
            return candidate
    return uniform_rows(grid, parts)


def uniform_rows(grid: Grid, parts: Parts) -> HeldMesh:
    """The rows of the uniform mesh that a process holds."""
    xi, eta = np.linspace(0, 1, grid.n_xi)[parts.held], np.linspace(0, 1, grid.n_eta)
    x, y = np.meshgrid(xi, eta, indexing="ij")
    return HeldMesh(grid, parts.begin, x, y)


def distance(mesh: Mesh, coarse: Mesh, threads: int = 1) -> float:
    """Largest difference of a coordinate between a mesh and the cubic interpolant of one on a coarser grid.

    Where every other node lies on the coarser grid, at those nodes.
    """
    return distance_in_rows(HeldMesh.of(mesh), HeldMesh.of(coarse), Parts.of(mesh.x.shape, threads))


def distance_in_rows(mesh: HeldMesh, coarse: HeldMesh, parts: Parts) -> float:
    """The :func:`distance` in the rows that this process owns; ``parts`` are those of the grid of ``mesh``.

    ``coarse`` has at least the rows that :func:`~equimesh.meshes.interpolation.rows_needed` names for these.
    """
    fine, rough, here = mesh.grid.shape, coarse.grid.shape, parts.here
    pairs = ((mesh.x, coarse.x), (mesh.y, coarse.y))
    steps = [(n - 1) // (m - 1) for n, m in zip(fine, rough, strict=True)]
    if tuple(len(range(0, n, step)) for n, step in zip(fine, steps, strict=True)) == rough:

        def at_common_nodes(part: Part) -> float:
            ends = [-(-(row + mesh.begin) // steps[0]) for row in part.ends]
            found = slice(ends[0] * steps[0] - mesh.begin, part.last, steps[0]), slice(None, None, steps[1])
            rows = slice(ends[0] - coarse.begin, ends[1] - coarse.begin)
            return max(largest_difference(a[found], b[rows]) for a, b in pairs)

        return here.largest(at_common_nodes)
    along_xi, along_eta = rules(rough, fine)
    along_xi = rule_on_rows(along_xi, mesh.ends, coarse.begin)
    return here.largest(lambda part: max(interpolate(b, along_xi, along_eta, part.ends, a, False) for a, b in pairs))


def refinement(fine: Grid, coarse: Grid) -> float:
    """The square of the ratio of the spacings: the factor by which an error of second order falls."""
    return max(coarse.d_xi / fine.d_xi, coarse.d_eta / fine.d_eta) ** 2


def is_refined(fine: Grid, coarse: Grid) -> bool:
    """Whether the spacing is smaller in both directions: only then does the difference of two meshes show its error."""
    return fine.n_xi > coarse.n_xi and fine.n_eta > coarse.n_eta


def _is_folded(mesh: HeldMesh, parts: Parts) -> bool:
    return not smallest_in_parts(mesh.x, mesh.y, parts) > 0.0


def _extrapolated(mesh: HeldMesh, coarser: HeldMesh, grid: Grid, threads: int) -> HeldMesh:
    """The mesh plus the expected difference to the solution on the finer ``grid``."""
    here, before = refinement(grid, mesh.grid), refinement(mesh.grid, coarser.grid)
    share = (1.0 - 1.0 / here) / (before - 1.0)
    lifted = _interpolated(coarser, mesh.grid, mesh.ends, threads)
    pairs = ((mesh.x, lifted.x), (mesh.y, lifted.y))
    Parts.of(mesh.x.shape, threads).each(lambda part: [extrapolate(a, b, share, part.ends) for a, b in pairs])
    return lifted


def _interpolated(mesh: HeldMesh, grid: Grid, rows: tuple[int, int], threads: int, *, cubic: bool = True) -> HeldMesh:
    """The rows ``rows[0]`` to ``rows[1] - 1`` of the interpolant on ``grid``."""
    shape = rows[1] - rows[0], grid.n_eta
    x, y, (along_xi, along_eta) = np.empty(shape), np.empty(shape), rules(mesh.grid.shape, grid.shape, cubic=cubic)
    along_xi, pairs = rule_on_rows(along_xi, rows, mesh.begin), ((mesh.x, x), (mesh.y, y))
    Parts.of(shape, threads).each(
        lambda part: [interpolate(a, along_xi, along_eta, part.ends, b, True) for a, b in pairs]
    )
    if rows[0] == 0:
        x[0] = 0.0
    if rows[1] == grid.n_xi:
        x[-1] = 1.0
    y[:, 0], y[:, -1] = 0.0, 1.0
    return HeldMesh(grid, rows[0], x, y)
