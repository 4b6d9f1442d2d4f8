"""Continuation, where sweeps find no solution: Newton's method, then weaker problems.

Newton's method solves the sides first, then the interior without a matrix.
A weaker problem has a cross-line term with the smallest weight that helps. Where no weight helps, the strength of the
monitor is lowered, too. Both ways lead from an easy problem towards the requested one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from equimesh.equations.newton_solve import smallest_residual
from equimesh.equations.problem import Boundary, Problem
from equimesh.meshes.mesh import Grid, Mesh, smallest_jacobian
from equimesh.numerics.compiled import compiled, vectorised
from equimesh.numerics.newton import gmres, newton_iterations, solve_by_sines, solve_lines
from equimesh.numerics.types import Array
from equimesh.single_domain.solved_sides import straight_start, with_solved_sides
from equimesh.sweeps.line_sums import cell_metrics

# Compiled loops: the defects of the equations at all interior nodes, and what changes them.


@vectorised
def defects(x: Array, y: Array, m: Array, per_spacing: tuple[float, float], cross_line: float, out: Array) -> None:
    """The defects of both equations at the interior nodes, in ``out`` of shape ``(2, n_xi - 2, n_eta - 2)``.

    They are the values of :class:`~equimesh.equations.mesh_equations.MeshEquations` there: differences of the squared
    metric lengths of the two edges that meet at a node, and the cross-line term. ``m`` of shape ``(3, n_xi - 1,
    n_eta - 1)`` is the metric of the cells, ``per_spacing`` one over the squared spacings.
    """
    n_xi, n_eta = x.shape
    per_xi, per_eta = per_spacing
    before = np.empty(n_eta)
    for j in range(1, n_eta - 1):
        gx, gy = x[1, j] - x[0, j], y[1, j] - y[0, j]
        p11, p12, p22 = m[0, 0, j - 1] + m[0, 0, j], m[1, 0, j - 1] + m[1, 0, j], m[2, 0, j - 1] + m[2, 0, j]
        before[j] = 0.5 * (p11 * gx * gx + 2.0 * p12 * gx * gy + p22 * gy * gy)
    along = np.empty(n_eta)
    for i in range(1, n_xi - 1):
        for j in range(n_eta - 1):
            fx, fy = x[i, j + 1] - x[i, j], y[i, j + 1] - y[i, j]
            p11, p12, p22 = m[0, i - 1, j] + m[0, i, j], m[1, i - 1, j] + m[1, i, j], m[2, i - 1, j] + m[2, i, j]
            along[j] = 0.5 * (p11 * fx * fx + 2.0 * p12 * fx * fy + p22 * fy * fy)
        for j in range(1, n_eta - 1):
            gx, gy = x[i + 1, j] - x[i, j], y[i + 1, j] - y[i, j]
            p11, p12, p22 = m[0, i, j - 1] + m[0, i, j], m[1, i, j - 1] + m[1, i, j], m[2, i, j - 1] + m[2, i, j]
            after = 0.5 * (p11 * gx * gx + 2.0 * p12 * gx * gy + p22 * gy * gy)
            bend_x = x[i, j - 1] - 2.0 * x[i, j] + x[i, j + 1]
            bend_y = y[i - 1, j] - 2.0 * y[i, j] + y[i + 1, j]
            out[0, i - 1, j - 1] = (after - before[j]) * per_xi + cross_line * per_eta * bend_x
            out[1, i - 1, j - 1] = (along[j] - along[j - 1]) * per_eta + cross_line * per_xi * bend_y
            before[j] = after


@compiled
def directions(x: Array, y: Array, m: Array, out: Array) -> None:
    """``A, B, C, D`` of the line corrections at the interior nodes, in ``out`` of shape ``(4, n_xi - 2, n_eta - 2)``.

    ``(A, B) = M r_xi`` and ``(C, D) = M r_eta``, with undivided central differences.
    """
    for i in range(1, x.shape[0] - 1):
        for j in range(1, x.shape[1] - 1):
            p11 = 0.25 * (m[0, i - 1, j - 1] + m[0, i - 1, j] + m[0, i, j - 1] + m[0, i, j])
            p12 = 0.25 * (m[1, i - 1, j - 1] + m[1, i - 1, j] + m[1, i, j - 1] + m[1, i, j])
            p22 = 0.25 * (m[2, i - 1, j - 1] + m[2, i - 1, j] + m[2, i, j - 1] + m[2, i, j])
            ex, ey = 0.5 * (x[i + 1, j] - x[i - 1, j]), 0.5 * (y[i + 1, j] - y[i - 1, j])
            fx, fy = 0.5 * (x[i, j + 1] - x[i, j - 1]), 0.5 * (y[i, j + 1] - y[i, j - 1])
            out[0, i - 1, j - 1] = p11 * ex + p12 * ey
            out[1, i - 1, j - 1] = p12 * ex + p22 * ey
            out[2, i - 1, j - 1] = p11 * fx + p12 * fy
            out[3, i - 1, j - 1] = p12 * fx + p22 * fy


# The equations of the interior nodes, without a matrix.
#
# Newton's method solves its linear systems by GMRES. Products with the Jacobian are difference quotients of the
# defects. The preconditioner is that of the sweeps, with the cross-line term: to leading order the first equation is
#
# 2 P_xixi + eps (D / det)_mean P_etaeta = defect, P = A dx + B dy,
#
# and the second one is the same for ``Q = C dx + D dy``. With the mean of its coefficient over each line, a fast
# solver by sines solves it. The number of products does not depend on the number of points.

# The largest move of a node in a difference quotient, as a share of the spacing.
QUOTIENT_STEP = 1e-7
# Products with the Jacobian for one Newton step.
MAX_PRODUCTS = 20
# The residual of a linear system, relative to the first: between these, near the square of the last Newton reduction.
MAX_LINEAR_RESIDUAL, MIN_LINEAR_RESIDUAL = 0.3, 0.01
LINEAR_SHARE = 0.9


class Interior:
    """The requested equations at the interior nodes, or those with a cross-line term of weight ``cross_line``.

    ``vector`` and ``mesh`` lead from a mesh to the unknowns, which are x, then y, of the interior nodes, and back. The
    nodes on the sides stay where they are in ``start``; with orthogonal sides they follow the interior.
    """

    def __init__(self, problem: Problem, start: Mesh, cross_line: float) -> None:
        self._problem, self._start, self._cross_line = problem, start, cross_line
        n_xi, n_eta = problem.grid.shape
        self._shape, self._per_spacing = (n_xi - 2, n_eta - 2), (float((n_xi - 1) ** 2), float((n_eta - 1) ** 2))
        self._cells = np.empty((3, n_xi - 1, n_eta - 1))
        self._norms: list[float] = []

    @staticmethod
    def vector(mesh: Mesh) -> Array:
        """The unknowns of a mesh."""
        return np.concatenate([mesh.x[1:-1, 1:-1].ravel(), mesh.y[1:-1, 1:-1].ravel()])

    def mesh(self, z: Array) -> Mesh:
        """The mesh of the unknowns ``z``."""
        x, y = self._start.x.copy(), self._start.y.copy()
        x[1:-1, 1:-1], y[1:-1, 1:-1] = z.reshape(2, *self._shape)
        if self._problem.boundary is Boundary.ORTHOGONAL:
            for q in (x.T, y):
                q[0, 1:-1] = (4.0 * q[1, 1:-1] - q[2, 1:-1]) / 3.0
                q[-1, 1:-1] = (4.0 * q[-2, 1:-1] - q[-3, 1:-1]) / 3.0
        return Mesh(x, y)

    def is_valid(self, z: Array) -> bool:
        """Whether the mesh of ``z`` has no folds."""
        mesh = self.mesh(z)
        return smallest_jacobian(mesh.x, mesh.y) > 0.0

    def residual(self, z: Array, u: Array | None = None) -> Array:
        """The defects, an equation per unknown; dimensionless. ``u`` is given at all nodes where it is known."""
        mesh, out = self.mesh(z), np.empty((2, *self._shape))
        with np.errstate(all="ignore"):
            cell_metrics(self._problem.metric, mesh.x, mesh.y, self._cells, u)
            defects(mesh.x, mesh.y, self._cells, self._per_spacing, self._cross_line, out)
        return out.reshape(-1)

    @property
    def mean_flux(self) -> float:
        """The mean squared metric length of the coordinate directions in ``start``: the unit of the residual."""
        mesh, (m11, m12, m22) = self._start, self._cells
        cell_metrics(self._problem.metric, mesh.x, mesh.y, self._cells)
        means = []
        for axis, per_spacing in enumerate(self._per_spacing):
            dx, dy = np.diff(mesh.x, axis=axis), np.diff(mesh.y, axis=axis)
            for side in (slice(0, -1), slice(1, None)):
                ends = (slice(None), side) if axis == 0 else (side, slice(None))
                x, y = dx[ends], dy[ends]
                means.append(per_spacing * float(np.mean(m11 * x * x + 2.0 * m12 * x * y + m22 * y * y)))
        return sum(means) / len(means)

    def solver(self, z: Array) -> Callable[[Array], Array]:
        """A function that solves the linear system of Newton's method at ``z``, approximately."""
        there = _Linearisation(self, z)
        return lambda right: gmres(
            there.product, there.precondition, right, tolerance=self._forcing(right), most=MAX_PRODUCTS
        )

    def _forcing(self, right: Array) -> float:
        """The accuracy of the linear system (Eisenstat and Walker 1996, their second choice)."""
        self._norms.append(float(np.abs(right).max()))
        if len(self._norms) == 1 or self._norms[-2] == 0.0:
            return MAX_LINEAR_RESIDUAL
        reduction = self._norms[-1] / self._norms[-2]
        return min(MAX_LINEAR_RESIDUAL, max(MIN_LINEAR_RESIDUAL, LINEAR_SHARE * reduction**2))


