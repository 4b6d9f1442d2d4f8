"""The solution on a domain in blocks: of least error, and never worse than the initial mesh."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from equimesh.blocks.blocks import Blocks
from equimesh.equations.problem import Problem
from equimesh.errors import InputError
from equimesh.inputs import choice
from equimesh.least_error.block_subdomains import BlockSubdomains, owners
from equimesh.least_error.descent import Descent
from equimesh.least_error.iteration import DescentEnd, LeastErrorSolve
from equimesh.least_error.nest import Level, coarse_level, last_compared
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.monitors.least_error import MAX_WEIGHT, Auto, LeastError, NodalSolution
from equimesh.schwarz.settings import Schwarz
from equimesh.solving.least_error import other_ways, solve_round
from equimesh.solving.orthogonality import AgainOnBlocks, bounded_blocks
from equimesh.solving.solution import OnBlocks, Solution
from equimesh.solving.status import (
    DescentProgress,
    Initial,
    SolveOptions,
    Status,
    descent_work,
)
from equimesh_schema import Candidate

WEIGHTS = ((0.5, 1.0), (0.5, 0.1))
"""``distortion`` and ``smoothness`` that are compared for an ``Auto`` monitor; the first are the defaults."""
NO_ROUNDS = "values of a solver are adapted to on the whole mesh: leave the Schwarz settings out, or take LeastError"
"""The reason why subdomains are refused for values of a solver."""
KEPT = "No mesh was found with a smaller error than that of the given mesh, which this is."
NO_BETTER = "No mesh was found with a smaller error than that of the initial mesh, which this is."


EQUIDISTRIBUTION_ONLY = ("mode", "allow_relaxed")
"""Options of a solve that blocks do not have."""


def blocks_method(
    problem: Problem[Blocks], schwarz: Schwarz | None, initial: Initial | Mesh | QuadMesh, given: Iterable[str]
) -> Callable[[SolveOptions], OnBlocks]:
    """The function that solves a problem on blocks. Raises for problems that it cannot solve.

    ``given`` are the options of equidistribution that were given, which are refused.
    """
    for name in given:
        raise InputError(f"{name} belongs to equidistribution, which blocks do not have: leave it out", field=name)
    start = check_start(problem.domain, initial)
    if schwarz is not None:
        count_subdomains(problem, schwarz)
    subdomains = None if schwarz is None else BlockSubdomains(settings=schwarz)
    return lambda options: solve_blocks(problem, start, options, subdomains)


def solve_blocks(
    problem: Problem[Blocks],
    initial: Initial | QuadMesh,
    options: SolveOptions,
    subdomains: BlockSubdomains | None = None,
) -> OnBlocks:
    """The mesh of least error, whose gain over the initial mesh is at least 1 in L2 and in the norm of the monitor.

    It is no worse than a mesh that is given to start from, either. Where the measures of the certificate see no gain,
    the result is the initial mesh itself.
    """
    monitor = problem.monitor
    if isinstance(monitor, NodalSolution):
        return solve_round(problem, options.threads)
    start = initial if isinstance(initial, QuadMesh) else None
    if isinstance(monitor, Auto) and start is None:
        found = _chosen(problem, monitor, options, subdomains)
    else:
        solve = _solve(problem, least_error_of(problem), options, subdomains)
        found = _finish(problem, solve, start, options, None)
    if start is not None:
        found = _or_given(found, start)
    elif subdomains is None:
        found = _or_another_way(found, options)
    found = bounded_blocks(found, _again(problem, options, subdomains))
    if is_no_worse(found):
        return found
    return replace(found, mesh=found.initial, reference=found.initial, note=NO_BETTER)


def _or_another_way(found: OnBlocks, options: SolveOptions) -> OnBlocks:
    """The solution, with the mesh of another way where its own is worse than the initial one."""
    problem = found.problem
    if is_no_worse(found):
        return found
    solve = _solve(problem, least_error_of(problem), options, None)
    for steps in other_ways(solve, found.descent[-1]["start"]):
        telling = options.part(None, doing="another way", course=_course(solve.levels))
        other = _ended(problem, solve, [telling.observe(record) for record in steps], options)
        if is_no_worse(other):
            return replace(other, comparison=found.comparison)
    return found


def least_error_of(problem: Problem[Blocks]) -> LeastError:
    """The monitor whose error the solve minimises: for an ``Auto`` that with the default weights."""
    monitor = problem.monitor.least_error() if isinstance(problem.monitor, Auto) else problem.monitor
    if not isinstance(monitor, LeastError):
        raise TypeError("a least-error solve needs a LeastError or an Auto monitor")
    return monitor


def _again(problem: Problem[Blocks], options: SolveOptions, subdomains: BlockSubdomains | None) -> AgainOnBlocks:
    """Solves for smaller angles of non-orthogonality."""
    monitor = least_error_of(problem)

    def again(smallest_angle: float, obliqueness: float, factor: float) -> OnBlocks:
        weights = {name: min(MAX_WEIGHT, factor * getattr(monitor, name)) for name in ("distortion", "smoothness")}
        solve = _solve(problem, replace(monitor, **weights), options, subdomains)
        solve = replace(solve, smallest_angle=smallest_angle, obliqueness=obliqueness)
        return _finish(problem, solve, None, options.part(None, doing="for smaller angles"), None)

    return again


def count_subdomains(problem: Problem[Blocks], schwarz: Schwarz) -> int:
    """The number of subdomains.

    Raises :class:`~equimesh.errors.InputError` for settings of grids, for groups that do not fit the domain, and for
    values of another solver.
    """
    if isinstance(problem.monitor, NodalSolution):
        raise InputError(NO_ROUNDS, field="schwarz")
    schwarz.require_blocks()
    return int(owners(schwarz, problem.domain.mesh).max()) + 1


def is_no_worse(solution: OnBlocks) -> bool:
    """Whether the mesh interpolates u at least as well as the initial mesh, in L2 and in the norm of the monitor.

    A mesh that cuts much off the curved sides of the domain is worse: its error is not the error on the domain.
    """
    errors = solution.interpolation
    if errors is None or solution.mesh.is_folded_on(solution.threads) or solution.cut_off.is_much:
        return False
    return all(errors.estimated_gain(one) >= 1.0 for one in {"l2", _norm(solution.problem)})


def check_start(domain: Blocks, initial: Initial | Mesh | QuadMesh) -> Initial | QuadMesh:
    """The start of a solve.

    Raises :class:`~equimesh.errors.InputError` for a mesh of another domain, and for a folded one.
    """
    if isinstance(initial, Mesh):
        raise InputError("initial is the mesh of a grid: give a QuadMesh of the domain in blocks", field="initial")
    if not isinstance(initial, QuadMesh):
        return choice(Initial, initial, "initial")
    own = domain.mesh
    if initial.points.shape != own.points.shape or not np.array_equal(initial.cells, own.cells):
        raise InputError(
            f"the mesh to start from has {len(initial.points)} points, the domain {len(own.points)}: give a mesh with"
            " the cells of the domain, such as that of a solution on it",
            field="initial",
        )
    if initial.is_folded:
        raise InputError("the mesh to start from has an inverted cell: give a valid one", field="initial")
    return initial


def _solve(
    problem: Problem[Blocks], monitor: LeastError, options: SolveOptions, subdomains: BlockSubdomains | None
) -> LeastErrorSolve:
    bound = monitor.on(problem.domain)
    return LeastErrorSolve(monitor=bound, domain=problem.domain, threads=options.threads, subdomains=subdomains)


def _norm(problem: Problem[Blocks]) -> str:
    return str(getattr(problem.monitor, "norm", "l2"))


@dataclass(frozen=True, kw_only=True, eq=False)
class _WeightsCandidate:
    """A pair of weights, with the end of its descent on a coarse mesh and the expected error."""

    solve: LeastErrorSolve
    reached: DescentEnd
    error: float

    def candidate(self, first_error: float, *, chosen: bool) -> Candidate:
        """The entry of the certificate."""
        monitor = self.solve.monitor
        gain = first_error / self.error if self.error > 0.0 else math.nan
        return Candidate(
            kind="least_error",
            settings={"norm": monitor.norm, "distortion": monitor.distortion, "smoothness": monitor.smoothness},
            gain_l2=gain if monitor.norm == "l2" else math.nan,
            gain_h1=gain if monitor.norm == "h1" else math.nan,
            chosen=chosen,
        )


def _chosen(
    problem: Problem[Blocks], auto: Auto, options: SolveOptions, subdomains: BlockSubdomains | None
) -> OnBlocks:
    """The solution for the weights with the smallest error on a coarse mesh."""
    tried: list[_WeightsCandidate] = []
    share = _comparison_share(_solve(problem, auto.least_error().on(problem.domain), options, subdomains).levels)
    for number, pair in enumerate(WEIGHTS):
        monitor = auto.least_error(*pair).on(problem.domain)
        solve = _solve(problem, monitor, options, subdomains)
        words = f"comparing weights, {number + 1} of {len(WEIGHTS)}"
        begin, end = (share * k / len(WEIGHTS) for k in (number, number + 1))
        level = coarse_level(solve.levels)
        course = _course(solve.levels[: level.number + 1])
        reached = _end_of(solve.coarse(level), options.part(begin, end, words, course))
        tried.append(_WeightsCandidate(solve=solve, reached=reached, error=solve.lifted_error(reached)))
    best = min(tried, key=lambda one: one.error)
    first_error = best.solve.initial_error(best.reached)
    entries = [one.candidate(first_error, chosen=one is best) for one in sorted(tried, key=lambda one: one.error)]
    found = _finish(problem, best.solve, None, options.part(share), best.reached)
    return replace(found, comparison=tuple(entries))


def _finish(
    problem: Problem[Blocks],
    solve: LeastErrorSolve,
    start: QuadMesh | None,
    options: SolveOptions,
    coarse: DescentEnd | None,
) -> OnBlocks:
    """The solution at the end of a descent."""
    done = -1 if coarse is None else coarse.level.number
    telling = options.part(course=_course(solve.levels[done + 1 :], 2 if start is None else 1))
    return _ended(problem, solve, [telling.observe(record) for record in solve.steps(start, coarse=coarse)], options)


def _ended(
    problem: Problem[Blocks], solve: LeastErrorSolve, records: Sequence[Descent], options: SolveOptions
) -> OnBlocks:
    """The solution with the mesh of the last of the ``records``."""
    mesh = records[-1].mesh if records else problem.domain.mesh
    if not isinstance(mesh, QuadMesh):
        raise TypeError("a descent on blocks has meshes of quadrilaterals")
    folded = mesh.is_folded_on(options.threads)
    return Solution(
        problem=problem,
        mesh=mesh,
        reference=mesh,
        status=Status.FOLDED if folded else Status.COMPLETED,
        newton_steps=len(records),
        descent=tuple(record.numbers() for record in records),
        threads=options.threads,
        schwarz=None if solve.subdomains is None else solve.subdomains.settings,
    )


def _or_given(found: OnBlocks, start: QuadMesh) -> OnBlocks:
    """The solution, with the mesh that was given to start from where that has the smaller error."""
    mesh = found.initial.moved(start.points)
    given = replace(found, mesh=mesh, reference=mesh, note=KEPT)
    errors, others = found.interpolation, given.interpolation
    if errors is None or others is None:
        return found
    is_kept = others.l2 < errors.l2 if _norm(found.problem) == "l2" else others.h1 < errors.h1
    return given if is_kept and not given.cut_off.is_much else found


def _end_of(steps: Generator[Descent, None, DescentEnd], options: SolveOptions) -> DescentEnd:
    """The end of a descent, after all steps were reported to the observer."""
    while True:
        try:
            options.observe(next(steps))
        except StopIteration as end:
            reached: DescentEnd = end.value
            return reached


def _course(levels: Sequence[Level], starts: int = 2) -> DescentProgress:
    return DescentProgress(levels, starts, last_compared(levels) if levels and levels[0].number == 0 else -1)


def _comparison_share(levels: Sequence[Level]) -> float:
    """The share of the comparison in the whole work."""
    last, compared = coarse_level(levels).number, last_compared(levels)
    first = len(WEIGHTS) * descent_work(levels[: last + 1], 2, compared)
    return first / (first + descent_work(levels[last + 1 :], 1, compared))
