"""Solves for the least error, on grids and on blocks: of a function, and of the values of a solver."""

from __future__ import annotations

import math
from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from equimesh.domains.domain import closed_of, map_mesh
from equimesh.equations.problem import Problem
from equimesh.fields.nodal_field import NodalField
from equimesh.fields.quad_field import QuadField
from equimesh.least_error.descent import Descent
from equimesh.least_error.iteration import DescentEnd, LeastErrorSolve
from equimesh.least_error.nest import Level, coarse_level, last_compared
from equimesh.least_error.restricted import Subdomains
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.nested import closed_mesh
from equimesh.meshes.second_order import require_degree
from equimesh.monitors.least_error import LeastError, NodalSolution
from equimesh.quality.measures import measure_errors
from equimesh.rounds.estimate import EarlierValues
from equimesh.rounds.next_mesh import KEPT, Round
from equimesh.rounds.round import adapt_round
from equimesh.solving.orthogonality import Corners
from equimesh.solving.solution import AnySolution, Solution, degree_of, interpolated_cells, status_unless_folded
from equimesh.solving.status import DescentProgress, Initial, SolveOptions, Status, descent_work
from equimesh_schema import Candidate, Estimate

LEAST_ERROR_SETTINGS = ((0.5, 1.0), (0.5, 0.1))
"""``distortion`` and ``smoothness`` that are compared for an ``Auto`` monitor; the first are the defaults."""
GIVEN_IS_KEPT = "No mesh was found with a smaller error than that of the given mesh, which this is."
NO_BETTER = "No mesh was found with a smaller error than that of the {} mesh, which this is."
"""The note of the uniform mesh of a grid, or of the initial one of blocks."""


def solve_least_error(
    problem: Problem[Any],
    initial: Initial | Mesh,
    options: SolveOptions,
    *,
    coarse: DescentEnd | None = None,
    subdomains: Subdomains | None = None,
    corners: Corners | None = None,
) -> AnySolution:
    """The mesh of least error, whose gain is at least 1 in L2 and in the norm of the monitor.

    It is no worse than a mesh that is given to start from, either.

    The descent lowers the error by the quadrature of its meshes. Where the measures of the certificate see no gain, the
    mesh from the uniform start is tried, then for H1 that of L2, and at last the uniform or initial mesh itself is the
    result. ``coarse`` is a mesh of a coarse level from which the same solve continues. ``subdomains`` descend on the
    finest mesh.
    """
    monitor = problem.monitor
    if not isinstance(monitor, LeastError):
        raise TypeError("a least-error solve needs a LeastError monitor")
    solve = _solve(problem, options, subdomains, corners)
    # Straight lines are found anew: a given mesh need not have any.
    start = None if isinstance(initial, Initial) or monitor.rectilinear else initial
    records: list[Descent] = []
    telling = options.part(course=_course(solve, start, initial, coarse))
    steps = solve.steps(start, uniform_only=initial is Initial.UNIFORM, coarse=coarse)
    before = () if coarse is None else _before(coarse)
    found = _finish(problem, solve, steps, telling, records, before)
    if coarse is not None and coarse.errors is not None and coarse.level.is_finest and monitor.cells == "quad":
        vars(found)["interpolation"] = coarse.errors  # of the same mesh
    if start is not None:
        found = _or_given(found, start, monitor.norm)
    if is_no_worse(found, monitor.norm):
        return found
    for other in other_ways(solve, records[-1].start):
        telling = options.part(None, doing="another way", course=_course(solve, None, initial, None))
        again = _finish(problem, solve, other, telling, records, before)
        if is_no_worse(again, monitor.norm):
            return again
    return replace(found, **_initial(problem))


def _solve(
    problem: Problem[Any],
    options: SolveOptions,
    subdomains: Subdomains | None = None,
    corners: Corners | None = None,
) -> LeastErrorSolve:
    monitor: Any = problem.monitor
    solve = LeastErrorSolve(
        monitor=monitor,
        domain=problem.domain,
        grid=problem.grid,
        threads=options.threads,
        subdomains=subdomains,
    )
    return solve if corners is None else replace(solve, **corners._asdict())


