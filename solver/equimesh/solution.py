"""One call from a problem to its mesh, by a single-domain or a Schwarz solve."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np

from equimesh import chord, remedies, single_domain, workers
from equimesh.certificate import Certificate, Relaxed
from equimesh.choices import choice
from equimesh.decomposition import Decomposition
from equimesh.domain import Rectangle, mapped
from equimesh.errors import InputError, SolveError
from equimesh.history import observed_rate, plain
from equimesh.interpolation import InterpolationError, interpolation_errors
from equimesh.iteration import Iteration
from equimesh.mesh import Mesh
from equimesh.mesh_data import MeshData
from equimesh.monitor import ArcLength
from equimesh.nested import distance, halved, is_refined, nested_grids, prolong, refinement
from equimesh.problem import Problem
from equimesh.quality import GAUSS_POINTS, Quality, measure
from equimesh.rates import predicted_rate
from equimesh.schwarz import Schwarz, smallest_tolerance
from equimesh.schwarz_iteration import iterate
from equimesh.single_domain import Mode, Step
from equimesh.status import Status
from equimesh.transmission import label

Event: TypeAlias = Step | Iteration
Observer: TypeAlias = Callable[[Event], None]

# A mesh to start from is near the solution if squared metric lengths deviate from the mean of their line by no more
# than this share of it: a front may have moved by half a cell.
NEAR = 0.25
# A reference for the errors of a Schwarz iteration is solved to rounding, by a factorisation, up to so many points.
MOST_POLISHED = 129 * 129


class Initial(StrEnum):
    """Where a solve starts: ``NESTED``, the solution on a grid half as fine; ``UNIFORM``, the uniform mesh."""

    NESTED = "nested"
    UNIFORM = "uniform"


@dataclass(frozen=True, kw_only=True, repr=False)
class Solution:
    """A mesh of the physical domain, how it came about, and whether it is what was asked for.

    ``reference`` is the same mesh on the reference square. ``newton_steps`` (or chord sweeps) and ``residual`` (of a
    sweep, the largest relative deviation of a squared metric length from the mean of its line; of Newton's method,
    relative to the mean flux) are those of the finest grid of a single-domain solve, or summed and largest over the
    subdomains. ``iterations`` is empty for a single-domain solve; ``detours`` say what they did in place of what was
    asked. ``note`` says more of what happened, ``remedy`` what
    to try; it is empty when there is nothing to mend.
    """

    problem: Problem
    schwarz: Schwarz | None
    mesh: Mesh
    reference: Mesh
    status: Status
    newton_steps: int
    residual: float
    mode: Mode | None = None
    iterations: tuple[Iteration, ...] = ()
    detours: tuple[str, ...] = ()
    note: str = ""
    remedy: str = ""
    relaxed: tuple[Relaxed, ...] = ()
    algebraic_error: float | None = None
    discretization_error: float | None = None

    def __repr__(self) -> str:
        return f"<Solution: {self.problem.grid} points, {self.status}, {len(self.iterations)} iterations>"

    @property
    def message(self) -> str:
        """What happened, and what to try."""
        return " ".join(text for text in (self.status.sentence, self.note, self.remedy) if text)

    @cached_property
    def quality(self) -> Quality:
        """All quality measures of the mesh."""
        return measure(self.mesh, self.problem.monitor, uniform=self._uniform)

    @cached_property
    def interpolation(self) -> InterpolationError | None:
        """How well the mesh interpolates u, beside the uniform mesh; ``None`` where there is no u."""
        u = self.problem.monitor.u
        if (
            u is None or self.problem.grid.cells <= GAUSS_POINTS[-1][0]
        ):  # few cells need a rule that sees what is in each
            return self.quality.interpolation_error
        return interpolation_errors(self.mesh, u, self._uniform)

    @cached_property
    def certificate(self) -> Certificate:
        """What is known of the mesh, measured on itself; see :class:`~equimesh.certificate.Certificate`."""
        return Certificate(
            status=self.status,
            mode=self.mode,
            equation_residual=chord.deviation(self.problem.metric, self.problem.boundary, self.reference),
            min_jacobian=self.mesh.min_jacobian / self.problem.domain.area,
            discretization_error=self.discretization_error,
            algebraic_error=self.algebraic_error,
            relaxed=self.relaxed,
            warnings=(*self.detours, *remedies.warnings(self.status, self.relaxed, self.interpolation)),
            interpolation=self.interpolation,
        )

    @property
    def _uniform(self) -> Mesh:
        return mapped(Mesh.uniform(self.problem.grid), self.problem.domain)

    @property
    def decomposition(self) -> Decomposition | None:
        """The subdomains of the Schwarz iteration."""
        return None if self.schwarz is None else self.schwarz.decompose(self.problem.grid)

    @property
    def rate(self) -> float | None:
        """Observed factor by which the error (else the change) falls in one iteration, of the condition used last."""
        floor = smallest_tolerance(self.problem)
        same = [i for i in self.iterations if i.transmission == self.iterations[-1].transmission]
        return observed_rate([i.change if i.error is None else i.error for i in same], floor)

    @property
    def predicted_rate(self) -> float | None:
        """The rate that theory predicts, where there is one; see :func:`equimesh.rates.predicted_rate`."""
        if self.schwarz is None or self.decomposition is None:
            return None
        return predicted_rate(self.decomposition, self.schwarz)

    def convergence(self) -> dict[str, Any]:
        """The history of the Schwarz iteration as plain numbers, ``None`` where a number is not known."""
        return plain(self.iterations, self.rate, self.predicted_rate)

    def data(self) -> MeshData:
        """What a mesh file holds: nodes, u, Q_eq and the owner of every cell."""
        shape = (self.problem.grid.n_xi - 1, self.problem.grid.n_eta - 1)
        owner = np.zeros(shape, dtype=np.int64) if self.decomposition is None else self.decomposition.owner_of_cells()
        field = self.problem.monitor.u
        u = None if field is None else field.evaluate(self.mesh.x, self.mesh.y)[0]
        return MeshData(mesh=self.mesh, u=u, q_eq=self.quality.q_eq.cells, subdomain=owner)


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

    Raises :class:`~equimesh.errors.SolveError`, which carries the partial solution, when the mesh is not what was asked
    for; with ``check=False`` the status says so instead. A folded mesh is never a success.
    """
    initial = initial if isinstance(initial, Mesh) else choice(Initial, initial, "initial")
    mode = choice(Mode, mode, "mode")
    how = _How(mode, allow_relaxed, workers.checked(threads), observe if observe is not None else _ignore)
    _check_start(problem, initial)
    with np.errstate(all="ignore"):  # what is not finite is found where it matters
        is_far = isinstance(initial, Mesh) and not _is_near(problem, initial)
        initial = Initial.NESTED if is_far else initial
        if schwarz is None:
            solution = _single_domain(problem, initial, how)
        else:
            solution = _schwarz(problem, schwarz, initial, how)
    if is_far:
        detour = "The given mesh is too far from the solution to start from; the start was nested."
        note = f"{detour} {solution.note}".strip()
        solution = replace(solution, detours=(detour, *solution.detours), note=note)
    if check and not solution.status.succeeded:
        raise SolveError(solution.message, solution)
    return solution


