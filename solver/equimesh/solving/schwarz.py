"""The Schwarz iteration as a solve, and how it ends."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from equimesh.equations.newton_solve import smallest_tolerance
from equimesh.equations.problem import Problem
from equimesh.inputs import finite_or_none
from equimesh.meshes.mesh import Grid, Mesh
from equimesh.meshes.nested import distance, halved, is_refined, nested_grids, refinement, square_grids
from equimesh.schwarz.conditions import label
from equimesh.schwarz.iteration import schwarz_iterations
from equimesh.schwarz.rates import predicted_rate
from equimesh.schwarz.records import Iteration, IterationNumbers, last_rate
from equimesh.schwarz.settings import Schwarz
from equimesh.single_domain import iteration
from equimesh.single_domain.level import Mode, Step
from equimesh.solving.certificate import safe_discretization_error
from equimesh.solving.single_domain import last_of_newton, last_step, solve_single_domain, what_was_found
from equimesh.solving.solution import Solution, status_unless_folded
from equimesh.solving.status import (
    Initial,
    IterationProgress,
    SolveOptions,
    Status,
    SweepProgress,
    after_folding,
    after_newton,
    after_schwarz,
)
from equimesh.sweeps.verdict import ALGEBRAIC_SHARE

# How a Schwarz iteration ended, from its records: the status, its details, and what to try.


@dataclass(frozen=True, kw_only=True)
class SchwarzEnding:
    """The end of a Schwarz iteration; its fields are fields of :class:`~equimesh.solving.solution.Solution`."""

    status: Status
    newton_steps: int
    residual: float
    detours: tuple[str, ...]
    note: str
    remedy: str
    algebraic_error: float | None


def ending_of(
    problem: Problem,
    schwarz: Schwarz,
    records: Sequence[IterationNumbers],
    tolerance: float | None,
    *,
    nested: bool,
    folded: bool,
) -> SchwarzEnding:
    """The end of the iteration with these ``records``.

    ``tolerance`` is the tolerance of its error, ``None`` for a fixed number of iterations. ``nested`` tells whether it
    started from a mesh that was interpolated from a coarser grid, ``folded`` whether the last mesh is folded.
    """
    last, detours = records[-1], tuple(_detours(schwarz, records))
    notes = [*detours]
    if last.failed:
        status = Status.NEWTON_FAILED
        stuck = ", ".join(str(r.subdomain) for r in last.subdomains if r.stalled)
        what = f"the solve of subdomain {stuck}" if stuck else "the iteration"
        notes.insert(0, f"In iteration {last.iteration} {what} stalled for good.")
    elif tolerance is None:
        status = Status.COMPLETED
    elif last.meets(tolerance):
        status = Status.CONVERGED
        smallest = smallest_tolerance(problem)
        if tolerance < smallest:
            notes.insert(0, f"Rounding allows no tolerance below {smallest:.0e} on this grid; that was met.")
    else:
        status = Status.NOT_CONVERGED
        shown = f"In iteration {last.iteration} the estimated error is {_shown(last.estimate)}"
        notes.insert(0, f"{shown}, and the subdomains differ by {last.mismatch:.1e}.")
    status = status_unless_folded(status, folded=folded)
    return SchwarzEnding(
        status=status,
        newton_steps=sum(r.newton_steps + r.sweeps for record in records for r in record.subdomains),
        residual=max(r.residual for r in last.subdomains),
        detours=detours,
        note=" ".join(notes),
        remedy=_remedy(status, problem, schwarz, records, tolerance, nested=nested),
        algebraic_error=finite_or_none(max(last.estimate, smallest_tolerance(problem))),
    )


def _detours(schwarz: Schwarz, records: Sequence[IterationNumbers]) -> list[str]:
    """Sentences about deviations of the iteration from the request."""
    requested, found = label(schwarz.transmission), []
    rescued = [record.iteration for record in records if any(r.classical for r in record.subdomains)]
    if rescued:
        found.append(
            f"The {requested} condition did not lead to a solution; classical data took its place in {len(rescued)} of"
            f" {records[-1].iteration} iterations, first in iteration {rescued[0]}."
        )
    others = [record for record in records if record.transmission != requested]
    if others:
        first = others[0]
        found.append(
            f"The {requested} condition stalled; from iteration {first.iteration} on the {first.transmission} one took"
            " its place, from the start."
        )
    globally = [record.iteration for record in records if record.global_step]
    if globally:
        found.append(
            f"In iteration {', '.join(map(str, globally))} a Newton step was taken on the whole grid, as a subdomain"
            " had stalled, the merged mesh was folded, or the iteration was slow."
        )
    return found


def _remedy(
    status: Status,
    problem: Problem,
    schwarz: Schwarz,
    records: Sequence[IterationNumbers],
    tolerance: float | None,
    *,
    nested: bool,
) -> str:
    """The remedy after a Schwarz iteration; empty where none is needed."""
    if status is Status.NOT_CONVERGED:
        observed, predicted = last_rate(problem, records), predicted_rate(schwarz.decompose(problem.grid), schwarz)
        slowest = None if observed is None else max(observed, predicted or 0.0)
        return after_schwarz(problem, schwarz, records[-1], slowest, tolerance or 0.0)
    if status is Status.NEWTON_FAILED:
        return after_newton(problem, nested=nested)
    return after_folding(problem, schwarz, nested=nested) if status is Status.FOLDED else ""


def _shown(estimate: float) -> str:
    if math.isfinite(estimate):
        return f"{estimate:.1e}"
    return "not known yet" if math.isnan(estimate) else "not known, as the changes do not fall"


# On grids of at most this many points, the reference for the errors of a Schwarz iteration is solved to rounding.
MAX_POLISHED_POINTS = 129 * 129


def solve_by_schwarz(
    problem: Problem, schwarz: Schwarz, initial: Initial | Mesh, options: SolveOptions, *, allow_relaxed: bool
) -> Solution:
    """The mesh of a Schwarz iteration; where it stalls for good and may fall back, of a single-domain solve."""
    schwarz.decompose(problem.grid)  # refuse what does not fit before any work is done
    start, tolerance, expected = schwarz_start(problem, schwarz, initial, options.part(None, doing="for the start"))
    comparing = options.part(None, doing="to compare")
    reference = schwarz_reference(problem, comparing) if schwarz.compare_single_domain else None
    exact = reference.mesh if reference is not None and reference.is_exact else None
    records: list[Iteration] = []
    settings = replace(schwarz, tolerance=tolerance)
    iterating = options.part(course=IterationProgress(tolerance, schwarz.max_iterations))
    for record in schwarz_iterations(problem, settings, start, exact, threads=options.threads):
        records.append(iterating.observe(record))
        if record.meets(tolerance) or record.iteration >= schwarz.max_iterations:
            break
    note = ""
    if reference is not None and exact is None:
        note = "There is no single-domain solution to compare with: " + what_was_found(reference, problem)
    solution = _finished(problem, schwarz, records, tolerance, note, nested=initial is not Initial.UNIFORM)
    if records[-1].failed and schwarz.fallback:
        return _rescued(solution, options, allow_relaxed=allow_relaxed)
    return replace(solution, discretization_error=safe_discretization_error(expected))


def schwarz_start(
    problem: Problem, schwarz: Schwarz, initial: Initial | Mesh, options: SolveOptions
) -> tuple[Mesh, float | None, float]:
    """The start, the tolerance as a number, and the expected error of the discretisation, NaN where not known."""
    start, expected = initial if isinstance(initial, Mesh) else Mesh.uniform(problem.grid), math.nan
    to_discretization = schwarz.tolerance == "discretization"
    if initial is Initial.NESTED or to_discretization:
        mode = Mode.DISCRETIZATION if to_discretization else Mode.TIGHT
        nested, expected = _nested_start(problem, options, mode)
        start = nested if initial is Initial.NESTED else start
    if isinstance(schwarz.tolerance, float | int):
        return start, float(schwarz.tolerance), expected
    if not to_discretization:
        return start, None, expected
    share = ALGEBRAIC_SHARE * expected
    return start, share if math.isfinite(share) else smallest_tolerance(problem), expected


def _rescued(failed: Solution, options: SolveOptions, *, allow_relaxed: bool) -> Solution:
    """A single-domain solve in place of a Schwarz iteration that stalled for good."""
    telling = options.part(None, doing="without subdomains")
    single = solve_single_domain(failed.problem, Initial.NESTED, telling, Mode.TIGHT, allow_relaxed=allow_relaxed)
    last = failed.iterations[-1]
    stuck = ", ".join(str(r.subdomain) for r in last.subdomains if r.stalled)
    where = f" in subdomain {stuck}" if stuck else ""
    stalled = (
        f"The Schwarz iteration stalled for good in iteration {last.iteration}{where}: this is the mesh of a single"
    )
    return replace(
        single,
        schwarz=failed.schwarz,
        iterations=failed.iterations,
        detours=(*failed.detours, f"{stalled} domain."),
        note=" ".join(text for text in (f"{stalled} domain.", *failed.detours, single.note) if text),
    )


def schwarz_reference(problem: Problem, options: SolveOptions) -> Step:
    """The single-domain solution against which errors are measured: to rounding, if the grid is small enough."""
    step = last_step(problem, Initial.NESTED, options, Mode.TIGHT)
    if step.is_exact and problem.grid.points <= MAX_POLISHED_POINTS:
        return last_of_newton(problem, step.mesh, options, Mode.TIGHT)
    return step


def _nested_start(problem: Problem, options: SolveOptions, mode: Mode) -> tuple[Mesh, float]:
    """The start of a single-domain solve on the finest grid, and the error of the discretisation expected there."""
    coarser = nested_grids(problem.grid)[-2:][0]
    if coarser == problem.grid:
        coarser = halved(problem.grid)
    solved = _solved_on(coarser, problem, options, mode)
    square = square_grids(problem.grid)[-2:][0]
    if not solved[-1].is_exact and square not in (coarser, problem.grid):
        coarser = square
        solved = _solved_on(coarser, problem, options, mode)
    error = solved[-1].discretization_error
    if mode is Mode.DISCRETIZATION and not math.isfinite(error):
        error = _first_error(replace(problem, grid=coarser), solved[-1], options)
    expected = error / refinement(problem.grid, coarser)
    return iteration.guess_on(problem.grid, solved), expected


def _solved_on(grid: Grid, problem: Problem, options: SolveOptions, mode: Mode) -> list[Step]:
    """The last two levels of a single-domain solve on another grid."""
    solved, telling = list[Step](), options.part(course=SweepProgress(mode=mode))
    for step in iteration.single_domain_steps(replace(problem, grid=grid), mode=mode, threads=options.threads):
        telling.observe(step)
        if step.converged or step.failed:
            solved = [*solved[-1:], step]
    return solved


def _first_error(problem: Problem, step: Step, options: SolveOptions) -> float:
    """The error of the discretisation on the coarsest grid, from an additional solve on a still coarser one."""
    coarser = halved(problem.grid)
    other = last_step(replace(problem, grid=coarser), Initial.NESTED, options, Mode.TIGHT)
    if not (step.is_exact and other.is_exact and is_refined(problem.grid, coarser)):
        return math.nan
    return distance(step.mesh, other.mesh) / (refinement(problem.grid, coarser) - 1.0)


def _finished(
    problem: Problem,
    schwarz: Schwarz,
    records: Sequence[Iteration],
    tolerance: float | None,
    note: str,
    *,
    nested: bool,
) -> Solution:
    last = records[-1]
    end = ending_of(problem, schwarz, records, tolerance, nested=nested, folded=last.mesh.is_folded)
    return Solution(
        problem=problem,
        schwarz=schwarz,
        mesh=last.mesh,
        reference=last.reference,
        status=end.status,
        newton_steps=end.newton_steps,
        residual=end.residual,
        iterations=tuple(records),
        detours=end.detours,
        note=" ".join(text for text in (end.note, note) if text),
        remedy=end.remedy,
        algebraic_error=end.algebraic_error,
    )
