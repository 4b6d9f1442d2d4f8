"""The nonlinear Schwarz iteration: subdomain solves that exchange interface data until they agree."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

from equimesh.domains.domain import map_mesh
from equimesh.equations.newton_solve import newton_steps
from equimesh.equations.problem import Problem
from equimesh.equations.rounding import smallest_tolerance
from equimesh.meshes.folding import largest_difference, smallest_jacobian
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.threads import run_on_threads
from equimesh.schwarz.anderson import Anderson
from equimesh.schwarz.conditions import Classical, Optimized, label
from equimesh.schwarz.functionals.subdomains import FunctionalSubdomains
from equimesh.schwarz.line_corrections import Corrected, LineCorrections
from equimesh.schwarz.optimized.subdomains import MOST_FACTORISED, YieldingSubdomains
from equimesh.schwarz.ordering import Ordering, turns
from equimesh.schwarz.port import Outcome, Subdomains
from equimesh.schwarz.raspen import Raspen
from equimesh.schwarz.records import Iteration, SubdomainRecord, estimated
from equimesh.schwarz.settings import Acceleration, Schwarz

# After this many iterations in which some subdomain had to take classical data, another condition takes over.
MOST_RESCUES = 3
# In so many iterations in a row may a subdomain stall, or the merged mesh fold: then the fallback comes or, if Newton
# steps on the whole grid do not lower the residual by this factor in that time, the end.
MOST_STALLS, PROGRESS = 3, 0.9
# An iteration that moves the mesh by less than this fraction of the mismatch has found a fixed point that is not the
# solution; a mismatch is one if it is so many times what rounding leaves.
FALSE_FIXED_POINT, SEEN = 1e-3, 100.0
# Iterations are combined once squared metric lengths deviate from the mean of their line by no more than this of it.
LINEAR = 0.1
# An iteration that took more than so many, or Newton steps on the whole grid, is tested by one before it is believed.
FEW = 8
# Changes that fall by less than this factor over so many iterations are a stall; those with classical data, slow by
# nature, only where they do not fall at all.
SLOWEST, STALL_WINDOW = 0.75, 8


def iterate(
    problem: Problem, settings: Schwarz, start: Mesh, reference: Mesh | None = None, *, threads: int = 1
) -> Iterator[Iteration]:
    """Schwarz iterations from ``start``, without end unless a subdomain stalls for good.

    One record per iteration; the caller owns the loop, and with it tolerance, limit and deadline. ``reference`` is
    the single-domain solution against which errors are recorded. ``threads`` share the subdomains; the meshes do not
    depend on their number. Haynes and Howse, section 3.

    Where a subdomain stalls, a Newton step is taken on the whole grid. Where a condition of the paper gives a
    subdomain no solution for good, or a fixed point on which the subdomains do not agree, or none at all, the
    optimized condition takes over from the start, if the settings allow it; the records say so. An iteration that was
    slow is tested by a Newton step on the whole grid before its estimate is believed.
    """
    run = _Run(problem, settings, start, threads)
    yield run.record(0, reference)
    for number in range(1, 10**9):
        run.step()
        record = run.record(number, reference)
        yield record
        if record.failed:
            return


class _Run:
    """The state of a Schwarz iteration."""

    def __init__(self, problem: Problem, settings: Schwarz, start: Mesh, threads: int) -> None:
        self.problem, self.start, self.threads = problem, start, threads
        self.decomposition = settings.decompose(problem.grid)
        self.rounding = smallest_tolerance(problem)
        self.mesh, self.changes = start, [math.nan]
        self.corrections = LineCorrections(problem, threads) if settings.line_corrections else None
        self._begin(settings)
        count = len(self.subdomains.windows)
        self.records = tuple(SubdomainRecord(subdomain=k, newton_steps=0, residual=math.nan) for k in range(count))
        self.mismatch = 0.0
        self.corrected = Corrected(start)
        self.global_step = self.accelerated = False
        self.work = self.traffic = self.products = 0

    def _begin(self, settings: Schwarz) -> None:
        """Begin from the start with these settings."""
        self.settings = settings
        self.enough = max(settings.tolerance, self.rounding) if isinstance(settings.tolerance, float) else 0.0
        self.subdomains = self._subdomains()
        self.turns = turns(self.decomposition, settings.ordering)
        self.states = [window.restrict(self.start) for window in self.subdomains.windows]
        self.mesh = self.start
        self.stalls, self.rescues = [0] * len(self.states), 0
        self.setbacks: list[float] = []
        self.has_stepped, self.estimate = False, math.nan
        if settings.line_corrections and self.corrections is None:
            self.corrections = LineCorrections(self.problem, self.threads)
        self.anderson = Anderson() if settings.accelerated_by is Acceleration.ANDERSON else None
        by_newton = settings.accelerated_by is Acceleration.NEWTON
        self.newton = Raspen(self.subdomains, self.rounding, self.threads) if by_newton else None
        self.since = len(self.changes)

    def _subdomains(self) -> Subdomains:
        settings, condition = self.settings, self.settings.transmission
        if not isinstance(condition, Optimized):
            return FunctionalSubdomains(self.problem, self.decomposition, condition, settings.solved_by)
        return YieldingSubdomains(
            self.problem, self.decomposition, condition, settings.solved_by, enough=self.enough, threads=self.threads
        )

    def step(self) -> None:
        """One iteration."""
        if self._has_stalled():
            self._begin(self.settings.fallen_back())
        start = self.mesh
        merged = self._solved()
        folded = not smallest_jacobian(merged.x, merged.y) > 0.0
        self.mismatch = max(
            max(window.distance(state, merged))
            for window, state in zip(self.subdomains.windows, self.states, strict=True)
        )
        stepped = self._stepped(start if folded else merged, needed=folded or max(self.stalls) > 0)
        self.corrected = Corrected(stepped)
        if self.corrections is not None and self.settings.line_corrections:
            self.corrected = self.corrections.apply(stepped, self.settings.line_corrections, self.enough)
        self.mesh = self._accelerated(start, self.corrected)
        # Newton's method knows the iteration as a map of merged meshes: all data is to come from one.
        if not self.settings.is_optimized and (self.mesh is not merged or self.newton is not None):
            self.states = [window.restrict(self.mesh) for window in self.subdomains.windows]
        self.changes.append(_distance(self.mesh, start))
        self.estimate = self._estimated()
        if self.estimate <= self.enough and self._is_doubtful:
            self._test(start)
        self._count()

    def record(self, number: int, reference: Mesh | None) -> Iteration:
        """What there is to say of the last iteration."""
        physical = map_mesh(self.mesh, self.problem.domain)
        records = [self._with_error(record, reference) for record in self.records]
        return Iteration(
            iteration=number,
            problem=self.problem,
            mesh=physical,
            reference=self.mesh,
            min_jacobian=physical.min_jacobian / self.problem.domain.area,
            change=self.changes[-1],
            estimate=self.estimate,
            mismatch=self.mismatch,
            subdomains=tuple(records),
            transmission=label(self.settings.transmission),
            deviation=self.corrected.deviation,
            error=None if reference is None else max(max(r.error_x or 0.0, r.error_y or 0.0) for r in records),
            global_step=self.global_step,
            accelerated=self.accelerated,
            failed=self._is_stuck and not self._may_fall_back(),
            work=self.work,
            traffic=self.traffic,
            products=self.products,
        )

    def _stepped(self, mesh: Mesh, *, needed: bool) -> Mesh:
        """The mesh after a guarded Newton step on the whole grid, where one is ``needed``.

        Itself, or a copy, where there is none to take, or a factorisation would cost too much.
        """
        self.global_step = needed
        self.has_stepped = self.has_stepped or needed
        if not needed:
            self.setbacks = []
            return mesh
        if self.problem.grid.points > MOST_FACTORISED:
            self.setbacks.append(math.inf)
            return Mesh(mesh.x.copy(), mesh.y.copy())
        *_, last = newton_steps(self.problem.equations(), mesh, most_steps=1, fast=True)
        self.setbacks.append(last.residual)
        return Mesh.of_unit_square(last.mesh.x, last.mesh.y)

    @property
    def _is_stuck(self) -> bool:
        """Whether Newton steps on the whole grid, taken several times in a row, lead nowhere."""
        recent = self.setbacks[-MOST_STALLS:]
        return len(recent) == MOST_STALLS and not recent[-1] < PROGRESS * recent[0]

    def _solved(self) -> Mesh:
        """One solve in every subdomain, turn by turn; the merged mesh."""
        mesh, found = Mesh(self.mesh.x.copy(), self.mesh.y.copy()), dict[int, SubdomainRecord]()
        whole = self.settings.is_optimized and self.settings.ordering is not Ordering.PARALLEL
        for turn in self.turns:
            self.subdomains.begin(self.states, mesh)
            for k, outcome in self._outcomes(turn).items():
                window = self.subdomains.windows[k]
                self.states[k] = outcome.solution.mesh
                window.write(self.states[k], mesh, window.covered if whole else window.part.owned)
                found[k] = _record(k, outcome, found.get(k))
        self.records = tuple(found[k] for k in range(len(self.states)))
        self.stalls = [n + 1 if r.stalled else 0 for n, r in zip(self.stalls, self.records, strict=True)]
        self.rescues += any(record.classical for record in self.records)
        mesh.x[0], mesh.x[-1], mesh.y[:, 0], mesh.y[:, -1] = 0.0, 1.0, 0.0, 1.0
        return mesh

    def _outcomes(self, turn: list[int]) -> dict[int, Outcome]:
        found: dict[int, Outcome] = {}
        threads = min(self.threads, len(turn))

        def work(worker: int) -> None:
            for k in turn[worker::threads]:
                found[k] = self.subdomains.solve(k)

        run_on_threads(threads, work)
        return {k: found[k] for k in turn}

    def _accelerated(self, start: Mesh, corrected: Corrected) -> Mesh:
        """The combination of this iteration with those before it, where it is needed and of use."""
        self.accelerated, self.products = False, 0
        if self.newton is not None:
            return self._by_newton(self.newton, start, corrected.mesh)
        if self.anderson is None or corrected.estimate <= self.enough:
            return corrected.mesh
        if corrected.deviation > LINEAR:  # what is seen so far from the solution says nothing of the changes near it
            return corrected.mesh
        combined = self.anderson.combined(start, corrected.mesh)
        self.accelerated = combined is not None
        return corrected.mesh if combined is None else combined

    def _by_newton(self, newton: Raspen, start: Mesh, result: Mesh) -> Mesh:
        """The mesh after a Newton step for the fixed point, where all subdomains have solved what was asked."""
        if any(record.stalled or record.classical for record in self.records):
            return result
        combined = newton.combined(start, result, self.states)
        self.accelerated, self.products = combined is not None, newton.products
        return result if combined is None else combined

    def _has_stalled(self) -> bool:
        """Whether the condition is to give way to the optimized one."""
        if not self._may_fall_back():
            return False
        own = self.changes[self.since :]
        if len(self.setbacks) >= MOST_STALLS or self.rescues >= MOST_RESCUES:
            return True
        if own and self.mismatch > SEEN * self.rounding and own[-1] < FALSE_FIXED_POINT * self.mismatch:
            return True
        if len(own) <= STALL_WINDOW or own[-1] <= self.rounding:
            return False
        slowest = 1.0 if isinstance(self.settings.transmission, Classical) else SLOWEST
        return own[-1] >= slowest**STALL_WINDOW * own[-1 - STALL_WINDOW]

    def _may_fall_back(self) -> bool:
        return self.settings.fallback and self.settings.transmission != Optimized()

    @property
    def _is_doubtful(self) -> bool:
        """Whether errors may hide that neither sweeps nor iterations see: the equations are solved, but slowly."""
        took = len(self.changes) - self.since
        affordable = self.problem.grid.points <= MOST_FACTORISED and math.isfinite(self.corrected.deviation)
        return affordable and (took > FEW or self.has_stepped)

    def _test(self, start: Mesh) -> None:
        """Go on from a Newton step on the whole grid, where that moves the mesh by more than the tolerance."""
        *_, last = newton_steps(self.problem.equations(), self.mesh, most_steps=1, fast=True)
        stepped = Mesh.of_unit_square(last.mesh.x, last.mesh.y)
        moved = _distance(stepped, self.mesh)
        self.estimate = max(self.estimate, moved)
        if moved > self.enough:
            self.mesh, self.global_step, self.changes[-1] = stepped, True, _distance(stepped, start)
            self.anderson = None if self.anderson is None else Anderson()
            if not self.settings.is_optimized:
                self.states = [window.restrict(stepped) for window in self.subdomains.windows]

    def _estimated(self) -> float:
        if self.accelerated or math.isnan(self.corrected.estimate):
            own = [math.nan, *self.changes[self.since :]]
            return estimated(own, self.rounding)
        return self.corrected.estimate

    def _with_error(self, record: SubdomainRecord, reference: Mesh | None) -> SubdomainRecord:
        if reference is None:
            return record
        window = self.subdomains.windows[record.subdomain]
        state = window.restrict(self.mesh) if self.settings.is_optimized else self.states[record.subdomain]
        error_x, error_y = window.distance(state, reference)
        return replace(record, error_x=error_x, error_y=error_y)

    def _count(self) -> None:
        """Work and traffic of the iteration."""
        windows, shape = self.subdomains.windows, self.problem.grid.shape
        solved = [k for turn in self.turns for k in turn]
        self.work = sum(
            windows[r.subdomain].shape[0] * windows[r.subdomain].shape[1] * max(r.sweeps, r.newton_steps)
            for r in self.records
        )
        self.work += self.corrected.count * shape[0] * shape[1]
        columns, rows = self.decomposition.subdomains
        # A correction of all lines takes both neighbours' nodes next to every cut, and a line's sum there and back.
        cuts = (columns - 1) * shape[1] + (rows - 1) * shape[0]
        self.traffic = 8 * (sum(self.subdomains.sent(k) for k in solved) + 6 * cuts * self.corrected.count)


def _record(k: int, outcome: Outcome, earlier: SubdomainRecord | None) -> SubdomainRecord:
    """The record of a solve, with what the subdomain did earlier in the iteration."""
    solution = outcome.solution
    record = SubdomainRecord(
        subdomain=k,
        newton_steps=0 if solution.swept else solution.steps,
        sweeps=solution.steps if solution.swept else 0,
        residual=solution.residual,
        stalled=not solution.converged,
        classical=outcome.classical,
    )
    if earlier is None:
        return record
    return replace(
        record,
        newton_steps=record.newton_steps + earlier.newton_steps,
        sweeps=record.sweeps + earlier.sweeps,
        stalled=record.stalled or earlier.stalled,
        classical=record.classical or earlier.classical,
    )


def _distance(mesh: Mesh, other: Mesh) -> float:
    return max(largest_difference(mesh.x, other.x), largest_difference(mesh.y, other.y))