@dataclass(frozen=True)
class _How:
    """How a solve goes about it, whatever the problem."""

    mode: Mode
    allow_relaxed: bool
    threads: int
    observe: Observer


def _check_start(problem: Problem, initial: Initial | Mesh) -> None:
    """Refuse a grid too coarse for its domain, one too fine for a start from the uniform mesh, and a start that is no
    mesh of the reference square."""
    if isinstance(initial, Mesh):
        _check_mesh(problem, initial)
    if initial is Initial.UNIFORM and problem.grid.points > single_domain.MOST_FACTORISED:
        raise InputError(
            f"a start from the uniform mesh takes Newton's method, on at most {single_domain.MOST_FACTORISED} points;"
            f" {problem.grid} are more: start nested",
            field="initial",
        )
    if type(problem.domain) is not Rectangle and mapped(Mesh.uniform(problem.grid), problem.domain).is_folded:
        raise InputError(
            f"the uniform mesh of {problem.grid} points has an inverted cell on this domain: its sides curve too much"
            " for so few points; add grid points",
            field="grid",
        )


def _is_near(problem: Problem, start: Mesh) -> bool:
    return chord.deviation(problem.metric, problem.boundary, start) <= NEAR


def _check_mesh(problem: Problem, start: Mesh) -> None:
    if start.x.shape != problem.grid.shape:
        raise InputError(f"the mesh to start from has {start.grid} points, the grid {problem.grid}", field="initial")
    sides = start.x[0], start.x[-1] - 1.0, start.y[:, 0], start.y[:, -1] - 1.0
    if start.is_folded or any(np.any(np.abs(side) > smallest_tolerance(problem)) for side in sides):
        raise InputError(
            "the mesh to start from must be a valid one of the reference square: give the reference of a solution",
            field="initial",
        )


