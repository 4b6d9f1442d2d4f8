"""Continuation, where sweeps find no solution: Newton's method, then weaker problems.

Newton's method solves the sides first, then the interior without a matrix.
A weaker problem has a cross-line term with the smallest weight that helps. Where no weight helps, the strength of the
monitor is lowered, too. Both ways lead from an easy problem towards the requested one.
"""

from collections.abc import Generator
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from equimesh.equations.boundary import Boundary
from equimesh.equations.problem import Problem
from equimesh.equations.rounding import smallest_residual
from equimesh.meshes.grid import Grid
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.newton import newton_iterations
from equimesh.single_domain.interior import Interior
from equimesh.single_domain.solved_sides import straight_start, with_solved_sides
from equimesh.sweeps.cell_metrics import cell_metrics

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

    ``strength`` in [0, 1] is that of the monitor. ``cross_line`` is the weight of the cross-line term in units of the
    metric: of the geometric mean of ``sqrt(det M)`` over the reference square.
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
    if found is None or rough or not found.converged or found.residual <= TOLERANCE:
        return found
    return (yield from _polished(problem, found))


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


def _polished(problem: Problem, found: Attempt) -> Attempts:
    """The solution to the full tolerance, with a larger weight where it was no solution after all."""
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
        return Attempt(Relaxation(strength=0.0, cross_line=CROSS_LINE_WEIGHTS[-1]), uniform, 0, np.inf)
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