class _Linearisation:
    """The Jacobian of the equations at one mesh: its products, and an approximate inverse."""

    def __init__(self, equations: Interior, z: Array) -> None:
        self._equations, self._z = equations, z
        self._value = equations.residual(z)
        self._shape, self._cross_line = equations._shape, equations._cross_line
        self._per_xi, self._per_eta = equations._per_spacing
        mesh, metric = equations.mesh(z), equations._problem.metric
        self._mesh, self._u = mesh, None if metric.arc_length is None else metric.u_with_gradient(mesh.x, mesh.y)
        found = np.empty((4, *self._shape))
        directions(mesh.x, mesh.y, equations._cells, found)
        self._a, self._b, self._c, self._d = found
        self._one_over = 1.0 / (self._a * self._d - self._b * self._c)
        if self._cross_line:
            self._across_p = self._cross_line * self._per_eta * (self._d * self._one_over).mean(axis=1)
            self._across_q = self._cross_line * self._per_xi * (self._a * self._one_over).mean(axis=0)

    def product(self, v: Array) -> Array:
        """The Jacobian times ``v``, by a difference quotient. The change of u is taken from its tangent plane."""
        largest = float(np.abs(v).max())
        if not 0.0 < largest < math.inf:
            return np.zeros_like(v)
        step = QUOTIENT_STEP / (max(self._shape) + 1) / largest
        there = self._z + step * v
        if self._u is None:
            return np.asarray((self._equations.residual(there) - self._value) / step)
        u, u_x, u_y = self._u
        moved = self._equations.mesh(there)
        u = u + u_x * (moved.x - self._mesh.x) + u_y * (moved.y - self._mesh.y)
        return np.asarray((self._equations.residual(there, u) - self._value) / step)

    def precondition(self, r: Array) -> Array:
        """The change of the unknowns that removes the defects ``r``, to leading order."""
        first, second = r.reshape(2, *self._shape)
        if not self._cross_line:
            q = solve_lines(2.0 * self._per_eta, second.T).T
            p = solve_lines(2.0 * self._per_xi, first)
        else:
            q = solve_by_sines(2.0 * self._per_eta, self._across_q, np.ascontiguousarray(second.T)).T
            seen = np.zeros((self._shape[0], self._shape[1] + 2))
            seen[:, 1:-1] = self._b * self._one_over * q
            bent = seen[:, 2:] - 2.0 * seen[:, 1:-1] + seen[:, :-2]
            p = solve_by_sines(2.0 * self._per_xi, self._across_p, first + self._cross_line * self._per_eta * bent)
        change = np.stack([self._d * p - self._b * q, self._a * q - self._c * p]) * self._one_over
        return change.reshape(-1)