def _ignore(event: Event) -> None:
    del event


def _single_domain(problem: Problem, initial: Initial | Mesh, how: _How) -> Solution:
    step, nested = _last_step(problem, initial, how), initial is not Initial.UNIFORM
    reference = _on_grid(step.mesh, problem)
    mesh, status = mapped(reference, problem.domain), _status(step, how)
    exact = status is Status.CONVERGED
    return Solution(
        problem=problem,
        schwarz=None,
        mesh=mesh,
        reference=reference,
        status=_checked(status, mesh),
        mode=how.mode,
        newton_steps=step.step,
        residual=step.residual,
        note="" if exact else _what_was_found(step, problem),
        remedy=_single_domain_remedy(step, problem, status, folded=mesh.is_folded, nested=nested),
        relaxed=_relaxed(step, problem),
        algebraic_error=_known(step.algebraic_error),
        discretization_error=_known(step.discretization_error),
    )


def _single_domain_remedy(step: Step, problem: Problem, status: Status, *, folded: bool, nested: bool) -> str:
    if folded:
        return remedies.after_mapping()
    exact = status is Status.CONVERGED
    return "" if exact else remedies.after_newton(problem, nested=nested, reached=step.strength)


def _status(step: Step, how: _How) -> Status:
    if step.is_exact:
        return Status.CONVERGED
    relaxed = how.allow_relaxed and step.converged and step.strength > 0.0
    return Status.RELAXED if relaxed else Status.NEWTON_FAILED


def _known(error: float) -> float | None:
    return error if math.isfinite(error) else None


def _relaxed(step: Step, problem: Problem) -> tuple[Relaxed, ...]:
    """What the equations that the mesh satisfies differ by from the asked ones."""
    found, monitor = [], problem.monitor
    if step.strength < 1.0:
        what, asked = ("a", monitor.a) if isinstance(monitor, ArcLength) else ("strength", 1.0)
        found.append(Relaxed(what=what, asked=asked, reached=step.strength * asked))
    if step.relaxation.cross_line > 0.0:
        found.append(Relaxed(what="cross_line", asked=0.0, reached=step.relaxation.cross_line))
    if step.solved is not None and step.solved != problem.grid:
        found.append(Relaxed(what="points", asked=max(problem.grid.shape), reached=max(step.solved.shape)))
    return tuple(found)


def _last_step(problem: Problem, initial: Initial | Mesh, how: _How) -> Step:
    if isinstance(initial, Mesh):
        return _last(single_domain.iterate_from(problem, initial, threads=how.threads), how.observe)
    start = Mesh.uniform(problem.grid) if initial is Initial.UNIFORM else None
    return _last(single_domain.iterate(problem, start, mode=how.mode, threads=how.threads), how.observe)