def _course(
    solve: LeastErrorSolve,
    start: Mesh | None,
    initial: Initial | Mesh,
    coarse: DescentEnd | None,
) -> DescentProgress:
    """The course of a descent, by its starts and by the levels that are done before."""
    levels = solve.levels
    compared = solve.last_compared(levels if start is None else levels[:-1])
    starts = 1 if start is not None or coarse is not None or initial is Initial.UNIFORM else 2
    return DescentProgress(levels[0 if coarse is None else coarse.level.number + 1 :], starts, compared)


def _before(coarse: DescentEnd) -> tuple[Mapping[str, Any], ...]:
    """The numbers of the steps to a coarse mesh, without the last one where the solve tells it again."""
    return coarse.history[:-1] if coarse.level.is_finest else coarse.history


def other_ways(solve: LeastErrorSolve, start: str) -> Iterator[Iterator[Descent]]:
    """Further ways than from a ``start``: from the uniform or initial mesh, and by the error of u itself.

    The least error of the gradient of a steep front can cost the values of u more than it gains. Subdomains, which
    other processes may hold, know the norm of the monitor alone.
    """
    if start not in {"uniform", "initial"}:
        yield solve.steps(uniform_only=True)
    if solve.monitor.norm == "h1" and solve.subdomains is None:
        yield replace(solve, monitor=replace(solve.monitor, norm="l2").on(solve.domain)).steps()


def _or_given(found: AnySolution, start: Mesh, norm: str) -> AnySolution:
    """The solution, with the mesh that was given to start from where that has the smaller error in ``norm``."""
    placed = _placed(found.problem, start)
    status = status_unless_folded(Status.COMPLETED, folded=placed["mesh"].is_folded_on(found.threads))
    given = replace(found, **placed, status=status, note=GIVEN_IS_KEPT)
    monitor, errors = found.problem.monitor, found.interpolation
    if errors is None or monitor.u is None:
        return found
    kind, degree = interpolated_cells(monitor), degree_of(monitor)
    others = measure_errors(given.mesh, monitor.u, kind=kind, degree=degree, threads=found.threads, alone=True)
    is_kept = others.l2 < errors.l2 if norm == "l2" else others.h1 < errors.h1
    return given if is_kept and not given.cut_off.is_much else found


def is_no_worse(solution: AnySolution, norm: str) -> bool:
    """Whether the mesh interpolates u at least as well as the uniform or initial one, in L2 and in ``norm``.

    A mesh that cuts much off the curved sides of the domain is worse: its error is not the error on the domain.
    """
    errors = solution.interpolation
    if errors is None or solution.mesh.is_folded_on(solution.threads) or solution.cut_off.is_much:
        return False
    return all(errors.estimated_gain(one) >= 1.0 for one in {"l2", norm})


def _finish(
    problem: Problem[Any],
    solve: LeastErrorSolve,
    steps: Iterable[Descent],
    options: SolveOptions,
    records: list[Descent],
    before: Sequence[Mapping[str, Any]],
) -> AnySolution:
    """The solution at the end of a descent, whose steps are added to the ``records``.

    ``before`` are the numbers of steps that were taken before.
    """
    first = len(records)
    for record in steps:
        records.append(options.observe(record))
    placed = _placed(problem, records[-1].mesh)
    return Solution(
        problem=problem,
        schwarz=None if solve.subdomains is None else solve.subdomains.settings,
        **placed,
        status=status_unless_folded(Status.COMPLETED, folded=placed["mesh"].is_folded_on(options.threads)),
        newton_steps=sum(record.level + 1 == record.levels for record in records[first:]),
        descent=(*before, *(record.numbers() for record in records)),
        threads=options.threads,
    )


