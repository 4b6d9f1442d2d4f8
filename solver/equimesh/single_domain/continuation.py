"""Continuation, where sweeps find no solution: Newton's method, then weaker problems.

A weaker problem has a cross-line term with the smallest weight that helps. Where no weight helps, the strength of the
monitor is lowered, too. Both ways lead from an easy problem towards the requested one.
"""

from collections.abc import Generator
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from equimesh.equations.newton_solve import newton_steps
from equimesh.equations.problem import Problem
from equimesh.meshes.grid import Grid
from equimesh.meshes.mesh import Mesh
from equimesh.sweeps.sweep import cell_metrics

# Weights of the cross-line term that are tried, in units of the metric.
CROSS_LINE_WEIGHTS = (0.0, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0)
# The weight with which a start from the uniform mesh begins.
COLD_CROSS_LINE_WEIGHT = 0.3
# Smaller increases of the strength of the monitor are not tried.
MIN_ADVANCE = 1.0 / 64.0
# Newton steps of one attempt. Where a solution is near, a third of them suffice.
MAX_STEPS = 30
# An attempt whose residual is not halved in this many steps leads nowhere.
MAX_STEPS_TO_HALVE = 14
# On grids of up to this many points smaller weights and stronger monitors are tried. Finer grids keep the relaxation of
# the coarser ones.
MAX_TRIED_POINTS = 65 * 65
# Residual of a solution, relative to the mean flux.
TOLERANCE = 1e-10
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


def attempts(problem: Problem, start: Mesh, before: Relaxation) -> Attempts:
    """Newton steps to a solution as near to the requested one as can be found; returns the last attempt.

    ``start`` is a valid mesh, and ``before`` the relaxation of the solution that it comes from. The returned attempt is
    not ``converged`` only if even the problem without any monitor has no solution: then its mesh is uniform. On fine
    grids a weaker monitor is not strengthened any more. ``None`` is returned where it has no solution there.
    """
    found = None
    if before.is_none:
        found = yield from _newton(problem, NONE, start)
        if found is not None:
            return found
    uniform = Mesh.uniform(problem.grid)
    cold = bool(np.array_equal(start.x, uniform.x) and np.array_equal(start.y, uniform.y))
    if before.strength == 1.0:
        found = yield from _climb(problem, [start] if cold else [start, uniform], _first_weight(before, cold))
        if found is not None:
            return (yield from _descend(problem, found))
    else:
        found = yield from _newton(problem, before, start)
    if before.strength < 1.0 and problem.grid.points > MAX_TRIED_POINTS:
        return found
    return (yield from _strengthen(problem, found, uniform))


def _first_weight(before: Relaxation, cold: bool) -> float:
    if cold:
        return COLD_CROSS_LINE_WEIGHT
    return before.cross_line or CROSS_LINE_WEIGHTS[1]


def _climb(problem: Problem, starts: list[Mesh], first: float) -> Attempts:
    for weight_tried in CROSS_LINE_WEIGHTS[CROSS_LINE_WEIGHTS.index(first) :]:
        for start in starts:
            found = yield from _newton(problem, Relaxation(cross_line=weight_tried), start)
            if found is not None:
                return found
    return None


def _descend(problem: Problem, found: Attempt) -> Generator[Attempt, None, Attempt]:
    while problem.grid.points <= MAX_TRIED_POINTS and found.relaxation.cross_line > 0.0:
        lower = CROSS_LINE_WEIGHTS[CROSS_LINE_WEIGHTS.index(found.relaxation.cross_line) - 1]
        better = yield from _newton(problem, replace(found.relaxation, cross_line=lower), found.mesh)
        if better is None:
            break
        found = better
    return found


def _strengthen(problem: Problem, known: Attempt | None, uniform: Mesh) -> Generator[Attempt, None, Attempt]:
    """From a weaker monitor with the largest cross-line term in adaptive steps to the requested monitor."""
    if known is None:
        known = yield from _newton(problem, Relaxation(strength=0.0, cross_line=CROSS_LINE_WEIGHTS[-1]), uniform)
    if known is None:
        return Attempt(Relaxation(strength=0.0, cross_line=CROSS_LINE_WEIGHTS[-1]), uniform, 0, np.inf)
    advance = (1.0 - known.relaxation.strength) / 3
    while known.relaxation.strength < 1.0 and advance >= MIN_ADVANCE:
        target = replace(known.relaxation, strength=min(1.0, known.relaxation.strength + advance))
        found = yield from _newton(problem, target, known.mesh)
        advance = advance / 2 if found is None else 1.5 * advance
        known = known if found is None else found
    return (yield from _descend(problem, known))


def _newton(problem: Problem, relaxation: Relaxation, start: Mesh) -> Attempts:
    weaker = problem
    if relaxation.strength < 1.0:
        weaker = replace(problem, monitor=problem.monitor.weakened(relaxation.strength))
    weight = relaxation.cross_line * scale(weaker) if relaxation.cross_line else 0.0
    residuals: list[float] = []
    for solution in newton_steps(weaker.equations(weight), start, TOLERANCE, MAX_STEPS, fast=True):
        mesh = Mesh.of_unit_square(solution.mesh.x, solution.mesh.y)
        attempt = Attempt(relaxation, mesh, solution.steps, solution.residual, solution.converged)
        yield replace(attempt, converged=False)
        if solution.converged:
            return attempt
        residuals.append(solution.residual)
        if len(residuals) > MAX_STEPS_TO_HALVE and residuals[-1] > 0.5 * residuals[-1 - MAX_STEPS_TO_HALVE]:
            break
    return None


def scale(problem: Problem) -> float:
    """The geometric mean of ``sqrt(det M)`` over the reference square, with M on the uniform mesh."""
    shape = (min(problem.grid.n_xi, MAX_SCALE_POINTS), min(problem.grid.n_eta, MAX_SCALE_POINTS))
    mesh = Mesh.uniform(Grid(n_xi=shape[0], n_eta=shape[1]))
    cells = np.empty((3, shape[0] - 1, shape[1] - 1))
    cell_metrics(problem.metric, mesh.x, mesh.y, cells)
    return float(np.exp(0.5 * np.mean(np.log(cells[0] * cells[2] - cells[1] ** 2))))