# Weights of the cross-line term that are tried, in units of the metric.
CROSS_LINE_WEIGHTS = (0.0, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0)
# The weight with which a start from the uniform mesh begins.
COLD_CROSS_LINE_WEIGHT = 0.3
# Smaller increases of the strength of the monitor are not tried.
MIN_ADVANCE = 1.0 / 64.0
# Newton steps of one attempt. Where a solution is near, a third of them suffice.
MAX_STEPS = 30
# An attempt whose residual is not halved in this many steps leads nowhere.
MAX_STEPS_TO_HALVE = 10
# Nor does one with this many steps in a row of which only the share below was taken.
MAX_SHORT_STEPS = 2
SHORT_STEP = 1.0 / 16.0
# On grids of up to this many points smaller weights and stronger monitors are tried. Finer grids keep the relaxation of
# the coarser ones.
MAX_TRIED_POINTS = 129 * 129
# Residual of a solution, relative to the mean flux, and of one that only leads to the next.
TOLERANCE = 1e-10
ROUGH_TOLERANCE = 1e-3
# The residual of the sides, over that of the interior.
SIDE_SHARE = 0.01
# Points a side, at most, of the uniform mesh on which the unit of the cross-line term is measured.
MAX_SCALE_POINTS = 33


@dataclass(frozen=True, kw_only=True)
class Relaxation:
    """The difference between the requested equations and the solved ones.

    ``strength`` in [0, 1] is the strength of the monitor. ``cross_line`` is the weight of the cross-line term. Its unit
    is the geometric mean of ``sqrt(det M)`` over the reference square.
    """

    strength: float = 1.0
    cross_line: float = 0.0

    @property
    def is_none(self) -> bool:
        """Whether the equations are the requested ones."""
        return self.strength == 1.0 and self.cross_line == 0.0


