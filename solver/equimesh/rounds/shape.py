"""The counts of cells for a number of points: by the measured error of u on coarse meshes of several shapes."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import scipy

from equimesh.blocks.blocks import OTHER_CELLS, Blocks
from equimesh.blocks.counts import MAX_NODES
from equimesh.blocks.layout import Layout
from equimesh.domains.domain import UNIT_SQUARE, Domain, map_mesh
from equimesh.errors import InputError
from equimesh.fields.expression import Field
from equimesh.fields.nodal_field import EdgeBumps, evaluate_points
from equimesh.fields.quad_field import evaluate_places
from equimesh.least_error.iteration import LeastErrorSolve
from equimesh.least_error.kernels import Norm
from equimesh.meshes.mesh import Grid, Mesh
from equimesh.meshes.nested import interpolated_values
from equimesh.meshes.unrolled import Unrolled
from equimesh.monitors.least_error import LeastError
from equimesh.numerics.types import Array, IntArray
from equimesh.quality.cells import CellPoints, cells_of
from equimesh.rounds.estimate import ErrorEstimate
from equimesh_coupling.adaptation import MAX_UNRESOLVED_SHARE
from equimesh_schema.document import is_whole

MIN_CELLS = 4
"""Cells, at least, in each direction of a grid, and along edges of blocks that have not fewer."""
COARSE_CELLS = 16
"""Cells a side, about, of the coarse grids."""
COARSE_SHARE = 4
"""The share of the points, at least, that the coarse grids have is one over this."""
COARSEST_FACTOR = 8
"""How many times the points of the coarsest mesh they have, at least."""
MAX_RISE = 4.0
"""The largest error over the least one that counts in a fit: an error far above it says no more."""
STEP = 4.0
"""The factor by which the ratio of the cells of a class to those of others changes from shape to shape."""
MEASURED_POINTS = 2
"""Gauss points a direction and cell of the mesh that resolves u, at which the errors of other meshes are measured."""
MIN_GAIN = 1.15
"""The least factor by which the measured error has to fall for another shape."""
ORDERS: dict[Norm, float] = {"l2": 2.0, "h1": 1.0}
"""The power of the spacing to which the error of bilinear elements falls."""


GRID = Layout(
    edges=np.array([[0, 1], [3, 2], [0, 3], [1, 2]]),
    block_edges=np.array([[2, 3, 0, 1]]),
    forward=np.ones((1, 4), dtype=bool),
    edge_counts=np.full(4, MIN_CELLS),
)
"""The layout of a grid: one block, whose classes of edges are those along xi and those along eta."""


def require_budget(points: object, domain: Domain | Blocks = UNIT_SQUARE, name: str = "points") -> int:
    """The number of ``points`` of a budget; raises :class:`~equimesh.errors.InputError` for one without a mesh.

    ``name`` is that of the argument.
    """
    layout = layout_of(domain)
    fewest = layout.with_counts(least_counts(layout)).node_count
    if not is_whole(points):
        message = f"{name} = {points!r:.40}: give a whole number, of at least {fewest} points in all"
        raise InputError(message, field=name)
    if int(str(points)) > MAX_NODES:
        raise InputError(f"{points!r:.40} points are too many: a mesh has at most {MAX_NODES}", field=name)
    if int(str(points)) >= fewest:
        return int(str(points))
    coarsest = f"a grid has at least {fewest} points, {MIN_CELLS + 1} a direction"
    if isinstance(domain, Blocks):
        coarsest = (
            f"the coarsest mesh of these blocks has {fewest} points, {MIN_CELLS} cells along each edge or its own"
        )
    raise InputError(f"{points} points are too few: {coarsest}", field=name)


def layout_of(domain: Domain | Blocks) -> Layout:
    """The layout of the meshes of a domain."""
    return domain.layout if isinstance(domain, Blocks) else GRID


def least_counts(layout: Layout) -> IntArray:
    """The fewest cells along the edges of every class, shape ``(c,)``."""
    return np.minimum(layout.counts, MIN_CELLS)


def counts_within(points: int, domain: Domain | Blocks) -> IntArray:
    """The counts of a mesh of at most ``points``: of equal sides on average on a grid, in proportion on blocks."""
    layout = layout_of(domain)
    wanted = np.asarray(layout.counts if isinstance(domain, Blocks) else proportions(domain), dtype=float)
    return layout.within(points, wanted, least_counts(layout))


def counts_of(mesh: Mesh, domain: Domain | Blocks) -> IntArray:
    """The counts of a ``mesh`` of a domain, of four sides on the reference square."""
    found = layout_of(domain).counts_of([mesh.grid.shape] if mesh.is_grid else [one.shape for one in mesh.blocks])
    if found is None:
        raise InputError(OTHER_CELLS, field="mesh")
    return found


def with_counts(domain: Domain | Blocks, counts: IntArray) -> Grid | Blocks:
    """The grid with these numbers of cells along xi and eta, or the blocks with these for their classes of edges."""
    if isinstance(domain, Blocks):
        return domain.with_counts(counts)
    n_xi, n_eta = (int(count) + 1 for count in counts)
    return Grid(n_xi=n_xi, n_eta=n_eta)


@dataclass(frozen=True, kw_only=True, eq=False)
class FixedPoints:
    """Points of a domain at which meshes of all shapes are measured: a mesh cannot hide a peak in one of its cells."""

    u: tuple[Array, ...]
    """u and its gradient there."""
    s: Array
    """Places of the points in the reference square, in blocks x and y."""
    t: Array
    weights: Array
    jacobian: tuple[Array, ...]
    """``x_s, x_t, y_s, y_t`` of the domain."""

    @classmethod
    def of(cls, u: Field, domain: Domain | Blocks, mesh: Mesh) -> FixedPoints:
        """The Gauss points of the cells of a ``mesh``, on four sides of the reference square, which resolves ``u``."""
        cells, points = cells_of(mesh), CellPoints.gauss(MEASURED_POINTS)
        at = cells.at(points, np.arange(cells.count))
        s, t = (np.ascontiguousarray(q.T).reshape(-1) for q in (at.x, at.y))
        sides = None if isinstance(domain, Blocks) else domain
        parts = (1.0, 0.0, 0.0, 1.0) if sides is None else sides.jacobian(s, t)
        jacobian = tuple(np.broadcast_to(np.asarray(part, dtype=float), s.shape) for part in parts)
        area = jacobian[0] * jacobian[3] - jacobian[1] * jacobian[2]
        weights = (points.weights[:, None] * at.det).T.reshape(-1) * np.abs(area)
        x, y = (s, t) if sides is None else sides.map(s, t)
        return cls(u=u.evaluate(x, y, order=1), s=s, t=t, weights=weights, jacobian=jacobian)

    def error(self, mesh: Mesh, values: Array, norm: Norm) -> float:
        """The error of the interpolant of ``values`` at the nodes of a ``mesh`` like that of the points."""
        rows = np.empty((3, self.s.size))
        if mesh.is_grid:
            flat = EdgeBumps(*(np.zeros((*np.diff(values, axis=k).shape, 2)) for k in (0, 1)))
            cells = np.full(self.s.size, -1), np.full(self.s.size, -1)
            evaluate_points((self.s, self.t), (mesh.x, mesh.y), values, flat, self.s.size, cells, rows)
        else:
            unrolled = Unrolled.of(mesh)
            search, own = unrolled.search, np.array(values[unrolled.nodes])
            straight = np.zeros((len(search.links.cells), 4, 2))
            evaluate_places(search.find(self.s, self.t), search.nodes, search.links.cells, own, straight, rows)
        if norm == "l2":
            return math.sqrt(float(self.weights @ (self.u[0] - rows[0]) ** 2))
        x_s, x_t, y_s, y_t = self.jacobian
        det = x_s * y_t - x_t * y_s
        u_x, u_y = (rows[1] * y_t - rows[2] * y_s) / det, (rows[2] * x_s - rows[1] * x_t) / det
        return math.sqrt(float(self.weights @ ((self.u[1] - u_x) ** 2 + (self.u[2] - u_y) ** 2)))


@dataclass(frozen=True, kw_only=True, eq=False)
class CoarseErrors:
    """The errors of meshes of least error with few points, of any shape, each measured once at the same points."""

    u: Field
    domain: Domain | Blocks
    norm: Norm
    points: int
    """The points of the meshes, at most."""
    resolving: Mesh
    threads: int
    known: dict[tuple[int, ...], float] = field(default_factory=dict)
    """Errors by the counts."""

    def counts(self, proportions: Array) -> tuple[int, ...]:
        """The counts of the coarse mesh in these proportions."""
        layout = layout_of(self.domain)
        return tuple(layout.within(self.points, proportions, least_counts(layout)).tolist())

    def __call__(self, proportions: Array) -> float:
        """The error of the coarse mesh in these proportions; infinite where it folds."""
        counts = self.counts(proportions)
        if counts not in self.known:
            try:
                self.known[counts] = self._measured(np.array(counts))
            except InputError:
                if not self.known:
                    raise
                self.known[counts] = math.inf
        return self.known[counts]

    @cached_property
    def _fixed(self) -> FixedPoints:
        return FixedPoints.of(self.u, self.domain, self.resolving)

    def _measured(self, counts: IntArray) -> float:
        of = with_counts(self.domain, counts)
        domain, grid = (of, None) if isinstance(of, Blocks) else (self.domain, of)
        monitor = LeastError(u=self.u, norm=self.norm).on(domain)
        mesh: Any = None
        for record in LeastErrorSolve(monitor=monitor, domain=domain, grid=grid, threads=self.threads).steps():
            mesh = record.mesh
        if isinstance(domain, Blocks):
            return self._fixed.error(mesh, np.ascontiguousarray(self.u.evaluate(mesh.x, mesh.y)[0]), self.norm)
        x, y = (np.ascontiguousarray(q) for q in (mesh.x, mesh.y))
        values = np.ascontiguousarray(self.u.evaluate(*domain.map(x, y))[0])
        return self._fixed.error(Mesh(x, y), values, self.norm)


def best_counts(
    u: Field, domain: Domain | Blocks, points: int, norm: Norm, resolving: Mesh, threads: int = 1
) -> IntArray:
    """The counts, of at most ``points``, with which the mesh of least error of ``u`` is expected to have the least one.

    They are the cells along the edges of every class, on a grid along xi and eta. ``resolving`` is a mesh of the
    domain, of four sides of the reference square, that resolves u. Meshes of least error are measured with few points,
    at least those of 17 x 17: first in the shape of ``resolving``, then for one class after the other with more and
    with fewer cells in proportion, while the error falls. The counts of ``resolving`` are the result where another
    shape does not lower the measured error by 15 %.
    """
    layout, first = layout_of(domain), counts_of(resolving, domain)
    least = least_counts(layout)
    coarsest = layout.with_counts(least).node_count
    coarse = max((COARSE_CELLS + 1) ** 2, points // COARSE_SHARE, COARSEST_FACTOR * coarsest)
    of_u = LeastError(u=u, norm=norm).on(domain).u
    errors = CoarseErrors(
        u=of_u, domain=domain, norm=norm, points=min(points, coarse), resolving=resolving, threads=threads
    )
    at = first.astype(float)
    before = now = errors(at)
    fitted = np.ones(len(first))
    for one in range(len(first) if len(first) > 2 else 1):  # of two classes the other one has the same ladder
        factor, best, now = _best_factor(_ladder(at, one, errors), points, ORDERS[norm])
        at, fitted[one] = _scaled(at, one, best), factor / best
    if len(first) > 2 and errors(at * fitted) > now:
        fitted[:] = 1.0
    return layout.within(points, at * fitted, least) if before > MIN_GAIN * now else first


def _scaled(proportions: Array, one: int, factor: float) -> Array:
    """Proportions with ``factor`` times as many cells of ``one`` class."""
    found = proportions.copy()
    found[one] *= factor
    return found


def _ladder(at: Array, one: int, errors: CoarseErrors) -> list[tuple[float, float]]:
    """Factors on the cells of ``one`` class, from small to large, with the errors there.

    In both directions it goes on while the errors fall and the counts are other ones.
    """
    found = [(1.0, errors(at))]
    for step in (STEP, 1.0 / STEP):
        factor, least = step, min(value for _, value in found)
        while errors.counts(_scaled(at, one, factor)) != errors.counts(_scaled(at, one, factor / step)):
            found.append((factor, errors(_scaled(at, one, factor))))
            if not found[-1][1] < least:
                break
            factor, least = factor * step, found[-1][1]
    return sorted(found)


def _best_factor(ladder: list[tuple[float, float]], points: int, order: float) -> tuple[float, float, float]:
    """The factor with the least expected error, the one with the least measured error, and that error.

    It is the lowest point of a parabola through the logarithms of the best error and its neighbours. Where the best
    factor is the most extreme one, the squares of the last two errors are the sum of a part by the cells of the class
    and one by all others.
    """
    errors = [value for _, value in ladder]
    k = min(range(len(ladder)), key=lambda number: errors[number])
    best, least = ladder[k]
    if not (0.0 < least < math.inf) or len(ladder) == 1:
        return best, best, least
    if 0 < k < len(ladder) - 1:
        before, here, after = (math.log(min(value, MAX_RISE * least)) for value in errors[k - 1 : k + 2])
        moved = 0.5 * (before - after) / (before - 2.0 * here + after)
        return best * (ladder[k + 1][0] / best) ** moved, best, least
    near = ladder[k - 1] if k > 0 else ladder[1]
    if math.isinf(near[1]):
        return best, best, least
    powers = np.array([[one**-order, one**order] for one in (best, near[0])])
    (along, across), _ = scipy.optimize.nnls(powers / np.array([[least], [near[1]]]) ** 2, np.ones(2))
    most = points / MIN_CELLS**2
    if not along * across > 0.0:
        return (most if along > 0.0 else 1.0 / most), best, least
    return min(max((along / across) ** (0.5 / order), 1.0 / most), most), best, least


@dataclass(kw_only=True)
class ShapeSearch:
    """The counts of meshes of at most ``points`` in a loop: they are found once the solution is resolved."""

    points: int
    domain: Domain | Blocks
    is_settled: bool = False
    """Whether a round has kept the counts of the one before."""

    @classmethod
    def within(cls, points: object, domain: Domain | Blocks) -> ShapeSearch:
        """The search that begins with the counts of :func:`counts_within`; raises as :func:`require_budget`."""
        most = require_budget(points, domain)
        first = with_counts(domain, counts_within(most, domain))
        return cls(points=most, domain=first if isinstance(first, Blocks) else domain)

    def next(self, known: ErrorEstimate, norm: Norm, threads: int) -> Grid | Blocks:
        """The grid of the next round, or the blocks with their counts."""
        recovery = known.recovery
        before = counts_of(recovery.mesh, self.domain)
        if self.is_settled or known.is_exact or known.unresolved > MAX_UNRESOLVED_SHARE:
            return with_counts(self.domain, self._within(before))
        found = best_counts(recovery.u, self.domain, self.points, norm, recovery.mesh, threads)
        self.is_settled = np.array_equal(found, before)
        return with_counts(self.domain, self._within(found))

    def _within(self, counts: IntArray) -> IntArray:
        """The counts, or fewer in proportion where values came on a mesh of more points."""
        layout = layout_of(self.domain)
        if layout.with_counts(counts).node_count <= self.points:
            return counts
        return layout.within(self.points, counts.astype(float), least_counts(layout))


def on_grid(mesh: Mesh, grid: Grid) -> Mesh:
    """A ``mesh`` of the reference square with the points of another ``grid``; the uniform one where it is folded."""
    if mesh.grid == grid:
        return mesh
    for is_cubic in (True, False):
        x, y = (interpolated_values(q, grid.shape, cubic=is_cubic) for q in (mesh.x, mesh.y))
        for ends in (x, y.T):
            ends[0], ends[-1] = 0.0, 1.0
        found = Mesh(x, y)
        if not found.is_folded:
            return found
    return Mesh.uniform(grid)


# Of the domain itself.

MEASURED_CELLS = 16
"""Cells a side of the uniform mesh whose lines are measured for the proportions."""
MAX_PROPORTION = 64.0
"""The largest ratio of the numbers of cells in the two directions."""


def proportions(domain: Domain) -> tuple[float, float]:
    """The numbers of cells along xi and eta in units of their geometric mean, for cells of equal sides on average."""
    mesh = map_mesh(Mesh.uniform(Grid(n_xi=MEASURED_CELLS + 1, n_eta=MEASURED_CELLS + 1)), domain)
    along = [float(np.hypot(np.diff(mesh.x, axis=k), np.diff(mesh.y, axis=k)).sum()) for k in (0, 1)]
    ratio = math.sqrt(min(max(along[0] / along[1], 1.0 / MAX_PROPORTION), MAX_PROPORTION))
    return ratio, 1.0 / ratio
