"""The nodes on the four sides before the interior is solved: one-dimensional problems that need no start."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import scipy

from equimesh.equations.metric import ReferenceMetric
from equimesh.equations.newton_solve import smallest_residual
from equimesh.equations.problem import Boundary, Problem, Side, SideLine, sides
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.newton import Solver, newton_iterations
from equimesh.numerics.types import Array
from equimesh.sweeps.sweep import SideNodes, Sides

# With ``trace`` and ``equidistributed_1d`` a side does not depend on the interior. Sweeps solve it from the given
# nodes. Where they do not converge, Newton's method does, from these nodes or from the equidistribution of the
# continuous metric along the side.

# Guarded sweeps of all sides before Newton's method takes over.
MAX_SWEEPS = 30
# The relative deviation of squared metric lengths from the mean of their side, when it is solved to rounding.
SIDE_TOLERANCE = 1e-12
# Newton steps of one side.
MAX_NEWTON_STEPS = 30
# A correction is halved until every edge keeps this share of the shortest one; below the second share it is left out.
MIN_EDGE_SHARE = 0.2
MIN_MOVE_SHARE = 2.0**-6
# Points of a side at which the continuous metric is sampled, how often they are placed anew, and the share of them that
# is then spread evenly.
SAMPLES = 513
SAMPLING_ROUNDS = 4
SAMPLED_EVENLY = 0.5
# Shares of the metric that are added evenly for one start of Newton's method after the other.
EVEN_SHARES = (0.0, 0.03, 0.1, 0.2, 0.4, 0.8)


def with_solved_sides(problem: Problem, mesh: Mesh, tolerance: float = SIDE_TOLERANCE) -> Mesh | None:
    """The mesh with equidistributed nodes on its sides; ``None`` where that fails. Orthogonal sides are left alone.

    Squared metric lengths then differ from the mean of their side by at most ``tolerance`` of it. The interior follows
    the sides by transfinite interpolation; where that folds, it stays where it is.
    """
    if problem.boundary is Boundary.ORTHOGONAL:
        return mesh
    x, y = mesh.x.copy(), mesh.y.copy()
    tolerance = max(tolerance, smallest_residual(problem.metric, problem.grid.shape))
    with np.errstate(all="ignore"):
        if not _swept(problem, x, y, tolerance) and not _solved(problem, x, y, tolerance):
            return None
    for found in (_blended(mesh, x, y), Mesh(x, y)):
        if not found.is_folded:
            return found
    return None


def straight_start(problem: Problem) -> Mesh:
    """The uniform mesh with equidistributed nodes on its sides, the solution for a metric of one coordinate.

    Orthogonal sides get the nodes of ``trace``. The mesh stays uniform where the sides cannot be solved.
    """
    uniform = Mesh.uniform(problem.grid)
    boundary = Boundary.TRACE if problem.boundary is Boundary.ORTHOGONAL else problem.boundary
    return with_solved_sides(replace(problem, boundary=boundary), uniform) or uniform


def sampled(density: Callable[[Array], Array]) -> tuple[Array, Array]:
    """Positions from 0 to 1, and the integrals of ``density`` from 0 to them.

    ``density`` gives positive numbers for the edges between given positions. The positions are placed anew where it is
    large, so that thin fronts are seen.
    """
    at = np.linspace(0.0, 1.0, SAMPLES)
    for _ in range(SAMPLING_ROUNDS):
        at = cut(at, _integral(density, at), SAMPLES, SAMPLED_EVENLY)
    return at, _integral(density, at)


def cut(at: Array, integral: Array, points: int, even: float) -> Array:
    """The ``points`` positions that cut an integral, which is given at the positions ``at``, into equal parts.

    ``even`` times its value is first added evenly.
    """
    lengths = integral + even * integral[-1] * at
    return np.interp(np.linspace(0.0, lengths[-1], points), lengths, at)


def _integral(density: Callable[[Array], Array], at: Array) -> Array:
    return np.concatenate([[0.0], np.cumsum(density(at) * np.diff(at))])


def _swept(problem: Problem, x: Array, y: Array, tolerance: float) -> bool:
    """Sweep the sides in place; whether they are solved."""
    corrections = Sides(problem.metric, problem.boundary, x.shape)
    for _ in range(MAX_SWEEPS):
        deviation, _, along_eta, along_xi = corrections.moves(SideNodes.of(x, y))
        if deviation <= tolerance:
            return True
        if not math.isfinite(deviation):
            return False
        for lines, moves in ((y, along_eta), (x.T, along_xi)):
            for end, move in zip((0, -1), moves, strict=True):
                _shift(lines[end], move)
    return False


def _shift(line: Array, move: Array) -> None:
    """Move the nodes of a side in place, by as much of ``move`` as keeps their order."""
    floor, share = MIN_EDGE_SHARE * float(np.diff(line).min()), 1.0
    while share > MIN_MOVE_SHARE and not np.diff(line + share * move).min() > floor:
        share *= 0.5
    if share > MIN_MOVE_SHARE:
        line += share * move


def _solved(problem: Problem, x: Array, y: Array, tolerance: float) -> bool:
    """Solve every side by Newton's method, in place; whether all are solved."""
    for side in sides(problem.boundary).values():
        line = side.line(y if side.axis == 0 else x)
        starts = _starts(side, problem.metric, line)
        found = (_newton_on_side(side, problem.metric, start, tolerance) for start in starts)
        solution = next((t for t in found if t is not None), None)
        if solution is None:
            return False
        line[:] = solution
    return True


