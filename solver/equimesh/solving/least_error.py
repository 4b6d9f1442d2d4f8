"""Solves for the least error: of a function, and of one that is known by the values of a solver."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any

from equimesh.domains.domain import closed_of, map_mesh
from equimesh.equations.problem import Problem
from equimesh.least_error.descent import Descent
from equimesh.least_error.iteration import DescentEnd, LeastErrorSolve
from equimesh.least_error.nest import last_compared, nested_levels
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.nested import closed_mesh
from equimesh.monitors.least_error import LeastError, NodalSolution
from equimesh.rounds.recovery import KEPT, Round
from equimesh.rounds.round import adapt_round
from equimesh.solving.solution import AnySolution, Solution, status_unless_folded
from equimesh.solving.status import DescentProgress, Initial, SolveOptions, Status
from equimesh_schema import Candidate, Estimate

GIVEN_IS_KEPT = "No mesh was found with a smaller error than that of the given mesh, which this is."
NO_BETTER = "No mesh was found with a smaller error than that of the uniform mesh, which this is."


def solve_least_error(
    problem: Problem, initial: Initial | Mesh, options: SolveOptions, coarse: DescentEnd | None = None
) -> Solution:
    """The mesh of least error, whose gain is at least 1 in L2 and in the norm of the monitor.

    It is no worse than a mesh that is given to start from, either.

    The descent lowers the error by the quadrature of its grids. Where the measures of the certificate see no gain, the
    mesh from the uniform start is tried, then for H1 that of L2, and at last the uniform mesh itself is the result.
    ``coarse`` is a mesh of a coarse grid from which the same solve continues.
    """
    if not isinstance(problem.monitor, LeastError):
        raise TypeError("a least-error solve needs a LeastError monitor")
    solve = LeastErrorSolve(monitor=problem.monitor, domain=problem.domain, grid=problem.grid, threads=options.threads)
    # Straight lines are found anew: a given mesh need not have any.
    start = initial if isinstance(initial, Mesh) and not problem.monitor.rectilinear else None
    records: list[Descent] = []
    telling = options.part(course=_course(problem, start, initial, coarse))
    steps = solve.steps(start, uniform_only=initial is Initial.UNIFORM, coarse=coarse)
    found = _finish(problem, steps, telling, records)
    if start is not None:
        found = _or_given(found, start, problem.monitor.norm)
    if is_no_worse(found, problem.monitor.norm):
        return found
    for other in other_ways(solve, records[-1].start):
        telling = options.part(None, doing="another way", course=_course(problem, None, initial, None))
        again = _finish(problem, other, telling, records)
        if is_no_worse(again, problem.monitor.norm):
            return again
    uniform = Mesh.uniform(problem.grid)
    return replace(found, mesh=map_mesh(uniform, problem.domain), reference=uniform, note=NO_BETTER)


def _course(
    problem: Problem, start: Mesh | None, initial: Initial | Mesh, coarse: DescentEnd | None
) -> DescentProgress:
    """The course of a descent, by its starts and by the grids that are done before."""
    levels = nested_levels(problem.grid)
    compared = last_compared(levels if start is None else levels[:-1])
    starts = 1 if start is not None or coarse is not None or initial is Initial.UNIFORM else 2
    return DescentProgress(levels[0 if coarse is None else coarse.level.number + 1 :], starts, compared)


def other_ways(solve: LeastErrorSolve, start: str) -> Iterator[Iterator[Descent]]:
    """Further ways than from a ``start``: from the uniform or initial mesh, and by the error of u itself.

    The least error of the gradient of a steep front can cost the values of u more than it gains.
    """
    if start not in {"uniform", "initial"}:
        yield solve.steps(uniform_only=True)
    if solve.monitor.norm == "h1":
        yield replace(solve, monitor=replace(solve.monitor, norm="l2").on(solve.domain)).steps()


def _or_given(found: Solution, start: Mesh, norm: str) -> Solution:
    """The solution, with the mesh that was given to start from where that has the smaller error in ``norm``."""
    reference = closed_mesh(start, closed_of(found.problem.domain))
    given = replace(found, mesh=map_mesh(reference, found.problem.domain), reference=reference, note=GIVEN_IS_KEPT)
    errors, others = found.interpolation, given.interpolation
    if errors is None or others is None:
        return found
    is_kept = others.l2 < errors.l2 if norm == "l2" else others.h1 < errors.h1
    return given if is_kept and not given.cut_off.is_much else found


def is_no_worse(solution: Solution, norm: str) -> bool:
    """Whether the mesh interpolates u at least as well as the uniform mesh, in L2 and in ``norm``.

    A mesh that cuts much off the curved sides of the domain is worse: its error is not the error on the domain.
    """
    errors = solution.interpolation
    if errors is None or solution.mesh.is_folded or solution.cut_off.is_much:
        return False
    return all(errors.estimated_gain(one) >= 1.0 for one in {"l2", norm})


def _finish(problem: Problem, steps: Iterable[Descent], options: SolveOptions, records: list[Descent]) -> Solution:
    """The solution at the end of a descent, whose steps are added to the ``records``."""
    first = len(records)
    for record in steps:
        records.append(options.observe(record))
    last = records[-1].mesh
    reference = closed_mesh(Mesh(last.x, last.y), closed_of(problem.domain))
    mesh = map_mesh(reference, problem.domain)
    return Solution(
        problem=problem,
        schwarz=None,
        mesh=mesh,
        reference=reference,
        status=status_unless_folded(Status.COMPLETED, folded=mesh.is_folded),
        newton_steps=sum(record.grid == problem.grid for record in records[first:]),
        residual=math.nan,
        descent=tuple(record.numbers() for record in records),
    )


# The solution of one round of adapting: the next mesh for the values of a solver.

NOT_BETTER = "No other mesh is better for these values: this is the mesh that they were given on."


def solve_round(problem: Problem[Any], threads: int) -> AnySolution:
    """The solution with the next mesh, and with the estimated error of the values on their own mesh.

    Raises :class:`~equimesh.errors.InputError` where the grid, or the cells of blocks, are not those of the values.
    """
    monitor = problem.monitor
    if not isinstance(monitor, NodalSolution):
        raise TypeError("a round needs an NodalSolution monitor")
    if problem.grid is not None:
        monitor.require_grid(problem.grid)
    nodal: Any = monitor.nodal
    found = adapt_round(nodal.mesh, nodal.values, problem.domain, monitor.norm, threads)
    return Solution(
        problem=problem,
        mesh=found.mesh,
        reference=found.reference,
        status=status_unless_folded(Status.COMPLETED, folded=found.mesh.is_folded),
        note=NOT_BETTER if found.chosen == KEPT else "",
        comparison=_comparison(found, monitor.norm),
        estimate=_estimate(found),
        threads=threads,
    )


def _estimate(found: Round[Any]) -> Estimate:
    return Estimate(
        l2=found.estimate,
        h1=found.estimate_h1,
        unresolved=found.unresolved,
        moved_cells=found.moved_cells,
    )


def _comparison(found: Round[Any], norm: str) -> tuple[Candidate, ...]:
    """The candidates, the best one first: how many times smaller their errors are than the estimate."""
    before = found.estimate if norm == "l2" else found.estimate_h1
    return tuple(
        Candidate(
            kind="nodal_solution",
            settings={"start": name},
            gain_l2=before / error if norm == "l2" and error > 0.0 else math.nan,
            gain_h1=before / error if norm == "h1" and error > 0.0 else math.nan,
            chosen=name == found.chosen,
        )
        for name, error in sorted(found.candidates.items(), key=lambda item: item[1])
    )
