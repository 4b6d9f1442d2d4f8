"""The nonlinear Schwarz iteration of Haynes and Howse (section 3).

Every subdomain is solved with data from its neighbours, and the solutions are merged to one mesh. This is repeated
until the subdomains agree. Other modules make the iteration faster or guard it: :mod:`~equimesh.schwarz.rescue`,
:mod:`~equimesh.schwarz.line_corrections`, :mod:`~equimesh.schwarz.acceleration`, :mod:`~equimesh.schwarz.claims` and
:mod:`~equimesh.schwarz.stalls`.
"""

import itertools
import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any, TypeVar

from equimesh.domains.domain import map_mesh
from equimesh.equations.newton_solve import MAX_FACTORISED_POINTS
from equimesh.equations.problem import Problem
from equimesh.equations.rounding import smallest_tolerance
from equimesh.meshes.mesh import Mesh
from equimesh.monitors.monitor import require_lines
from equimesh.numerics.threads import run_on_threads
from equimesh.schwarz.acceleration import AccelerationResult, accelerator
from equimesh.schwarz.claims import Claim, examine
from equimesh.schwarz.conditions import label
from equimesh.schwarz.families import subdomains_of
from equimesh.schwarz.line_corrections import CorrectionResult, LineCorrections
from equimesh.schwarz.ordering import turns
from equimesh.schwarz.port import MergedSolutions, Outcome
from equimesh.schwarz.records import Iteration, SubdomainRecord
from equimesh.schwarz.rescue import Rescue
from equimesh.schwarz.settings import Schwarz
from equimesh.schwarz.stalls import Stalls
from equimesh.schwarz.work import traffic, work

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
    run = SchwarzRun(problem, settings, start, threads)
    yield run.first(reference)
    for number in itertools.count(1):
        if run.stalls.call_for_another_condition(run.rescue):
            run = SchwarzRun(problem, settings.after_fallback(), start, threads)
        elif run.stalls.call_for_newton and problem.grid.points <= MAX_FACTORISED_POINTS:
            run = SchwarzRun(problem, run.settings.after_slow_iterations(), run.mesh, threads)
        record = run.next(number, reference)
        yield record
        if record.failed:
            return


class SchwarzRun:
    """The iteration with one transmission condition: its current mesh, and the guards."""

    def __init__(self, problem: Problem, settings: Schwarz, start: Mesh, threads: int) -> None:
        self.problem, self.settings, self.mesh, self.threads = problem, settings, start, threads
        require_lines(problem.monitor)
        decomposition, rounding = settings.decompose(problem.grid), smallest_tolerance(problem)
        self.enough = max(settings.tolerance, rounding) if isinstance(settings.tolerance, float) else 0.0
        self.turns = turns(decomposition, settings.ordering)
        self.subdomains = subdomains_of(problem, decomposition, settings, enough=self.enough, threads=threads)
        self.subdomains.restart(start)
        self.corrections = LineCorrections(problem, threads) if settings.line_corrections else None
        self.accelerator = accelerator(settings, self.subdomains, rounding, threads)
        self.rescue, self.stalls = Rescue(problem), Stalls(settings, rounding)

    def next(self, number: int, reference: Mesh | None) -> Iteration:
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
            traffic=traffic(self.problem.grid, self.settings, self.subdomains, self.turns, corrected.count),
            products=accelerated.products,
        )

    def first(self, reference: Mesh | None) -> Iteration:
        """The record of the start."""
        records = [
            SubdomainRecord(subdomain=k, newton_steps=0, residual=math.nan) for k in range(len(self.subdomains.windows))
        ]
        return self._record(
            0, reference, change=math.nan, estimate=math.nan, mismatch=0.0, subdomains=tuple(records), failed=False
        )

    def _solve_subdomains(self) -> MergedSolutions:
        """One solve in every subdomain, turn by turn, merged to one mesh."""
        mesh = Mesh(self.mesh.x.copy(), self.mesh.y.copy())
        states, records = dict[int, Mesh](), dict[int, SubdomainRecord]()
        for turn in self.turns:
            self.subdomains.begin(mesh)
            for k, outcome in self._outcomes(turn).items():
                states[k], records[k] = outcome.solution.mesh, outcome.record(k, records.get(k))
                self.subdomains.merge(k, states[k], mesh)
        mesh.x[0], mesh.x[-1], mesh.y[:, 0], mesh.y[:, -1] = 0.0, 1.0, 0.0, 1.0
        mismatch = max(max(window.distance(states[k], mesh)) for k, window in enumerate(self.subdomains.windows))
        return MergedSolutions(mesh, _in_order(states), _in_order(records), mismatch)

    def _outcomes(self, turn: list[int]) -> dict[int, Outcome]:
        """The outcomes of the subdomains of one turn, which threads share."""
        outcomes: dict[int, Outcome] = {}
        threads = min(self.threads, len(turn))

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
        change, estimate = accelerated.mesh.distance(before), corrected.estimate
        if accelerated.is_combined or math.isnan(estimate):
            estimate = self.stalls.estimate(change)
        claim = Claim(accelerated.mesh, estimate, change, before)
        is_doubtful = self.stalls.was_slow or self.rescue.has_stepped
        can_examine = math.isfinite(corrected.deviation) and self.problem.grid.points <= MAX_FACTORISED_POINTS
        if estimate <= self.enough and is_doubtful and can_examine:
            return examine(self.problem, claim, self.enough)
        return claim

    def _continue_from(self, claim: Claim, solutions: MergedSolutions, deviation: float) -> None:
        """Take the claimed mesh for the start of the next iteration."""
        self.mesh = claim.mesh
        if claim.mesh is not solutions.mesh or self.accelerator.maps_merged_meshes:
            self.subdomains.restart(claim.mesh)
        if claim.is_refuted:
            self.accelerator.forget()
        self.stalls.note(solutions, claim.change, deviation)

    def _record(self, number: int, reference: Mesh | None, **values: Any) -> Iteration:
        """The record of the current mesh; ``values`` are the fields that depend on how it was computed."""
        physical = map_mesh(self.mesh, self.problem.domain)
        records = [self._with_error(record, reference) for record in values.pop("subdomains")]
        return Iteration(
            iteration=number,
            problem=self.problem,
            mesh=physical,
            reference=self.mesh,
            min_jacobian=physical.min_jacobian / self.problem.domain.area,
            subdomains=tuple(records),
            transmission=label(self.settings.transmission),
            error=None if reference is None else max(max(r.error_x or 0.0, r.error_y or 0.0) for r in records),
            **values,
        )

    def _with_error(self, record: SubdomainRecord, reference: Mesh | None) -> SubdomainRecord:
        if reference is None:
            return record
        k = record.subdomain
        error_x, error_y = self.subdomains.windows[k].distance(self.subdomains.state(k, self.mesh), reference)
        return replace(record, error_x=error_x, error_y=error_y)


def _in_order(by_number: dict[int, T]) -> tuple[T, ...]:
    return tuple(by_number[k] for k in sorted(by_number))
