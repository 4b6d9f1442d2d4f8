"""The single-domain mesh, by nested iteration from the uniform mesh on a coarse grid to the finest grid.

Every level is solved by the chord iteration. The coarsest level starts from the uniform mesh, a finer one from the
coarser solution. Where the coarsest level does not converge, a solve for half the monitor gives a better start. Where
that fails, too, the same is tried on grids with like numbers of points in both directions, if the requested one has
others. There Newton's method and continuation take over.
"""

import math
from collections.abc import Iterator

import numpy as np

from equimesh.domains.closing import is_closed
from equimesh.equations.problem import Problem
from equimesh.meshes.grid import Grid
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.nested import nested_grids, prolong, square_grids
from equimesh.meshes.parts import Parts
from equimesh.single_domain.climb import Climb, is_extrapolated
from equimesh.single_domain.closed import ClosedClimb
from equimesh.single_domain.level import Level
from equimesh.single_domain.steps import Mode, Step
from equimesh.sweeps.sweep import memory_needed


def single_domain_steps(
    problem: Problem, start: Mesh | None = None, *, mode: Mode = Mode.TIGHT, sweeps: bool = True, threads: int = 1
) -> Iterator[Step]:
    """Sweeps and Newton steps up the nested grids to the single-domain solution.

    ``start`` is a mesh of the problem's own grid: Newton's method then begins there, without nested iteration.
    ``sweeps=False`` uses Newton's method on all levels: a reference, hundreds of times slower on fine grids. The last
    step has ``converged`` or ``failed`` set; its mesh is valid in any case. Where lines are closed, all of it is by
    sweeps.
    """
    if is_closed(problem.domain):
        yield from ClosedClimb(problem, mode, threads).steps(start)
        return
    if start is not None or not sweeps:
        grids = [problem.grid] if start is not None else nested_grids(problem.grid)
        yield from Climb(problem, mode, threads, grids).by_newton(start)
        return
    grids, square = nested_grids(problem.grid), square_grids(problem.grid)
    solved = yield from Climb(problem, mode, threads, grids).by_sweeps(only_requested=square != grids)
    if solved is None:
        yield from Climb(problem, mode, threads, square).by_sweeps(only_requested=False)


def steps_from(problem: Problem, start: Mesh, *, threads: int = 1) -> Iterator[Step]:
    """Sweeps to a tight tolerance from a mesh near the solution, such as that of a monitor a time step earlier.

    Where they do not converge, the steps of :func:`single_domain_steps` without a start.
    """
    if is_closed(problem.domain):
        yield from ClosedClimb(problem, Mode.TIGHT, threads).steps_from(start)
        return
    own = Mesh(start.x.copy(), start.y.copy())
    label = Step(level=0, levels=1, grid=problem.grid, step=0, residual=math.nan, mesh=own)
    memory = np.empty(memory_needed(problem.grid.shape))
    last = yield from Level(problem, label, None, True, memory, Parts.of(problem.grid.shape, threads)).steps()
    if last is None:
        yield from single_domain_steps(problem, mode=Mode.TIGHT, threads=threads)
    else:
        yield last


def guess_on(grid: Grid, solved: list[Step], threads: int = 1) -> Mesh:
    """The last solution on a finer grid, extrapolated from the last two where they solve the same equations."""
    coarser = solved[-2].mesh if is_extrapolated(grid, solved) else None
    return prolong(solved[-1].mesh, grid, coarser, threads=threads)