def _reference(problem: Problem, how: _How) -> Step:
    """The single-domain solution to rounding, as far as that is affordable: errors are measured against it."""
    step = _last_step(problem, Initial.NESTED, replace(how, mode=Mode.TIGHT))
    if step.is_exact and problem.grid.points <= MOST_POLISHED:
        return _last(single_domain.iterate(problem, step.mesh), how.observe)
    return step


def _last(steps: Iterable[Step], observe: Observer) -> Step:
    step = None
    for step in steps:
        observe(step)
    if step is None:
        raise AssertionError("a single-domain solve yields at least its start")
    return step


def _schwarz(problem: Problem, schwarz: Schwarz, initial: Initial | Mesh, how: _How) -> Solution:
    schwarz.decompose(problem.grid)  # refuse what does not fit before any work is done
    to_discretization = schwarz.tolerance == "discretization"
    start, expected = initial if isinstance(initial, Mesh) else Mesh.uniform(problem.grid), math.nan
    if initial is Initial.NESTED or to_discretization:
        mode = Mode.DISCRETIZATION if to_discretization else Mode.TIGHT
        nested, expected = _nested_start(problem, replace(how, mode=mode))
        start = nested if initial is Initial.NESTED else start
    tolerance: float | None = None if schwarz.tolerance is None else smallest_tolerance(problem)
    if isinstance(schwarz.tolerance, float | int):
        tolerance = float(schwarz.tolerance)
    elif to_discretization and math.isfinite(expected):
        tolerance = single_domain.SHARE * expected
    reference = None
    if schwarz.compare_single_domain:
        reference = _reference(problem, how)
    known = reference.mesh if reference is not None and reference.is_exact else None
    records: list[Iteration] = []
    for record in iterate(problem, replace(schwarz, tolerance=tolerance), start, known, threads=how.threads):
        records.append(record)
        how.observe(record)
        if record.meets(tolerance) or record.iteration >= schwarz.max_iterations:
            break
    note = ""
    if reference is not None and known is None:
        note = "There is no single-domain solution to compare with: " + _what_was_found(reference, problem)
    solution = _finished(problem, schwarz, records, tolerance, note, nested=initial is not Initial.UNIFORM)
    if records[-1].failed and schwarz.fallback:
        return _rescued(solution, how)
    return replace(solution, discretization_error=_known(expected))


def _rescued(failed: Solution, how: _How) -> Solution:
    """The mesh of a single-domain solve, in place of that of a Schwarz iteration that stalled for good."""
    single = _single_domain(failed.problem, Initial.NESTED, replace(how, mode=Mode.TIGHT))
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


def _nested_start(problem: Problem, how: _How) -> tuple[Mesh, float]:
    """The mesh that a single-domain solve would start from on the finest grid, and the error of the discretisation
    that is to be expected there."""
    coarser = nested_grids(problem.grid)[-2:][0]
    if coarser == problem.grid:
        coarser = halved(problem.grid)
    solved: list[Step] = []
    for step in single_domain.iterate(replace(problem, grid=coarser), mode=how.mode, threads=how.threads):
        how.observe(step)
        if step.converged or step.failed:
            solved = [*solved[-1:], step]
    error = solved[-1].discretization_error
    if how.mode is Mode.DISCRETIZATION and not math.isfinite(error):
        error = _first_error(replace(problem, grid=coarser), solved[-1], how)
    expected = error / refinement(problem.grid, coarser)
    return single_domain.guess_on(problem.grid, solved), expected


def _first_error(problem: Problem, step: Step, how: _How) -> float:
    """The error of the discretisation on a grid that has no coarser one, from one made for the purpose."""
    coarser = halved(problem.grid)
    other = _last_step(replace(problem, grid=coarser), Initial.NESTED, replace(how, mode=Mode.TIGHT))
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
    detours = tuple(_detours(schwarz, records))
    notes = [*detours, note]
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
    solution = Solution(
        problem=problem,
        schwarz=schwarz,
        mesh=last.mesh,
        reference=last.reference,
        status=_checked(status, last.mesh),
        newton_steps=sum(r.newton_steps + r.sweeps for record in records for r in record.subdomains),
        residual=max(r.residual for r in last.subdomains),
        iterations=tuple(records),
        detours=detours,
        note=" ".join(text for text in notes if text),
        algebraic_error=_known(max(last.estimate, smallest_tolerance(problem))),
    )
    return replace(solution, remedy=_remedy(solution, tolerance, nested=nested))


