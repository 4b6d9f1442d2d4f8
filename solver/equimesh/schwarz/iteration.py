"""The nonlinear Schwarz iteration of Haynes and Howse (section 3).

Every subdomain is solved with data from its neighbours, and the solutions are merged to one mesh. This is repeated
until the subdomains agree. Other modules make the iteration faster or guard it: :mod:`~equimesh.schwarz.rescue`,
:mod:`~equimesh.schwarz.line_corrections`, :mod:`~equimesh.schwarz.acceleration`, :mod:`~equimesh.schwarz.claims` and
:mod:`~equimesh.schwarz.stalls`.
"""

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, TypeVar

from equimesh.domains.domain import map_mesh
from equimesh.equations.newton_solve import MAX_FACTORISED_POINTS, smallest_tolerance
from equimesh.equations.problem import Problem
from equimesh.meshes.folding import largest_difference
from equimesh.meshes.mesh import Mesh
from equimesh.monitors.monitor import require_lines
from equimesh.numerics.threads import run_on_threads
from equimesh.schwarz.acceleration import AccelerationResult, accelerator
from equimesh.schwarz.claims import Claim, examine
from equimesh.schwarz.conditions import label
from equimesh.schwarz.families import subdomains_of
from equimesh.schwarz.holding.in_one_process import InOneProcess
from equimesh.schwarz.holding.port import Holding
from equimesh.schwarz.line_corrections import CorrectionResult, LineCorrections
from equimesh.schwarz.ordering import turns
from equimesh.schwarz.port import MergedSolutions, Outcome, Subdomains
from equimesh.schwarz.records import Iteration, IterationNumbers, SubdomainRecord
from equimesh.schwarz.rescue import Rescue
from equimesh.schwarz.settings import Schwarz
from equimesh.schwarz.stalls import Stalls
from equimesh.schwarz.work import traffic, windows_that_read, work

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
    holding = InOneProcess(settings.decompose(problem.grid))
    for record, _ in iterations_on(holding, problem, settings, start, reference, threads=threads):
        assert isinstance(record, Iteration)
        yield record


def iterations_on(
    holding: Holding,
    problem: Problem,
    settings: Schwarz,
    start: Mesh,
    reference: Mesh | None = None,
    *,
    threads: int = 1,
    first: int = 0,
) -> Iterator[tuple[IterationNumbers, Mesh]]:
    """The iterations of the subdomains that this process holds, as :func:`schwarz_iterations`: records and meshes.

    ``start`` and ``reference`` are merged meshes as ``holding`` has them. A record has a mesh where ``holding`` shows
    it. Where ``first`` is more than 0, ``start`` is the mesh after that iteration, and its record is left out.
    """
    run = SchwarzRun(problem, settings, start, threads, holding)
    if first == 0:
        yield run.first(reference), run.mesh
    for number in itertools.count(first + 1):
        if run.stalls.call_for_another_condition(run.rescue):
            run = SchwarzRun(problem, settings.after_fallback(), start, threads, holding)
        elif run.stalls.call_for_newton and problem.grid.points <= MAX_FACTORISED_POINTS:
            run = SchwarzRun(problem, run.settings.after_slow_iterations(), run.mesh, threads, holding)
        record = run.next(number, reference)
        yield record, run.mesh
        if record.failed:
            return


class SchwarzRun:
    """The iteration with one transmission condition: its current mesh, and the guards."""

    def __init__(self, problem: Problem, settings: Schwarz, start: Mesh, threads: int, holding: Holding) -> None:
        self.problem, self.settings, self.mesh, self.threads = problem, settings, start, threads
        require_lines(problem.monitor)
        self.holding, rounding = holding, smallest_tolerance(problem)
        self.enough = max(settings.tolerance, rounding) if isinstance(settings.tolerance, float) else 0.0
        self.turns = turns(holding.decomposition, settings.ordering)
        self.reads = windows_that_read(holding.decomposition, settings)
        self.subdomains = subdomains_of(problem, holding, settings, enough=self.enough, threads=threads)
        self.subdomains.restart(start)
        self.corrections = LineCorrections(problem, threads, holding) if settings.line_corrections else None
        self.accelerator = accelerator(settings, holding, self._all_subdomains, rounding, threads)
        self.rescue, self.stalls = Rescue(problem, holding), Stalls(settings, rounding)

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
            traffic=traffic(self.holding.decomposition, self.settings, self.subdomains, self.turns, corrected.tried),
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
        mesh, subdomains, holding = Mesh(self.mesh.x.copy(), self.mesh.y.copy()), self.subdomains, self.holding
        states, records = dict[int, Mesh](), dict[int, SubdomainRecord]()
        for turn in self.turns:
            subdomains.begin(mesh, turn)
            for k, outcome in self._outcomes([k for k in turn if k in holding.numbers]).items():
                states[k], records[k] = outcome.solution.mesh, outcome.record(k, records.get(k))
                subdomains.keep(k, states[k])
            places = {k: subdomains.place(k) for k in turn}
            holding.merge(turn, states, subdomains.windows, places, self.reads, mesh)
        holding.close_sides(mesh)
        mismatch = holding.mismatch(states, subdomains.windows, mesh)
        every = holding.every({k: record.numbers for k, record in records.items()})
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
        change, estimate = self.holding.distance(accelerated.mesh, before), corrected.estimate
        if accelerated.is_combined or math.isnan(estimate):
            estimate = self.stalls.estimate(change)
        claim = Claim(accelerated.mesh, estimate, change, before)
        is_doubtful = self.stalls.was_slow or self.rescue.has_stepped
        can_examine = math.isfinite(corrected.deviation) and self.problem.grid.points <= MAX_FACTORISED_POINTS
        if estimate <= self.enough and is_doubtful and can_examine:
            return examine(self.problem, self.holding, claim, self.enough)
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
        smallest = self.holding.smallest_jacobian(self.mesh, domain) * ((n_xi - 1) * (n_eta - 1))
        values |= {
            "iteration": number,
            "problem": self.problem,
            "min_jacobian": smallest / domain.area,
            "subdomains": tuple(records),
            "transmission": label(self.settings.transmission),
            "error": None if reference is None else max(max(r.error_x or 0.0, r.error_y or 0.0) for r in records),
        }
        shown = self.holding.shown(self.mesh)
        if shown is None:
            return IterationNumbers(**values)
        return Iteration(mesh=map_mesh(shown, domain), reference=shown, **values)

    def _with_errors(self, records: Sequence[SubdomainRecord], reference: Mesh | None) -> list[SubdomainRecord]:
        """The records with the errors of their subdomains against ``reference``, where it is known."""
        if reference is None:
            return list(records)
        errors = {}
        for k in self.holding.numbers:
            window, state = self.subdomains.windows[k], self.subdomains.state(k, self.mesh)
            place, exact = window.local(window.covered), self.holding.restrict(window, reference)
            pairs = (state.x, exact.x), (state.y, exact.y)
            errors[k] = [largest_difference(one[place], other[place]) for one, other in pairs]
        every = self.holding.every(errors)
        return [replace(r, error_x=every[r.subdomain][0], error_y=every[r.subdomain][1]) for r in records]

    def _all_subdomains(self) -> Subdomains:
        """All subdomains, with whole meshes."""
        if self.holding.is_whole:
            return self.subdomains
        whole = InOneProcess(self.holding.decomposition)
        return subdomains_of(self.problem, whole, self.settings, enough=self.enough, threads=self.threads)


def _in_order(by_number: dict[int, T]) -> tuple[T, ...]:
    return tuple(by_number[k] for k in sorted(by_number))