def _starts(side: Side, metric: ReferenceMetric, line: Array) -> Iterator[Array]:
    """The present nodes, then those that equidistribute the continuous metric along the side, with even shares."""
    yield line.copy()
    at, integral = sampled(lambda t: np.sqrt(SideLine.of(side, metric, t).fluxes) / np.diff(t))
    if np.isfinite(integral).all():
        yield from (cut(at, integral, line.size, even) for even in EVEN_SHARES)


def _newton_on_side(side: Side, metric: ReferenceMetric, start: Array, tolerance: float) -> Array | None:
    """The nodes of one side by Newton's method from ``start``; ``None`` where it does not converge."""

    def line(z: Array) -> SideLine:
        return SideLine.of(side, metric, np.concatenate([[0.0], z, [1.0]]))

    def factorise(z: Array) -> Solver:
        lengths = np.sqrt(line(z).fluxes)
        first, second = (slope / lengths for slope in line(z).flux_derivatives)
        bands = np.zeros((3, z.size))
        bands[0, 1:], bands[1], bands[2, :-1] = second[1:-1], first[1:] - second[:-1], -first[1:-1]
        if not np.isfinite(bands).all():
            raise RuntimeError("the slopes of a side are not finite")
        return lambda right: _banded(0.5 * bands, right)

    enough = 0.5 * tolerance * float(np.sqrt(line(start[1:-1]).fluxes).mean())
    if not math.isfinite(enough):
        return None
    steps = newton_iterations(
        lambda z: np.diff(np.sqrt(line(z).fluxes)),
        lambda z: z,
        start[1:-1],
        admissible=lambda z: bool(z[0] > 0.0 and z[-1] < 1.0 and np.diff(z).min(initial=1.0) > 0.0),
        tolerance=enough,
        factorise=factorise,
    )
    for step in steps:
        if step.residual <= enough:
            return np.concatenate([[0.0], step.z, [1.0]])
        if step.step >= MAX_NEWTON_STEPS:
            break
    return None


def _banded(bands: Array, right: Array) -> Array:
    """The solution of a tridiagonal system; zero, which is no progress, where it is singular."""
    try:
        return np.asarray(scipy.linalg.solve_banded((1, 1), bands, right))
    except scipy.linalg.LinAlgError:
        return np.zeros_like(right)


def _blended(mesh: Mesh, side_x: Array, side_y: Array) -> Mesh:
    """``mesh`` with the displacement of its sides carried into the interior."""
    n_xi, n_eta = mesh.x.shape
    xi, eta = np.linspace(0.0, 1.0, n_xi)[:, None], np.linspace(0.0, 1.0, n_eta)
    by_x, by_y = side_x - mesh.x, side_y - mesh.y
    x = mesh.x + (1.0 - eta) * by_x[:, :1] + eta * by_x[:, -1:]
    y = mesh.y + (1.0 - xi) * by_y[:1] + xi * by_y[-1:]
    return Mesh.of_unit_square(x, y)