def _detours(schwarz: Schwarz, records: Sequence[Iteration]) -> list[str]:
    """What was done in place of what was asked for."""
    asked, found = label(schwarz.transmission), []
    rescued = [record.iteration for record in records if any(r.classical for r in record.subdomains)]
    if rescued:
        found.append(
            f"The {asked} condition did not lead to a solution; classical data took its place in {len(rescued)} of"
            f" {records[-1].iteration} iterations, first in iteration {rescued[0]}."
        )
    others = [record for record in records if record.transmission != asked]
    if others:
        first = others[0]
        found.append(
            f"The {asked} condition stalled; from iteration {first.iteration} on the {first.transmission} one took its"
            " place, from the start."
        )
    globally = [record.iteration for record in records if record.global_step]
    if globally:
        found.append(
            f"In iteration {', '.join(map(str, globally))} a Newton step was taken on the whole grid, as a subdomain"
            " had stalled, the merged mesh was folded, or the iteration was slow."
        )
    return found


def _remedy(solution: Solution, tolerance: float | None, *, nested: bool) -> str:
    """What to try after a Schwarz iteration."""
    problem, schwarz, last = solution.problem, solution.schwarz, solution.iterations[-1]
    if schwarz is not None and solution.status is Status.NOT_CONVERGED:
        rates = [rate for rate in (solution.rate, solution.predicted_rate) if rate is not None]
        slowest = max(rates) if solution.rate is not None else None
        return remedies.after_schwarz(problem, schwarz, last, slowest, tolerance or 0.0)
    if solution.status is Status.NEWTON_FAILED:
        return remedies.after_newton(problem, nested=nested)
    return remedies.after_folding(problem, schwarz, nested=nested) if solution.status is Status.FOLDED else ""


def _shown(estimate: float) -> str:
    if math.isfinite(estimate):
        return f"{estimate:.1e}"
    return "not known yet" if math.isnan(estimate) else "not known, as the changes do not fall"


def _checked(status: Status, mesh: Mesh) -> Status:
    return Status.FOLDED if status.succeeded and mesh.is_folded else status


def _on_grid(mesh: Mesh, problem: Problem) -> Mesh:
    """The mesh on the problem's own grid, also where the solve ended on a coarser one."""
    return mesh if mesh.x.shape == problem.grid.shape else prolong(mesh, problem.grid)


def _what_was_found(step: Step, problem: Problem) -> str:
    """What the mesh of a solve that did not reach the asked equations satisfies."""
    asked, name = (problem.monitor.a, "a") if isinstance(problem.monitor, ArcLength) else (1.0, "strength")
    where = "" if step.grid == problem.grid else f" on the {step.grid} grid"
    if step.failed or step.strength == 0.0:
        slopes = problem.metric.u_with_gradient(step.mesh.x, step.mesh.y)
        reason = "" if np.isfinite(slopes).all() else " The gradient of u is not finite everywhere on the domain."
        return f"No mesh was found{where} that satisfies any of the equations tried, down to {name} = 0.{reason}"
    found = [f"{name} = {step.strength * asked:.3g} of {asked:.3g}"] if step.strength < 1.0 else []
    if step.relaxation.cross_line > 0.0:
        found.append(f"a cross-line term of weight {step.relaxation.cross_line:g}")
    added = f" with {' and '.join(found)}" if found else ""
    if step.solved is not None and step.solved != problem.grid:
        return f"A mesh of {step.solved} points satisfies the equations{added}; this one is interpolated from it."
    return f"The mesh satisfies the equations{added}{where}."