NONE = Relaxation()


@dataclass(frozen=True)
class Attempt:
    """The record of one Newton step: the relaxation of its equations, the mesh, and the residual."""

    relaxation: Relaxation
    mesh: Mesh
    steps: int
    residual: float
    converged: bool = False


Attempts: TypeAlias = Generator[Attempt, None, Attempt | None]


def attempts(problem: Problem, start: Mesh, before: Relaxation, *, rough: bool = False) -> Attempts:
    """Newton steps to a solution as near to the requested one as can be found; returns the last attempt.

    ``start`` is a valid mesh, and ``before`` the relaxation of the solution that it comes from. ``rough`` suffices
    where the solution only leads to one on a finer grid. The returned attempt is not ``converged`` only if even the
    problem without any monitor has no solution: then its mesh is uniform. On fine grids a weaker monitor is not
    strengthened any more. ``None`` is returned where it has no solution there.
    """
    uniform = Mesh.uniform(problem.grid)
    cold = bool(np.array_equal(start.x, uniform.x) and np.array_equal(start.y, uniform.y))
    straight = straight_start(problem)
    if before.is_none:
        for first in ([] if cold else [start]) + ([straight] if problem.boundary is Boundary.ORTHOGONAL else []):
            found = yield from _newton(problem, NONE, first)
            if found is not None:
                return found
    found = None
    if before.strength == 1.0:
        found = yield from _climb(problem, [straight] if cold else [start, straight], _first_weight(before, cold))
    else:
        found = yield from _newton(problem, before, start, rough=True)
    if found is not None and found.relaxation.strength == 1.0:
        found = yield from _descend(problem, found)
    elif before.strength == 1.0 or problem.grid.points <= MAX_TRIED_POINTS:
        found = yield from _strengthen(problem, found, uniform)
    polished = yield from _polished(problem, found, rough=rough)
    if polished is not None or not cold:
        return polished
    # A rough solution for the full monitor led to none: a weaker monitor may have one.
    found = yield from _strengthen(problem, None, uniform)
    return (yield from _polished(problem, found, rough=rough)) or _given_up(uniform)


def _first_weight(before: Relaxation, cold: bool) -> float:
    if cold:
        return COLD_CROSS_LINE_WEIGHT
    return before.cross_line or CROSS_LINE_WEIGHTS[1]


def _climb(problem: Problem, starts: list[Mesh], first: float) -> Attempts:
    starts = [ready for start in starts if (ready := with_solved_sides(problem, start, ROUGH_TOLERANCE)) is not None]
    if not starts:
        return None
    for weight_tried in CROSS_LINE_WEIGHTS[CROSS_LINE_WEIGHTS.index(first) :]:
        for start in starts:
            found = yield from _newton(problem, Relaxation(cross_line=weight_tried), start, rough=True)
            if found is not None:
                return found
    return None


