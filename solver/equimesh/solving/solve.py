"""One call from a problem to its mesh, by a single-domain or a Schwarz solve."""

from dataclasses import replace

import numpy as np

from equimesh.domains.domain import Rectangle, map_mesh
from equimesh.equations.newton_solve import MAX_FACTORISED_POINTS
from equimesh.equations.problem import Problem
from equimesh.equations.rounding import smallest_tolerance
from equimesh.errors import InputError
from equimesh.inputs import choice
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.threads import thread_count
from equimesh.schwarz.settings import Schwarz
from equimesh.single_domain.steps import Mode
from equimesh.solving.options import Initial, Observer, SolveOptions
from equimesh.solving.schwarz import solve_by_schwarz
from equimesh.solving.single_domain import solve_single_domain
from equimesh.solving.solution import Solution, SolveError
from equimesh.sweeps import sweep

# Largest deviation of squared metric lengths from the mean of their line, as a share of it, at which a given mesh is
# near enough to start from: a front may have moved by half a cell.
MAX_START_DEVIATION = 0.25


def solve(
    problem: Problem,
    schwarz: Schwarz | None = None,
    *,
    initial: Initial | Mesh = Initial.NESTED,
    mode: Mode = Mode.DISCRETIZATION,
    allow_relaxed: bool = True,
    threads: int | None = None,
    observe: Observer | None = None,
    check: bool = True,
) -> Solution:
    """The locally equidistributed mesh of ``problem``, by Schwarz iteration if ``schwarz`` is given.

    ``initial`` may be a mesh of the reference square to start from, as the ``reference`` of a solution for a monitor a
    time step earlier; the start is nested all the same where that is far from the solution. ``mode`` says when a
    single-domain solve is done; a Schwarz iteration has a tolerance of its own. Where no valid mesh satisfies the
    equations, ``allow_relaxed`` accepts one of equations near them: its status is ``RELAXED``, and its certificate says
    what was relaxed. ``threads`` share the work on large grids, by default one for every core; the mesh does not depend
    on their number. ``observe`` is called with every step of a single-domain solve (also that of a nested start) and
    with every Schwarz iteration.

    Raises :class:`~equimesh.solving.solution.SolveError`, which carries the partial solution, when the mesh is not the
    requested one; with ``check=False`` the status says so instead. A folded mesh is never a success.
    """
    initial = initial if isinstance(initial, Mesh) else choice(Initial, initial, "initial")
    mode = choice(Mode, mode, "mode")
    options = SolveOptions(mode, allow_relaxed, thread_count(threads), observe)
    _check_start(problem, initial)
    with np.errstate(all="ignore"):  # what is not finite is found where it matters
        is_far = isinstance(initial, Mesh) and not _is_near(problem, initial)
        initial = Initial.NESTED if is_far else initial
        if schwarz is None:
            solution = solve_single_domain(problem, initial, options)
        else:
            solution = solve_by_schwarz(problem, schwarz, initial, options)
    if is_far:
        detour = "The given mesh is too far from the solution to start from; the start was nested."
        note = f"{detour} {solution.note}".strip()
        solution = replace(solution, detours=(detour, *solution.detours), note=note)
    if check and not solution.status.succeeded:
        raise SolveError(solution.message, solution)
    return solution


def _check_start(problem: Problem, initial: Initial | Mesh) -> None:
    """Refuse a grid too coarse for its domain, one too fine for a start from the uniform mesh, and a start that is no
    mesh of the reference square."""
    if isinstance(initial, Mesh):
        _check_mesh(problem, initial)
    if initial is Initial.UNIFORM and problem.grid.points > MAX_FACTORISED_POINTS:
        raise InputError(
            f"a start from the uniform mesh takes Newton's method, on at most {MAX_FACTORISED_POINTS} points;"
            f" {problem.grid} are more: start nested",
            field="initial",
        )
    if type(problem.domain) is not Rectangle and map_mesh(Mesh.uniform(problem.grid), problem.domain).is_folded:
        raise InputError(
            f"the uniform mesh of {problem.grid} points has an inverted cell on this domain: its sides curve too much"
            " for so few points; add grid points",
            field="grid",
        )


def _is_near(problem: Problem, start: Mesh) -> bool:
    return sweep.deviation(problem.metric, problem.boundary, start) <= MAX_START_DEVIATION


def _check_mesh(problem: Problem, start: Mesh) -> None:
    if start.x.shape != problem.grid.shape:
        raise InputError(f"the mesh to start from has {start.grid} points, the grid {problem.grid}", field="initial")
    sides = start.x[0], start.x[-1] - 1.0, start.y[:, 0], start.y[:, -1] - 1.0
    if start.is_folded or any(np.any(np.abs(side) > smallest_tolerance(problem)) for side in sides):
        raise InputError(
            "the mesh to start from must be a valid one of the reference square: give the reference of a solution",
            field="initial",
        )
