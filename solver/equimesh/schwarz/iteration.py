"""The nonlinear Schwarz iteration of Haynes and Howse (section 3).

Every subdomain is solved with data from its neighbours, and the solutions are merged to one mesh. This is repeated
until the subdomains agree. Other modules make the iteration faster or guard it: :mod:`~equimesh.schwarz.iteration`,
:mod:`~equimesh.schwarz.line_corrections`, :mod:`~equimesh.schwarz.acceleration`, :mod:`~equimesh.schwarz.iteration` and
:mod:`~equimesh.schwarz.iteration`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

from equimesh.domains.domain import map_mesh
from equimesh.equations.newton_solve import MAX_FACTORISED_POINTS, newton_steps, smallest_tolerance
from equimesh.equations.problem import Problem
from equimesh.meshes.mesh import Grid, Mesh, largest_difference
from equimesh.monitors.monitor import require_lines
from equimesh.numerics.threads import run_on_threads
from equimesh.schwarz.acceleration import AccelerationResult, accelerator
from equimesh.schwarz.conditions import Classical, Optimized, label
from equimesh.schwarz.decomposition import Decomposition, Ordering, SubdomainWindow, common, points, rim, turns
from equimesh.schwarz.functionals import FunctionalSubdomains
from equimesh.schwarz.line_corrections import CorrectionResult
from equimesh.schwarz.merged_mesh import MergedMeshes
from equimesh.schwarz.optimized import OptimizedSubdomains
from equimesh.schwarz.records import Iteration, IterationNumbers, SubdomainRecord, estimate_error
from equimesh.schwarz.settings import Schwarz
from equimesh.schwarz.subdomains import MergedSolutions, Outcome, Subdomains

# Newton steps on the whole grid, where a subdomain has stalled or the merged mesh is folded.

# After this many steps in a row another condition takes over, or the iteration ends.
MAX_STEPS_IN_A_ROW = 3
# The residual after that many steps, over the one after the first. Above this factor the steps are no progress.
MIN_PROGRESS = 0.9


@dataclass(frozen=True)
class RescueResult:
    """A mesh, and whether it is the result of a step on the whole grid."""

    mesh: Mesh
    is_stepped: bool


class Rescue:
    """Newton steps on the whole grid where they are needed, and the residuals after the last ones in a row.

    ``residuals`` are infinite where the grid is too large for a factorisation.
    """

    def __init__(self, problem: Problem, merged: MergedMeshes) -> None:
        self._problem, self._merged = problem, merged
        self.residuals: list[float] = []
        self.has_stepped = False

    def apply(self, solved: MergedSolutions, before: Mesh) -> RescueResult:
        """The merged mesh, or the one after a guarded Newton step on the whole grid.

        A step starts from the merged mesh, or from the one ``before`` the iteration where the merged mesh is folded.
        """
        is_folded = not self._merged.smallest_jacobian(solved.mesh) > 0.0
        if not (is_folded or solved.has_stalled):
            self.residuals = []
            return RescueResult(solved.mesh, is_stepped=False)
        self.has_stepped = True
        mesh = before if is_folded else solved.mesh
        if self._problem.grid.points > MAX_FACTORISED_POINTS:
            self.residuals.append(math.inf)
            return RescueResult(Mesh(mesh.x.copy(), mesh.y.copy()), is_stepped=True)
        stepped, residual = newton_step(self._problem, self._merged, mesh)
        self.residuals.append(residual)
        return RescueResult(stepped, is_stepped=True)

    @property
    def has_failed(self) -> bool:
        """Whether the limit of steps in a row is reached."""
        return len(self.residuals) >= MAX_STEPS_IN_A_ROW

    @property
    def is_stuck(self) -> bool:
        """Whether the last steps in a row did not reduce the residual."""
        recent = self.residuals[-MAX_STEPS_IN_A_ROW:]
        return len(recent) == MAX_STEPS_IN_A_ROW and not recent[-1] < MIN_PROGRESS * recent[0]


def newton_step(problem: Problem, merged: MergedMeshes, mesh: Mesh) -> tuple[Mesh, float]:
    """The mesh after one guarded Newton step on the whole grid, and its residual relative to the mean flux."""

    def step(meshes: Sequence[Mesh], states: Sequence[Mesh]) -> tuple[Mesh, float]:
        del states
        *_, last = newton_steps(problem.equations(), meshes[0], most_steps=1, fast=True)
        return Mesh.of_unit_square(last.mesh.x, last.mesh.y), last.residual

    stepped, residual = merged.on_whole(step, [mesh])
    assert stepped is not None
    return stepped, residual


# The check of convergence after a slow iteration: a Newton step on the whole grid has to confirm it.


@dataclass(frozen=True)
class Claim:
    """The mesh of an iteration, and the estimate of its error.

    ``change`` is the largest move of a coordinate from the mesh ``before`` the iteration. ``is_refuted`` is set where
    the check moved the mesh by more than the tolerance. All lengths are in units of the reference square.
    """

    mesh: Mesh
    estimate: float
    change: float
    before: Mesh
    is_refuted: bool = False


def examine(problem: Problem, merged: MergedMeshes, claim: Claim, enough: float) -> Claim:
    """The claim after a Newton step on the whole grid.

    Where the step moves the mesh by more than ``enough``, the iteration continues from the mesh of the step.
    """
    stepped, _ = newton_step(problem, merged, claim.mesh)
    moved = merged.distance(stepped, claim.mesh)
    estimate = max(claim.estimate, moved)
    if not moved > enough:
        return Claim(claim.mesh, estimate, claim.change, claim.before)
    return Claim(stepped, estimate, merged.distance(stepped, claim.before), claim.before, is_refuted=True)


# Signs that an iteration stalls, so that another transmission condition takes over.

# After this many iterations in which some subdomain took classical data, another condition takes over.
MAX_CLASSICAL_ITERATIONS = 3
# The change of the mesh over the mismatch of the subdomains, at a fixed point that is not the solution.
MAX_FALSE_CHANGE = 1e-3
# A smaller mismatch, in units of the smallest tolerance, is rounding.
MIN_MISMATCH = 100.0
# Iterations over which changes have to fall.
STALL_WINDOW = 8
# The mean factor by which changes have to fall in one iteration. Above it the iteration has stalled.
MAX_RATE = 0.75
# The same for the classical condition, which is slow by nature.
MAX_CLASSICAL_RATE = 1.0
# After this many iterations the deviation of metric lengths tells whether the iteration will be slow.
JUDGED_ITERATIONS = 2
# A larger relative deviation from the mean of a line is then far from the solution. Usually it is 1e-3 or less.
MAX_EARLY_DEVIATION = 1e-2
# An iteration that took more than this many is slow.
MAX_TRUSTED_ITERATIONS = 8


class Stalls:
    """The changes of an iteration with one transmission condition, and the signs of a stall.

    ``changes`` are the largest moves of a coordinate, iteration by iteration, in units of the reference square.
    """

    def __init__(self, settings: Schwarz, rounding: float) -> None:
        self._settings, self._rounding = settings, rounding
        self.changes: list[float] = []
        self._classical_iterations, self._mismatch, self._deviation = 0, 0.0, math.nan

    def note(self, solved: MergedSolutions, change: float, deviation: float) -> None:
        """Note an iteration; ``deviation`` is the deviation of squared metric lengths from the mean of their line."""
        self._deviation = deviation
        self.changes.append(change)
        self._classical_iterations += solved.is_rescued
        self._mismatch = solved.mismatch

    def estimate(self, change: float) -> float:
        """The remaining error after an iteration that moved the mesh by ``change``; NaN where not known."""
        return estimate_error([math.nan, *self.changes, change], self._rounding)

    @property
    def was_slow(self) -> bool:
        """Whether more iterations were needed than a fast iteration takes."""
        return len(self.changes) + 1 > MAX_TRUSTED_ITERATIONS

    @property
    def call_for_newton(self) -> bool:
        """Whether Newton's method takes over the acceleration: where the first iterations came no nearer."""
        judged = len(self.changes) == JUDGED_ITERATIONS and self._settings.may_take_newton
        return judged and not self._deviation <= MAX_EARLY_DEVIATION

    def call_for_another_condition(self, rescue: Rescue) -> bool:
        """Whether the optimized condition takes over; never where the settings do not allow it."""
        if not self._settings.may_fall_back:
            return False
        if rescue.has_failed or self._classical_iterations >= MAX_CLASSICAL_ITERATIONS:
            return True
        return bool(self.changes) and (self._is_at_false_fixed_point() or self._is_slowing_down())

    def _is_at_false_fixed_point(self) -> bool:
        """Whether the mesh hardly moves although the subdomains do not agree."""
        has_mismatch = self._mismatch > MIN_MISMATCH * self._rounding
        return has_mismatch and self.changes[-1] < MAX_FALSE_CHANGE * self._mismatch

    def _is_slowing_down(self) -> bool:
        """Whether the changes fall too slowly, or not at all."""
        if len(self.changes) <= STALL_WINDOW or self.changes[-1] <= self._rounding:
            return False
        rate = MAX_CLASSICAL_RATE if isinstance(self._settings.transmission, Classical) else MAX_RATE
        return self.changes[-1] >= rate**STALL_WINDOW * self.changes[-1 - STALL_WINDOW]