def _descend(problem: Problem, found: Attempt) -> Generator[Attempt, None, Attempt]:
    while problem.grid.points <= MAX_TRIED_POINTS and found.relaxation.cross_line > 0.0:
        lower = CROSS_LINE_WEIGHTS[CROSS_LINE_WEIGHTS.index(found.relaxation.cross_line) - 1]
        target = replace(found.relaxation, cross_line=lower)
        better = yield from _newton(problem, target, found.mesh, rough=not target.is_none)
        if better is None:
            break
        found = better
    return found


def _given_up(uniform: Mesh) -> Attempt:
    """The end where no problem has a solution."""
    return Attempt(Relaxation(strength=0.0, cross_line=CROSS_LINE_WEIGHTS[-1]), uniform, 0, np.inf)


def _polished(problem: Problem, found: Attempt | None, *, rough: bool) -> Attempts:
    """The solution to the full tolerance, with a larger weight where it was no solution after all.

    ``None`` where no weight has one. A ``rough`` solution is returned as it is.
    """
    if found is None or rough or not found.converged or found.residual <= TOLERANCE:
        return found
    for weight_tried in CROSS_LINE_WEIGHTS[CROSS_LINE_WEIGHTS.index(found.relaxation.cross_line) :]:
        polished = yield from _newton(problem, replace(found.relaxation, cross_line=weight_tried), found.mesh)
        if polished is not None:
            return polished
    return None


def _strengthen(problem: Problem, known: Attempt | None, uniform: Mesh) -> Generator[Attempt, None, Attempt]:
    """From a weaker monitor with the largest cross-line term in adaptive steps to the requested monitor."""
    if known is None:
        none = Relaxation(strength=0.0, cross_line=CROSS_LINE_WEIGHTS[-1])
        known = yield from _newton(problem, none, uniform, rough=True)
    if known is None:
        return _given_up(uniform)
    advance = (1.0 - known.relaxation.strength) / 3
    while known.relaxation.strength < 1.0 and advance >= MIN_ADVANCE:
        target = replace(known.relaxation, strength=min(1.0, known.relaxation.strength + advance))
        found = yield from _newton(problem, target, known.mesh, rough=True)
        advance = advance / 2 if found is None else 1.5 * advance
        known = known if found is None else found
    return (yield from _descend(problem, known))


def _newton(problem: Problem, relaxation: Relaxation, start: Mesh, *, rough: bool = False) -> Attempts:
    """Newton steps for the equations of ``relaxation``; returns the solution, or ``None``."""
    weaker = problem
    if relaxation.strength < 1.0:
        weaker = replace(problem, monitor=problem.monitor.weakened(relaxation.strength))
    ready = with_solved_sides(weaker, start, SIDE_SHARE * (ROUGH_TOLERANCE if rough else TOLERANCE))
    if ready is None:
        return None
    interior = Interior(weaker, ready, relaxation.cross_line * scale(weaker) if relaxation.cross_line else 0.0)
    floor = smallest_residual(weaker.metric, problem.grid.shape)
    unit, enough = interior.mean_flux, max(ROUGH_TOLERANCE if rough else TOLERANCE, floor)
    steps = newton_iterations(
        interior.residual,
        lambda z: z,
        interior.vector(ready),
        admissible=interior.is_valid,
        tolerance=enough * unit,
        factorise=interior.solver,
    )
    residuals, short = list[float](), 0
    for step in steps:
        residual = step.residual / unit
        attempt = Attempt(relaxation, interior.mesh(step.z), step.step, residual)
        yield attempt
        if residual <= enough:
            return replace(attempt, converged=True)
        residuals.append(residual)
        short = short + 1 if step.damping <= SHORT_STEP else 0
        far = len(residuals) > MAX_STEPS_TO_HALVE and residuals[-1] > 0.5 * residuals[-1 - MAX_STEPS_TO_HALVE]
        if far or short >= MAX_SHORT_STEPS or step.step >= MAX_STEPS:
            break
    return None


def scale(problem: Problem) -> float:
    """The geometric mean of ``sqrt(det M)`` over the reference square, with M on the uniform mesh."""
    shape = (min(problem.grid.n_xi, MAX_SCALE_POINTS), min(problem.grid.n_eta, MAX_SCALE_POINTS))
    mesh = Mesh.uniform(Grid(n_xi=shape[0], n_eta=shape[1]))
    cells = np.empty((3, shape[0] - 1, shape[1] - 1))
    cell_metrics(problem.metric, mesh.x, mesh.y, cells)
    return float(np.exp(0.5 * np.mean(np.log(cells[0] * cells[2] - cells[1] ** 2))))
