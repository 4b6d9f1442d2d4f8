"""The shape of a grid with a given number of points: by the measured error of u on coarse grids of several shapes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from equimesh.domains.domain import Domain, map_mesh
from equimesh.errors import InputError
from equimesh.fields.expression import Field
from equimesh.fields.nodal_field import EdgeBumps, evaluate_points
from equimesh.least_error.iteration import LeastErrorSolve
from equimesh.least_error.kernels import Norm
from equimesh.meshes.mesh import Grid, Mesh
from equimesh.meshes.nested import interpolated_values
from equimesh.monitors.least_error import LeastError
from equimesh.numerics.types import Array
from equimesh.quality.cells import CellPoints, cells_of
from equimesh.rounds.recovery import ErrorEstimate
from equimesh_coupling.adaptation import MAX_UNRESOLVED_SHARE
from equimesh_schema.document import is_whole

MIN_CELLS = 4
"""Cells, at least, in each direction of a grid."""
MIN_POINTS = (MIN_CELLS + 1) ** 2
"""The fewest points of a budget: those of the coarsest grid."""
COARSE_CELLS = 16
"""Cells a side, about, of the coarse grids."""
COARSE_SHARE = 4
"""The share of the points, at least, that the coarse grids have is one over this."""
MAX_RISE = 4.0
"""The largest error over the least one that counts in a fit: an error far above it says no more."""
STEP = 4.0
"""The factor by which the ratio of the cells along xi and along eta changes from shape to shape."""
MEASURED_POINTS = 2
"""Gauss points a direction and cell of the mesh that resolves u, at which the errors of other meshes are measured."""
MIN_GAIN = 1.15
"""The least factor by which the measured error has to fall for another shape."""
ORDERS: dict[Norm, float] = {"l2": 2.0, "h1": 1.0}
"""The power of the spacing to which the error of bilinear elements falls."""


def require_budget(points: object) -> int:
    """The number of ``points`` of a budget; raises :class:`~equimesh.errors.InputError` for one without a grid."""
    if not is_whole(points) or int(str(points)) < MIN_POINTS:
        raise InputError(
            f"points = {str(points)[:40]}: a grid has at least {MIN_POINTS} points, {MIN_CELLS + 1} a direction; give"
            " a whole number of them",
            field="points",
        )
    return int(str(points))


def grid_of(points: int, ratio: float) -> Grid:
    """The grid of at most ``points`` whose cells along xi are about ``ratio`` times those along eta."""
    cells = (math.sqrt(points) - 1.0) * math.sqrt(ratio)
    n_xi = min(max(round(cells), MIN_CELLS) + 1, points // (MIN_CELLS + 1))
    return Grid(n_xi=n_xi, n_eta=max(points // n_xi, MIN_CELLS + 1))


def ratio_of(grid: Grid) -> float:
    """How many times as many cells a grid has along xi as along eta."""
    return (grid.n_xi - 1) / (grid.n_eta - 1)


@dataclass(frozen=True, kw_only=True, eq=False)
class FixedPoints:
    """Points of a domain at which meshes of all shapes are measured: a mesh cannot hide a peak in one of its cells."""

    u: tuple[Array, ...]
    """u and its gradient there."""
    s: Array
    """Places of the points in the reference square."""
    t: Array
    weights: Array
    jacobian: tuple[Array, ...]
    """``x_s, x_t, y_s, y_t`` of the domain."""

    @classmethod
    def of(cls, u: Field, domain: Domain, mesh: Mesh) -> FixedPoints:
        """The Gauss points of the cells of a ``mesh`` of the reference square, which resolves ``u``."""
        cells, points = cells_of(mesh), CellPoints.gauss(MEASURED_POINTS)
        at = cells.at(points, np.arange(cells.count))
        s, t = (np.ascontiguousarray(q.T).reshape(-1) for q in (at.x, at.y))
        jacobian = tuple(np.broadcast_to(part, s.shape) for part in domain.jacobian(s, t))
        area = jacobian[0] * jacobian[3] - jacobian[1] * jacobian[2]
        weights = (points.weights[:, None] * at.det).T.reshape(-1) * np.abs(area)
        return cls(u=u.evaluate(*domain.map(s, t), order=1), s=s, t=t, weights=weights, jacobian=jacobian)

    def error(self, mesh: Mesh, values: Array, norm: Norm) -> float:
        """The error of the interpolant of ``values`` at the nodes of a ``mesh`` of the reference square."""
        rows = np.empty((3, self.s.size))
        flat = EdgeBumps(*(np.zeros((*np.diff(values, axis=k).shape, 2)) for k in (0, 1)))
        evaluate_points((self.s, self.t), (mesh.x, mesh.y), values, flat, self.s.size, rows)
        if norm == "l2":
            return math.sqrt(float(self.weights @ (self.u[0] - rows[0]) ** 2))
        x_s, x_t, y_s, y_t = self.jacobian
        det = x_s * y_t - x_t * y_s
        u_x, u_y = (rows[1] * y_t - rows[2] * y_s) / det, (rows[2] * x_s - rows[1] * x_t) / det
        return math.sqrt(float(self.weights @ ((self.u[1] - u_x) ** 2 + (self.u[2] - u_y) ** 2)))


def best_grid(u: Field, domain: Domain, points: int, norm: Norm, resolving: Mesh, threads: int = 1) -> Grid:
    """The grid of at most ``points`` on which the mesh of least error of ``u`` is expected to have the least error.

    ``resolving`` is a mesh of the reference square that resolves u. Meshes of least error are measured on coarse grids
    of at least 17 x 17 points: first in the shape of its grid, then in more oblong ones, while the error falls. The
    grid of ``resolving`` is the result where another shape does not lower the measured error by 15 %.
    """
    monitor, first = LeastError(u=u, norm=norm).on(domain), resolving.grid
    fixed = FixedPoints.of(monitor.u, domain, resolving)

    def error(grid: Grid) -> float:
        mesh: Any = None
        for record in LeastErrorSolve(monitor=monitor, domain=domain, grid=grid, threads=threads).steps():
            mesh = record.mesh
        x, y = (np.ascontiguousarray(q) for q in (mesh.x, mesh.y))
        return fixed.error(Mesh(x, y), np.ascontiguousarray(monitor.u.evaluate(*domain.map(x, y))[0]), norm)

    coarse = min(points, max((COARSE_CELLS + 1) ** 2, points // COARSE_SHARE))
    errors = _ladder(lambda ratio: error(grid_of(coarse, ratio)), coarse, ratio_of(first))
    ratio, gain = _best_ratio(errors, points, ORDERS[norm])
    return grid_of(points, ratio) if gain > MIN_GAIN else first


def _ladder(error: Callable[[float], float], points: int, first: float) -> list[tuple[float, float, bool]]:
    """Ratios of cells, from small to large, with the errors there, and whether the first ratio it is.

    In both directions it goes on while the errors fall and the grid is another one.
    """
    found = [(first, error(first), True)]
    for factor in (STEP, 1.0 / STEP):
        at, least = first, min(value for _, value, _ in found)
        while grid_of(points, at * factor) != grid_of(points, at):
            at *= factor
            found.append((at, error(at), False))
            if not found[-1][1] < least:
                break
            least = found[-1][1]
    return sorted(found)


def _best_ratio(ladder: list[tuple[float, float, bool]], points: int, order: float) -> tuple[float, float]:
    """The ratio with the least expected error, and the error at the first ratio over that.

    It is the lowest point of a parabola through the logarithms of the best error and its neighbours. Where the best
    grid is the most oblong one, the squares of the last two errors are the sum of a part by the cells along xi and one
    by those along eta.
    """
    errors = [value for _, value, _ in ladder]
    first = next(value for _, value, is_first in ladder if is_first)
    k = min(range(len(ladder)), key=lambda number: errors[number])
    ratio, least, _ = ladder[k]
    if not (0.0 < least < math.inf) or len(ladder) == 1:
        return ratio, 1.0
    if 0 < k < len(ladder) - 1:
        before, here, after = (math.log(min(value, MAX_RISE * least)) for value in errors[k - 1 : k + 2])
        moved = 0.5 * (before - after) / (before - 2.0 * here + after)
        return ratio * (ladder[k + 1][0] / ratio) ** moved, first / least
    near = ladder[k - 1] if k > 0 else ladder[1]
    powers = np.array([[one**-order, one**order] for one in (ratio, near[0])])
    (along, across), _ = scipy.optimize.nnls(powers / np.array([[least], [near[1]]]) ** 2, np.ones(2))
    most = points / MIN_CELLS**2
    if not along * across > 0.0:
        return most if along > 0.0 else 1.0 / most, first / least
    return min(max((along / across) ** (0.5 / order), 1.0 / most), most), first / least


@dataclass(kw_only=True)
class ShapeSearch:
    """The shape of the grid of at most ``points`` in a loop: it is found once the solution is resolved."""

    points: int
    is_settled: bool = False
    """Whether a round has kept the shape of the one before."""

    def first(self, domain: Domain) -> Grid:
        """The grid of the first round, in the proportions of the lines of the domain."""
        along, across = proportions(domain)
        return grid_of(self.points, along / across)

    def grid(self, known: ErrorEstimate, norm: Norm, threads: int) -> Grid:
        """The grid of the next round."""
        recovery = known.recovery
        domain: Any = recovery.domain
        before = recovery.mesh.grid
        if self.is_settled or known.is_exact or known.unresolved > MAX_UNRESOLVED_SHARE:
            return before
        grid = best_grid(recovery.u, domain, self.points, norm, recovery.mesh, threads)
        self.is_settled = grid == before
        return grid


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
