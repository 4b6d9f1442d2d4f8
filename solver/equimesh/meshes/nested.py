"""Nested grids, from coarse to fine, and the prolongation of a mesh from one to the next."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from equimesh.meshes.mesh import MIN_POINTS, Grid, Mesh, MeshRows, largest_difference
from equimesh.meshes.rows import Rows, Share
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array, IntArray

# Interpolation of nodal values from one uniform grid to another: products of one-dimensional rules.

# Coarse points in a rule. A linear rule has two weights that are zero.
WIDTH = 4


class Rule(NamedTuple):
    """For every fine point, the ``first`` coarse point, ``(fine,)``, and Lagrange ``weights``, ``(WIDTH, fine)``."""

    first: npt.NDArray[np.uint64]
    weights: Array


def interpolated_values(values: Array, shape: tuple[int, ...], *, cubic: bool = True) -> Array:
    """Nodal ``values`` of shape ``(n_xi, n_eta)`` on a grid of another shape, by cubic or linear interpolation."""
    fine = np.empty(shape)
    interpolate(np.ascontiguousarray(values), *rules(values.shape, shape, cubic=cubic), (0, shape[0]), fine, True)
    return fine


def rules(coarse: tuple[int, ...], fine: tuple[int, ...], *, cubic: bool = True) -> tuple[Rule, Rule]:
    """The rules along xi and along eta."""
    return rule(coarse[0], fine[0], cubic=cubic), rule(coarse[1], fine[1], cubic=cubic)


@lru_cache(maxsize=64)
def rule(coarse: int, fine: int, *, cubic: bool = True) -> Rule:
    """The rule from ``coarse`` points of a uniform grid of [0, 1], four or more, to ``fine`` points."""
    place = np.arange(fine) * (coarse - 1) / (fine - 1)
    cell = np.minimum(place.astype(np.int64), coarse - 2)
    first = np.clip(cell - 1, 0, coarse - WIDTH)
    at, weights = (cell - first) + (place - cell), np.zeros((WIDTH, fine))
    if cubic:
        weights[:] = lagrange(at)
    else:
        every = np.arange(fine)
        weights[cell - first, every], weights[cell - first + 1, every] = 1.0 - (place - cell), place - cell
    return fixed_rule(first, weights)


def fixed_rule(first: IntArray | npt.NDArray[np.uint64], weights: Array) -> Rule:
    """A rule that nobody can change. All rules are such: for others the loops would be compiled once more."""
    found = Rule(first.astype(np.uint64), weights)
    for array in found:
        array.setflags(write=False)
    return found


def rule_on_rows(whole: Rule, rows: tuple[int, int], begin: int) -> Rule:
    """A rule for some fine rows alone, whose coarse rows are counted from ``begin``."""
    if (*rows, begin) == (0, whole.first.size, 0):
        return whole
    here = slice(*rows)
    return fixed_rule(whole.first[here] - np.uint64(begin), np.array(whole.weights[:, here], order="C"))


def rows_needed(coarse: int, fine: int, rows: tuple[int, int]) -> tuple[int, int]:
    """The first coarse row that the rules for some fine rows read, and the one after the last."""
    first = rule(coarse, fine).first
    return int(first[rows[0]]), int(first[rows[1] - 1]) + WIDTH


def lagrange(at: Array) -> Array:
    """The weights of the cubic through the values at 0, 1, 2 and 3."""
    weights = np.ones((WIDTH, at.size))
    for k in range(WIDTH):
        for other in range(WIDTH):
            if other != k:
                weights[k] *= (at - other) / (k - other)
    return weights


@compiled
def interpolate(
    coarse: Array, along_xi: Rule, along_eta: Rule, rows: tuple[int, int], fine: Array, write: bool
) -> float:
    """Nodal values on the rows ``rows[0]`` to ``rows[1] - 1`` of a finer grid, in ``fine``.

    Without ``write`` the values of ``fine`` are kept, and the largest difference to them is returned; NaN where one of
    them is not a number.
    """
    columns = fine.shape[1]
    lines, row, ready, largest = np.empty((WIDTH, columns)), np.empty((1, columns)), 0, 0.0
    at, weights = along_xi
    for i in range(rows[0], rows[1]):
        first = int(at[i])
        for r in range(max(ready, first), first + WIDTH):
            interpolate_line(coarse[r], along_eta, lines[r % WIDTH])
        ready = first + WIDTH
        one, two, three, four = lines[first % 4], lines[(first + 1) % 4], lines[(first + 2) % 4], lines[(first + 3) % 4]
        a, b, c, d = weights[0, i], weights[1, i], weights[2, i], weights[3, i]
        target = fine[i] if write else row[0]
        for j in range(columns):
            target[j] = a * one[j] + b * two[j] + c * three[j] + d * four[j]
        if not write:
            found = largest_difference(row, fine[i : i + 1])
            if found > largest or found - found != 0.0:
                largest = found
    return largest


@compiled
def extrapolate(values: Array, before: Array, share: float, rows: tuple[int, int]) -> None:
    """Replace some rows of ``before`` by ``values`` plus ``share`` of the differences ``values - before``."""
    for i in range(rows[0], rows[1]):
        here, there = values[i], before[i]
        for j in range(here.size):
            there[j] = here[j] + share * (here[j] - there[j])


@compiled
def interpolate_line(source: Array, along_eta: Rule, line: Array) -> None:
    """The values of one row of the coarse grid at all fine points along eta."""
    first, weights = along_eta
    a, b, c, d = weights[0], weights[1], weights[2], weights[3]
    for j in range(line.size):
        at = first[j]  # without a sign, so that the compiler need not allow for an index from the end
        line[j] = (
            a[j] * source[at]
            + b[j] * source[at + np.uint64(1)]
            + c[j] * source[at + np.uint64(2)]
            + d[j] * source[at + np.uint64(3)]
        )


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
    before = None if coarser is None else MeshRows.of(coarser)
    found = prolong_rows(MeshRows.of(mesh, threads), before, Rows.whole(grid.shape, threads))
    return Mesh(found.x, found.y)


def prolong_rows(mesh: MeshRows, coarser: MeshRows | None, rows: Rows) -> MeshRows:
    """The ``rows`` of the mesh of :func:`prolong`.

    ``mesh`` has the rows that :func:`~equimesh.meshes.nested.rows_needed` names for these, and no others,
    ``coarser`` at least those that it names for the rows of ``mesh``.
    """
    if coarser is not None:
        candidate = _interpolated(_extrapolated(mesh, coarser, Grid(n_xi=rows.shape[0], n_eta=rows.shape[1])), rows)
        if not candidate.is_folded:
            return candidate
    for cubic in (True, False):
        candidate = _interpolated(mesh, rows, cubic=cubic)
        if not candidate.is_folded:
            return candidate
    return MeshRows.uniform(rows)


def distance(mesh: Mesh, coarse: Mesh, threads: int = 1) -> float:
    """Largest difference of a coordinate between a mesh and the cubic interpolant of one on a coarser grid.

    Where every other node lies on the coarser grid, at those nodes.
    """
    return distance_in_rows(MeshRows.of(mesh, threads), MeshRows.of(coarse))


def distance_in_rows(mesh: MeshRows, coarse: MeshRows) -> float:
    """The :func:`distance` in the own rows of ``mesh``.

    ``coarse`` has at least the rows that :func:`~equimesh.meshes.nested.rows_needed` names for these.
    """
    rows, fine, rough = mesh.rows, mesh.rows.shape, coarse.rows.shape
    pairs = ((mesh.x, coarse.x), (mesh.y, coarse.y))
    steps = common_steps(fine, rough)
    if steps is not None:

        def at_common_nodes(share: Share) -> float:
            ends = [-(-(row + rows.begin) // steps[0]) for row in share.ends]
            found = slice(ends[0] * steps[0] - rows.begin, share.last, steps[0]), slice(None, None, steps[1])
            there = slice(ends[0] - coarse.rows.begin, ends[1] - coarse.rows.begin)
            return max(largest_difference(a[found], b[there]) for a, b in pairs)

        return rows.largest_here(at_common_nodes)
    along_xi, along_eta = rules(rough, fine)
    along_xi = rule_on_rows(along_xi, (rows.begin, rows.end), coarse.rows.begin)
    return rows.largest_here(
        lambda share: max(interpolate(b, along_xi, along_eta, share.ends, a, False) for a, b in pairs)
    )


def common_steps(fine: tuple[int, int], coarse: tuple[int, int]) -> tuple[int, int] | None:
    """The steps, along xi and eta, by which the nodes of a fine grid are those of a coarse one; ``None`` if not."""
    steps = (fine[0] - 1) // (coarse[0] - 1), (fine[1] - 1) // (coarse[1] - 1)
    found = tuple(len(range(0, n, step)) for n, step in zip(fine, steps, strict=True))
    return steps if found == coarse else None


def refinement(fine: Grid, coarse: Grid) -> float:
    """The square of the ratio of the spacings: the factor by which an error of second order falls."""
    return max(coarse.d_xi / fine.d_xi, coarse.d_eta / fine.d_eta) ** 2


def is_refined(fine: Grid, coarse: Grid) -> bool:
    """Whether the spacing is smaller in both directions: only then does the difference of two meshes show its error."""
    return fine.n_xi > coarse.n_xi and fine.n_eta > coarse.n_eta


def _extrapolated(mesh: MeshRows, coarser: MeshRows, grid: Grid) -> MeshRows:
    """The mesh plus the expected difference to the solution on the finer ``grid``."""
    here, before = refinement(grid, mesh.grid), refinement(mesh.grid, coarser.grid)
    ratio = (1.0 - 1.0 / here) / (before - 1.0)
    lifted = _interpolated(coarser, mesh.rows)
    pairs = ((mesh.x, lifted.x), (mesh.y, lifted.y))
    every = Rows.whole(mesh.x.shape, mesh.rows.threads)
    every.each(lambda share: [extrapolate(a, b, ratio, share.ends) for a, b in pairs])
    return lifted


def _interpolated(mesh: MeshRows, rows: Rows, *, cubic: bool = True) -> MeshRows:
    """The ``rows`` of the interpolant on their grid."""
    x, y, begin = np.empty(rows.here_shape), np.empty(rows.here_shape), mesh.rows.begin
    along_xi, along_eta = rules(mesh.rows.shape, rows.shape, cubic=cubic)
    along_xi, pairs = rule_on_rows(along_xi, (rows.begin, rows.end), begin), ((mesh.x, x), (mesh.y, y))
    every = Rows.whole(rows.here_shape, rows.threads)
    every.each(lambda share: [interpolate(a, along_xi, along_eta, share.ends, b, True) for a, b in pairs])
    if rows.begin == 0:
        x[0] = 0.0
    if rows.end == rows.shape[0]:
        x[-1] = 1.0
    y[:, 0], y[:, -1] = 0.0, 1.0
    return MeshRows(x, y, rows)


# Meshes with closed grid lines, in reference coordinates: their memory with copied ends, and finer grids.
#
# The arrays of a mesh hold both copies of a seam: the last row is the first one, moved by 1. In working memory one
# more row of copies stands before the first one, so that every node of a closed line has two neighbours.

Closed: TypeAlias = tuple[bool, bool]
"""Whether the xi-lines and the eta-lines are closed."""
OPEN: Closed = (False, False)
"""No closed lines."""


def padded_shape(shape: tuple[int, int], closed: Closed) -> tuple[int, int]:
    """The shape of a mesh in working memory."""
    return shape[0] + closed[0], shape[1] + closed[1]


def padded(mesh: Mesh, closed: Closed) -> Mesh:
    """A copy of the mesh with the row or column of copies before the first one."""
    before = int(closed[0]), int(closed[1])
    return Mesh(*(_extended(q, axis, closed, before, (0, 0)) for axis, q in enumerate((mesh.x, mesh.y))))


def unpadded(x: Array, y: Array, closed: Closed) -> Mesh:
    """The mesh in working memory without the row or column before the first one, in the same memory."""
    inside = slice(int(closed[0]), None), slice(int(closed[1]), None)
    return Mesh(x[inside], y[inside])


def closed_mesh(mesh: Mesh, closed: Closed) -> Mesh:
    """A copy of the mesh with straight sides where these are no seams, and the last copy of a seam as the first one."""
    x, y = np.array(mesh.x, order="C"), np.array(mesh.y, order="C")
    if closed[0]:
        x[-1], y[-1] = x[0] + 1.0, y[0]
    else:
        x[0], x[-1] = 0.0, 1.0
    if closed[1]:
        x[:, -1], y[:, -1] = x[:, 0], y[:, 0] + 1.0
    else:
        y[:, 0], y[:, -1] = 0.0, 1.0
    return Mesh(x, y)


def prolong_closed(mesh: Mesh, grid: Grid, closed: Closed, coarser: Mesh | None = None) -> Mesh:
    """The mesh interpolated to another grid, across the seams; as :func:`~equimesh.meshes.nested.prolong`."""
    if coarser is not None:
        share = (1.0 - 1.0 / refinement(grid, mesh.grid)) / (refinement(mesh.grid, coarser.grid) - 1.0)
        rough = interpolated_closed(coarser, mesh.grid, closed)
        lifted = Mesh(mesh.x + share * (mesh.x - rough.x), mesh.y + share * (mesh.y - rough.y))
        candidate = interpolated_closed(lifted, grid, closed)
        if not candidate.is_folded:
            return candidate
    for cubic in (True, False):
        candidate = interpolated_closed(mesh, grid, closed, cubic=cubic)
        if not candidate.is_folded:
            return candidate
    return Mesh.uniform(grid)


def interpolated_closed(mesh: Mesh, grid: Grid, closed: Closed, *, cubic: bool = True) -> Mesh:
    """The interpolant of a mesh on another grid; closed lines have no ends at which a rule would be one-sided."""
    found = [interpolated_across(q, grid.shape, closed, axis, cubic=cubic) for axis, q in enumerate((mesh.x, mesh.y))]
    return closed_mesh(Mesh(*found), closed)


def interpolated_across(
    values: Array, shape: tuple[int, int], closed: Closed, axis: int | None = None, *, cubic: bool = True
) -> Array:
    """Nodal values of a mesh with closed lines on a grid of another shape.

    ``axis`` is that of the coordinate that they are, which grows by 1 along a closed line; ``None`` for values that
    do not grow.
    """
    ends = (WIDTH // 2 * closed[0], WIDTH // 2 * closed[1])
    rules = [_rule(coarse, n, end, cubic=cubic) for coarse, n, end in zip(values.shape, shape, ends, strict=True)]
    fine = np.empty(shape)
    interpolate(_extended(values, axis, closed, ends, ends), rules[0], rules[1], (0, shape[0]), fine, True)
    return fine


def distance_closed(mesh: Mesh, coarse: Mesh, closed: Closed) -> float:
    """The largest difference of a coordinate between a mesh and one on a coarser grid, at the common nodes if any."""
    steps = [(n - 1) // (m - 1) for n, m in zip(mesh.grid.shape, coarse.grid.shape, strict=True)]
    if all((m - 1) * step == n - 1 for n, m, step in zip(mesh.grid.shape, coarse.grid.shape, steps, strict=True)):
        here = Mesh(mesh.x[:: steps[0], :: steps[1]], mesh.y[:: steps[0], :: steps[1]])
        return max(largest_difference(here.x, coarse.x), largest_difference(here.y, coarse.y))
    fine = interpolated_closed(coarse, mesh.grid, closed)
    return max(largest_difference(mesh.x, fine.x), largest_difference(mesh.y, fine.y))


def tied_nodes(shape: tuple[int, int], closed: Closed) -> IntArray:
    """The pairs (copy, original) of node numbers that are one node of a closed line, shape ``(k, 2)``."""
    number = np.arange(shape[0] * shape[1], dtype=np.int64).reshape(shape)
    original = number.copy()
    if closed[0]:
        original[-1] = original[0]
    if closed[1]:
        original[:, -1] = original[:, 0]
    copies = original != number
    return np.column_stack([number[copies], original[copies]])


def _rule(coarse: int, fine: int, ends: int, *, cubic: bool) -> Rule:
    """The rule between grids of one direction, of which the coarse one has ``ends`` more points at either end."""
    place = np.arange(fine) * (coarse - 1) / (fine - 1)
    cell = np.minimum(place.astype(np.int64), coarse - 2)
    first = np.clip(cell - 1, -ends, coarse + ends - WIDTH)
    weights, every = np.zeros((WIDTH, fine)), np.arange(fine)
    if cubic:
        weights[:] = lagrange((cell - first) + (place - cell))
    else:
        weights[cell - first, every], weights[cell - first + 1, every] = 1.0 - (place - cell), place - cell
    return fixed_rule(first + ends, weights)


def _extended(q: Array, axis: int | None, closed: Closed, before: tuple[int, int], after: tuple[int, int]) -> Array:
    """A coordinate (``axis`` 0: x, 1: y) with copied nodes before the first ones and after the last ones."""
    for direction in (0, 1):
        if not closed[direction]:
            continue
        lines, period = np.moveaxis(q, direction, 0), float(direction == axis)
        nodes = len(lines) - 1
        number = np.arange(-before[direction], nodes + 1 + after[direction])
        turns = number // nodes
        moved = lines[number % nodes] + period * turns[:, None]
        q = np.moveaxis(moved, 0, direction)
    return np.array(q, order="C")