# Work and traffic of one Schwarz iteration, counted.

BYTES_PER_NUMBER = 8
# Numbers that a line correction sends over an interface for every line that crosses it: the sum of the edges beyond,
# and how far the side of the grid at that end pushes the line.
NUMBERS_PER_CROSSING = 2


def work(grid: Grid, subdomains: Subdomains, records: Sequence[SubdomainRecord], corrections: int) -> int:
    """The number of corrections of nodes."""
    nodes = [window.shape[0] * window.shape[1] for window in subdomains.windows]
    local = sum(nodes[r.subdomain] * max(r.sweeps, r.newton_steps) for r in records)
    return local + corrections * grid.points


def traffic(
    decomposition: Decomposition,
    settings: Schwarz,
    subdomains: Subdomains,
    turns: Sequence[Sequence[int]],
    corrections: int,
) -> int:
    """Bytes that the subdomains send each other, each on its own machine; ``corrections`` are those that were tried.

    Before its solve a subdomain receives the data of its interfaces. After a turn it receives the nodes of its window
    that others have solved. For every line correction it receives the grid lines beyond its interfaces, and numbers for
    each line that crosses them. Not counted are the few numbers on which all agree, whatever the size of the grid.
    """
    reads = windows_that_read(decomposition, settings)
    data = sum(subdomains.sent(turn) for turn in turns)
    nodes = sum(
        points(common(subdomains.place(k), window.slices))
        for turn in turns
        for k in turn
        for window in reads
        if window.part.number != k
    )
    return BYTES_PER_NUMBER * (data + 2 * nodes + corrections * _corrected(decomposition))