def _placed(problem: Problem[Any], mesh: Mesh) -> dict[str, Any]:
    """The ``mesh`` and the ``reference`` of a solution, by a mesh of the reference square or of the blocks."""
    if not mesh.is_grid:
        found = problem.domain.mesh.moved(mesh.points)
        return {"mesh": found, "reference": found}
    reference = closed_mesh(Mesh(mesh.x, mesh.y), closed_of(problem.domain))
    return {"mesh": map_mesh(reference, problem.domain), "reference": reference}


def _initial(problem: Problem[Any]) -> dict[str, Any]:
    """The mesh with which others are compared, which is valid whatever was found, and its note."""
    initial = problem.initial
    reference = initial if problem.grid is None else Mesh.uniform(problem.grid)
    note = NO_BETTER.format(initial.compared_with)
    return {"mesh": initial, "reference": reference, "status": Status.COMPLETED, "note": note}


def end_of(steps: Generator[Descent, None, DescentEnd], options: SolveOptions) -> DescentEnd:
    """The end of a descent with its history, after all steps were reported to the observer."""
    history = list[Mapping[str, Any]]()
    while True:
        try:
            history.append(options.observe(next(steps)).numbers())
        except StopIteration as end:
            reached: DescentEnd = end.value
            return replace(reached, history=tuple(history))


def comparison_share(levels: Sequence[Level], count: int = len(LEAST_ERROR_SETTINGS)) -> float:
    """The share of a comparison of ``count`` descents in the whole work, if the mesh is of least error afterwards."""
    last, compared = coarse_level(levels).number, last_compared(levels)
    first = count * descent_work(levels[: last + 1], 2, compared)
    return first / (first + descent_work(levels[last + 1 :], 1, compared))


# The solution of one round of adapting: the next mesh for the values of a solver.

NOT_BETTER = "No other mesh is better for these values: this is the mesh that they were given on."


def solve_round(problem: Problem[Any], threads: int, points: int | None = None) -> AnySolution:
    """The solution with the next mesh, and with the estimated error of the values on their own mesh.

    With ``points`` it is one of at most so many, whose counts are chosen: those of its problem. Raises
    :class:`~equimesh.errors.InputError` where the grid, or the cells of blocks, are not those of the values.
    """
    monitor = problem.monitor
    if not isinstance(monitor, NodalSolution):
        raise TypeError("a round needs a NodalSolution monitor")
    if problem.grid is not None:
        monitor.require_grid(problem.grid)
    domain, degree = problem.domain, require_degree(monitor.degree)
    mesh, values = monitor.mesh_on(domain), monitor.nodal.values
    before = monitor.earlier
    found = adapt_round(
        mesh,
        values,
        domain,
        monitor.norm,
        threads,
        degree=degree,
        adjoint=monitor.dual,
        earlier=EarlierValues(before.mesh, before.values) if isinstance(before, NodalField | QuadField) else None,
        cells=monitor.cells,
        points=points,
    )
    return Solution(
        problem=problem if points is None else _with_points_of(problem, monitor, found),
        mesh=found.mesh,
        reference=found.reference,
        status=status_unless_folded(Status.COMPLETED, folded=found.mesh.is_folded),
        note=NOT_BETTER if found.chosen == KEPT else "",
        comparison=_comparison(found),
        estimate=_estimate(found),
        threads=threads,
    )


def _with_points_of(problem: Problem[Any], monitor: NodalSolution, found: Round) -> Problem[Any]:
    """The problem of the points that a round has chosen; on other cells of blocks its monitor has the recovered u."""
    if found.mesh.is_grid:
        return replace(problem, grid=found.mesh.grid)
    domain = problem.domain.with_counts_of(found.mesh)
    return problem if domain is problem.domain else Problem(monitor=monitor.least_error, domain=domain)


def _estimate(found: Round) -> Estimate:
    return Estimate(
        l2=found.estimate,
        h1=found.estimate_h1,
        unresolved=found.unresolved,
        moved_cells=found.moved_cells,
        products=found.products,
    )


def _comparison(found: Round) -> tuple[Candidate, ...]:
    """The candidates, the best one first: how many times smaller their errors are than the estimate."""
    norm = found.norm
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