def windows_that_read(decomposition: Decomposition, settings: Schwarz) -> list[SubdomainWindow]:
    """The nodes of the merged mesh that every subdomain reads."""
    return [SubdomainWindow(decomposition, part, settings.ghosts) for part in decomposition.parts]


def _corrected(decomposition: Decomposition) -> int:
    """Numbers that all subdomains send in one line correction."""
    windows = [SubdomainWindow(decomposition, part, 1) for part in decomposition.parts]
    ghosts = sum(points(place) for window in windows for place in rim(window).values())
    lines = sum(window.shape[1 - axis] for window in windows for (axis, _), is_open in window.open.items() if is_open)
    return 2 * ghosts + NUMBERS_PER_CROSSING * lines


# The family of subdomains of a transmission condition.


def subdomains_of(
    problem: Problem, merged: MergedMeshes, settings: Schwarz, *, enough: float, threads: int
) -> Subdomains:
    """The subdomains of a decomposition, with the transmission condition of the settings.

    Local solves may end when they move their nodes by no more than ``enough``.
    """
    condition = settings.transmission
    if not isinstance(condition, Optimized):
        return FunctionalSubdomains(problem, merged, condition, settings.solved_by)
    return OptimizedSubdomains(
        problem,
        merged,
        condition,
        settings.solved_by,
        in_turns=settings.ordering is not Ordering.PARALLEL,
        enough=enough,
        threads=threads,
    )


T = TypeVar("T")


def schwarz_iterations(
    problem: Problem, settings: Schwarz, start: Mesh, reference: Mesh | None = None, *, threads: int = 1
) -> Iterator[Iteration]:
    """Schwarz iterations from ``start``, without end unless a subdomain stalls for good.

    One record per iteration; the caller owns the loop, and with it tolerance, limit and deadline. ``start`` and
    ``reference`` are meshes of the reference square, of shape ``(n_xi, n_eta)``. Errors are recorded against
    ``reference``, the single-domain solution. ``threads`` share the subdomains; the meshes do not depend on their
    number. Haynes and Howse, section 3. Raises :class:`~equimesh.errors.DecompositionError` where the subdomains do not
    fit the grid, and :class:`~equimesh.errors.InputError` for a gradient map.

    Where a condition of the paper stalls, the optimized condition takes over from ``start``, if the settings allow it.
    The records name the condition in use. Where the first iterations come no nearer, and the settings leave the choice,
    Newton's method takes over the acceleration.
    """
    merged = MergedMeshes(settings.decompose(problem.grid))
    for record, _ in iterations_on(merged, problem, settings, start, reference, threads=threads):
        assert isinstance(record, Iteration)
        yield record


def iterations_on(
    merged: MergedMeshes,
    problem: Problem,
    settings: Schwarz,
    start: Mesh,
    reference: Mesh | None = None,
    *,
    threads: int = 1,
    first: int = 0,
) -> Iterator[tuple[IterationNumbers, Mesh]]:
    """The iterations of the subdomains of ``merged``, as :func:`schwarz_iterations`: records and meshes.

    ``start`` and ``reference`` are merged meshes as ``merged`` has them. A record has a mesh where ``merged`` shows
    it. Where ``first`` is more than 0, ``start`` is the mesh after that iteration, and its record is left out.
    """
    run = SchwarzRun(problem, settings, start, threads, merged)
    if first == 0:
        yield run.first(reference), run.mesh
    for number in itertools.count(first + 1):
        if run.stalls.call_for_another_condition(run.rescue):
            run = SchwarzRun(problem, settings.after_fallback(), start, threads, merged)
        elif run.stalls.call_for_newton and problem.grid.points <= MAX_FACTORISED_POINTS:
            run = SchwarzRun(problem, run.settings.after_slow_iterations(), run.mesh, threads, merged)
        record = run.next(number, reference)
        yield record, run.mesh
        if record.failed:
            return


class SchwarzRun:
    """The iteration with one transmission condition: its current mesh, and the guards."""

    def __init__(self, problem: Problem, settings: Schwarz, start: Mesh, threads: int, merged: MergedMeshes) -> None:
        self.problem, self.settings, self.mesh, self.threads = problem, settings, start, threads
        require_lines(problem.monitor)
        self.merged, rounding = merged, smallest_tolerance(problem)
        self.enough = max(settings.tolerance, rounding) if isinstance(settings.tolerance, float) else 0.0
        self.turns = turns(merged.decomposition, settings.ordering)
        self.reads = windows_that_read(merged.decomposition, settings)
        self.subdomains = subdomains_of(problem, merged, settings, enough=self.enough, threads=threads)
        self.subdomains.restart(start)
        self.corrections = merged.line_corrections(problem, threads) if settings.line_corrections else None
        self.accelerator = accelerator(settings, merged, self._all_subdomains, rounding, threads)
        self.rescue, self.stalls = Rescue(problem, merged), Stalls(settings, rounding)

    def next(self, number: int, reference: Mesh | None) -> IterationNumbers:
        """One iteration of the paper, with acceleration and guards."""
        before = self.mesh
        solutions = self._solve_subdomains()
        rescued = self.rescue.apply(solutions, before)
        corrected = self._correct_lines(rescued.mesh)
        accelerated = self.accelerator.apply(before, corrected, solutions, self.enough)
        claim = self._claim(before, corrected, accelerated)
        self._continue_from(claim, solutions, corrected.deviation)
        return self._record(
            number,
            reference,
            change=claim.change,
            estimate=claim.estimate,
            mismatch=solutions.mismatch,
            subdomains=solutions.records,
            deviation=corrected.deviation,
            global_step=rescued.is_stepped or claim.is_refuted,
            accelerated=accelerated.is_combined,
            failed=self.rescue.is_stuck and not self.settings.may_fall_back,
            work=work(self.problem.grid, self.subdomains, solutions.records, corrected.count),
            traffic=traffic(self.merged.decomposition, self.settings, self.subdomains, self.turns, corrected.tried),
            products=accelerated.products,
        )

    def first(self, reference: Mesh | None) -> IterationNumbers:
        """The record of the start."""
        records = [
            SubdomainRecord(subdomain=k, newton_steps=0, residual=math.nan) for k in range(len(self.subdomains.windows))
        ]
        return self._record(
            0, reference, change=math.nan, estimate=math.nan, mismatch=0.0, subdomains=tuple(records), failed=False
        )

    def _solve_subdomains(self) -> MergedSolutions:
        """One solve in every subdomain, turn by turn, merged to one mesh."""
        mesh, subdomains, merged = Mesh(self.mesh.x.copy(), self.mesh.y.copy()), self.subdomains, self.merged
        states, records = dict[int, Mesh](), dict[int, SubdomainRecord]()
        for turn in self.turns:
            subdomains.begin(mesh, turn)
            for k, outcome in self._outcomes([k for k in turn if k in merged.numbers]).items():
                states[k], records[k] = outcome.solution.mesh, outcome.record(k, records.get(k))
                subdomains.keep(k, states[k])
            places = {k: subdomains.place(k) for k in turn}
            merged.merge(turn, states, subdomains.windows, places, self.reads, mesh)
        merged.close_sides(mesh)
        mismatch = merged.mismatch(states, subdomains.windows, mesh)
        every = merged.every({k: record.numbers for k, record in records.items()})
        return MergedSolutions(
            mesh, _in_order(states), tuple(SubdomainRecord.of(k, one) for k, one in enumerate(every)), mismatch
        )

    def _outcomes(self, turn: list[int]) -> dict[int, Outcome]:
        """The outcomes of the subdomains of one turn, which threads share."""
        outcomes: dict[int, Outcome] = {}
        threads = max(min(self.threads, len(turn)), 1)

        def solve(thread: int) -> None:
            for k in turn[thread::threads]:
                outcomes[k] = self.subdomains.solve(k)

        run_on_threads(threads, solve)
        return {k: outcomes[k] for k in turn}

    def _correct_lines(self, mesh: Mesh) -> CorrectionResult:
        if self.corrections is None:
            return CorrectionResult(mesh)
        return self.corrections.apply(mesh, self.settings.line_corrections, self.enough)

    def _claim(self, before: Mesh, corrected: CorrectionResult, accelerated: AccelerationResult) -> Claim:
        """The reached mesh and the estimate of its error; where that is doubtful, after an examination."""
        change, estimate = self.merged.distance(accelerated.mesh, before), corrected.estimate
        if accelerated.is_combined or math.isnan(estimate):
            estimate = self.stalls.estimate(change)
        claim = Claim(accelerated.mesh, estimate, change, before)
        is_doubtful = self.stalls.was_slow or self.rescue.has_stepped
        can_examine = math.isfinite(corrected.deviation) and self.problem.grid.points <= MAX_FACTORISED_POINTS
        if estimate <= self.enough and is_doubtful and can_examine:
            return examine(self.problem, self.merged, claim, self.enough)
        return claim

    def _continue_from(self, claim: Claim, solutions: MergedSolutions, deviation: float) -> None:
        """Take the claimed mesh for the start of the next iteration."""
        self.mesh = claim.mesh
        if claim.mesh is not solutions.mesh or self.accelerator.maps_merged_meshes:
            self.subdomains.restart(claim.mesh)
        if claim.is_refuted:
            self.accelerator.forget()
        self.stalls.note(solutions, claim.change, deviation)

    def _record(self, number: int, reference: Mesh | None, **values: Any) -> IterationNumbers:
        """The record of the current mesh; ``values`` are the fields that depend on how it was computed."""
        domain, (n_xi, n_eta) = self.problem.domain, self.problem.grid.shape
        records = self._with_errors(values.pop("subdomains"), reference)
        smallest = self.merged.smallest_jacobian(self.mesh, domain) * ((n_xi - 1) * (n_eta - 1))
        values |= {
            "iteration": number,
            "problem": self.problem,
            "min_jacobian": smallest / domain.area,
            "subdomains": tuple(records),
            "transmission": label(self.settings.transmission),
            "error": None if reference is None else max(max(r.error_x or 0.0, r.error_y or 0.0) for r in records),
        }
        shown = self.merged.shown(self.mesh)
        if shown is None:
            return IterationNumbers(**values)
        return Iteration(mesh=map_mesh(shown, domain), reference=shown, **values)

    def _with_errors(self, records: Sequence[SubdomainRecord], reference: Mesh | None) -> list[SubdomainRecord]:
        """The records with the errors of their subdomains against ``reference``, where it is known."""
        if reference is None:
            return list(records)
        errors = {}
        for k in self.merged.numbers:
            window, state = self.subdomains.windows[k], self.subdomains.state(k, self.mesh)
            place, exact = window.local(window.covered), self.merged.restrict(window, reference)
            pairs = (state.x, exact.x), (state.y, exact.y)
            errors[k] = [largest_difference(one[place], other[place]) for one, other in pairs]
        every = self.merged.every(errors)
        return [replace(r, error_x=every[r.subdomain][0], error_y=every[r.subdomain][1]) for r in records]

    def _all_subdomains(self) -> Subdomains:
        """All subdomains, with whole meshes."""
        if self.merged.is_whole:
            return self.subdomains
        whole = MergedMeshes(self.merged.decomposition)
        return subdomains_of(self.problem, whole, self.settings, enough=self.enough, threads=self.threads)


def _in_order(by_number: dict[int, T]) -> tuple[T, ...]:
    return tuple(by_number[k] for k in sorted(by_number))
