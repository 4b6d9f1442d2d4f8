"""The nonlinear Schwarz iteration: subdomain solves that exchange interface data until they agree."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum

from equimesh import quality
from equimesh.choices import choice
from equimesh.decomposition import Decomposition
from equimesh.domain import mapped
from equimesh.errors import InputError
from equimesh.grid import Grid
from equimesh.local_solution import LocalSolution, newton_steps
from equimesh.mesh import Mesh
from equimesh.problem import Problem
from equimesh.subdomain import CornerLink, Link, SubdomainProblem
from equimesh.transmission import InterfaceData, LinearRobin, TransmissionCondition

# After this many iterations in which some subdomain had to take classical data, all do for the rest of the solve: a
# Robin condition that keeps failing does not converge, and classical Schwarz does.
MOST_RESCUES = 3
# A subdomain whose Newton solve stalls in this many iterations in a row, with classical data as well, ends the Schwarz
# iteration; a Robin iteration first begins again from its start, with classical data throughout.
MOST_STALLS = 3
# A Robin iteration that moves the mesh by less than this fraction of the mismatch has found a fixed point that is not
# the solution, and begins again likewise.
FALSE_FIXED_POINT = 1e-3
# Newton steps that a subdomain solve may take: it starts near its solution or has none near by.
MOST_LOCAL_STEPS = 25
# Changes of the node positions that rounding errors alone can cause, per point in a direction.
ROUNDING = 1e-13


def smallest_tolerance(grid: Grid) -> float:
    """The error that rounding leaves on a grid; a smaller tolerance asks for no more than this."""
    return ROUNDING * max(grid.shape)


class Ordering(StrEnum):
    """Which data a subdomain reads: ``PARALLEL``, all of the previous iteration; ``ALTERNATING``, the newest there is,
    the subdomains taking turns."""

    PARALLEL = "parallel"
    ALTERNATING = "alternating"


@dataclass(frozen=True, kw_only=True)
class Schwarz:
    """Settings of the Schwarz iteration.

    ``subdomains`` along xi and eta, ``overlap`` in points, as in :class:`~equimesh.decomposition.Decomposition`.
    The iteration ends when the estimated error of the merged mesh (max norm of node positions, in units of the
    domain) is at most ``tolerance``; with ``tolerance=None`` it runs exactly ``max_iterations``.
    ``compare_single_domain`` solves the single-domain problem first and records the error against it.
    """

    subdomains: tuple[int, int] = (2, 1)
    overlap: int = 4
    transmission: TransmissionCondition = field(default_factory=LinearRobin)
    ordering: Ordering = Ordering.ALTERNATING
    tolerance: float | None = 1e-10
    max_iterations: int = 100
    compare_single_domain: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "ordering", choice(Ordering, self.ordering, "schwarz.ordering"))
        if self.tolerance is not None and not (math.isfinite(self.tolerance) and self.tolerance > 0):
            raise InputError(
                f"tolerance = {self.tolerance}: must be positive, or null for a fixed number of iterations",
                field="schwarz.tolerance",
            )
        if self.max_iterations < 1:
            raise InputError(f"max_iterations = {self.max_iterations}: at least 1", field="schwarz.max_iterations")

    def decompose(self, grid: Grid) -> Decomposition:
        """The subdomains on a grid; raises :class:`~equimesh.errors.DecompositionError` where they do not fit."""
        return Decomposition(grid=grid, subdomains=self.subdomains, overlap=self.overlap)


@dataclass(frozen=True, kw_only=True)
class SubdomainRecord:
    """What one subdomain did in one iteration.

    ``classical`` says that its Newton solve stalled with the asked transmission condition, and that it took the
    neighbours' positions for this iteration; ``stalled`` that this failed, too, and the previous state was kept.
    ``residual`` is relative to the mean flux. ``error_x`` and ``error_y`` are against the single-domain solution, over
    the whole subdomain.
    """

    subdomain: int
    newton_steps: int
    residual: float
    stalled: bool = False
    classical: bool = False
    error_x: float | None = None
    error_y: float | None = None


@dataclass(frozen=True, kw_only=True)
class Iteration:
    """The state after one Schwarz iteration; iteration 0 is the start. ``mesh`` is that of the physical domain,
    ``reference`` the same on the reference square; all lengths are in units of the latter.

    ``change`` is the max norm by which the merged mesh moved (NaN at 0), ``estimate`` the error that the observed rate
    predicts from it (NaN until two changes are known), ``error`` the one against the single-domain solution where that
    is known. ``mismatch`` is the largest difference between subdomains at nodes that they share: a fixed point without
    mismatch is the single-domain solution, one with is not. ``failed`` ends the iteration: a subdomain has stalled for
    good.
    """

    iteration: int
    mesh: Mesh
    reference: Mesh
    max_q_eq: float
    min_jacobian: float
    change: float
    estimate: float
    mismatch: float
    subdomains: tuple[SubdomainRecord, ...]
    error: float | None = None
    failed: bool = False

    def meets(self, tolerance: float | None) -> bool:
        """Whether the error is known to be at most ``tolerance``, or what rounding leaves where that is more.

        The estimate says so, the subdomains agree as two meshes with such errors must, all were solved, none folded.
        """
        if tolerance is None:
            return False
        reachable = max(tolerance, smallest_tolerance(self.mesh.grid))
        return (
            self.estimate <= reachable
            and self.mismatch <= 2 * reachable
            and not any(record.stalled for record in self.subdomains)
            and self.min_jacobian > 0
        )


def iterate(problem: Problem, settings: Schwarz, start: Mesh, reference: Mesh | None = None) -> Iterator[Iteration]:
    """Schwarz iterations from ``start``, without end unless a subdomain stalls for good.

    One record per iteration; the caller owns the loop, and with it tolerance, limit and deadline. ``reference`` is
    the single-domain solution against which errors are recorded. Haynes and Howse, section 3.

    Where a Robin condition gives a subdomain no solution, or a fixed point on which the subdomains do not agree,
    classical data takes its place, and the record says so.
    """
    decomposition = settings.decompose(problem.grid)
    parts = [SubdomainProblem(problem, decomposition, part, settings.transmission) for part in decomposition.parts]
    states = [part.restrict(start) for part in parts]
    records = tuple(SubdomainRecord(subdomain=k, newton_steps=0, residual=math.nan) for k in range(len(parts)))
    mesh, changes, stalls, rescues = start, [math.nan], [0] * len(parts), 0
    classical, rounding = settings.transmission.ghosts == 0, smallest_tolerance(problem.grid)
    while True:
        records = tuple(_with_error(r, parts, states, reference) for r in records)
        mismatch = max(max(part.distance(state, mesh)) for part, state in zip(parts, states, strict=True))
        stuck, physical = max(stalls) >= MOST_STALLS, mapped(mesh, problem.domain)
        yield Iteration(
            iteration=len(changes) - 1,
            mesh=physical,
            reference=mesh,
            max_q_eq=float(quality.equidistribution(physical, problem.monitor).max()),
            min_jacobian=physical.min_jacobian / problem.domain.area,
            change=changes[-1],
            estimate=_estimate(changes, rounding),
            mismatch=mismatch,
            subdomains=records,
            error=None if reference is None else max(max(r.error_x or 0.0, r.error_y or 0.0) for r in records),
            failed=classical and stuck,
        )
        if classical and stuck:
            return
        if not classical and (stuck or changes[-1] < FALSE_FIXED_POINT * (mismatch - rounding)):
            states, stalls, rescues = [part.restrict(start) for part in parts], [0] * len(parts), MOST_RESCUES
        classical = classical or rescues >= MOST_RESCUES
        records = tuple(_sweep(parts, states, mesh, settings.ordering, classical))
        rescues += any(record.classical for record in records)
        stalls = [count + 1 if r.stalled else 0 for count, r in zip(stalls, records, strict=True)]
        merged = _merge(parts, states)
        changes.append(max(float(abs(merged.x - mesh.x).max()), float(abs(merged.y - mesh.y).max())))
        mesh = merged


@dataclass(frozen=True)
class _Exchange:
    """The subdomains as their neighbours see them, in the states they are read from."""

    parts: Sequence[SubdomainProblem]
    states: Sequence[Mesh]

    def functional(self, link: Link) -> InterfaceData:
        return self.parts[link.sender].functional(self.states[link.sender], link)

    def node(self, link: CornerLink) -> tuple[float, float]:
        return self.parts[link.sender].node(self.states[link.sender], link)


def _sweep(
    parts: Sequence[SubdomainProblem], states: list[Mesh], mesh: Mesh, ordering: Ordering, classical: bool
) -> Iterator[SubdomainRecord]:
    """One solve in every subdomain; updates ``states``."""
    read = list(states) if ordering is Ordering.PARALLEL else states
    for k, part in enumerate(parts):
        solution, rescued = _solve(part, _Exchange(parts, read), states[k], mesh, classical)
        states[k] = solution.mesh
        yield SubdomainRecord(
            subdomain=k,
            newton_steps=solution.steps,
            residual=solution.residual,
            stalled=not solution.converged,
            classical=rescued,
        )


def _solve(
    part: SubdomainProblem, exchange: _Exchange, state: Mesh, mesh: Mesh, classical: bool
) -> tuple[LocalSolution, bool]:
    """The subdomain's solution, and whether it was found with classical data in place of the asked condition.

    Newton starts from the subdomain's previous solution, then from the merged mesh. Where it stalls from both, the
    interface data is far from any solution of the subdomain: positions from the neighbours are taken instead.
    """
    starts = [start for start in (state, part.restrict(mesh)) if not start.is_folded]
    has_substitute = part.condition.ghosts > 0
    for rescue in (False, True)[classical and has_substitute : 1 + has_substitute]:
        equations = part.equations(exchange, classical=rescue)
        for start in starts:
            *_, solution = newton_steps(equations, start, most_steps=MOST_LOCAL_STEPS, fast=True)
            if solution.converged:
                return solution, rescue
    return LocalSolution(state, 0, math.inf, converged=False), False


def _merge(parts: Sequence[SubdomainProblem], states: Sequence[Mesh]) -> Mesh:
    merged = Mesh.uniform(parts[0].problem.grid)
    for part, state in zip(parts, states, strict=True):
        part.merge(state, merged)
    return Mesh.of_unit_square(merged.x, merged.y)


def _with_error(
    record: SubdomainRecord, parts: Sequence[SubdomainProblem], states: Sequence[Mesh], reference: Mesh | None
) -> SubdomainRecord:
    if reference is None:
        return record
    error_x, error_y = parts[record.subdomain].distance(states[record.subdomain], reference)
    return replace(record, error_x=error_x, error_y=error_y)


def _estimate(changes: Sequence[float], rounding: float) -> float:
    """The error left after changes that go on shrinking at the rate of the last ones, never less than the last change.

    The rate is that over two iterations where three changes are known, as data crosses a subdomain and comes back in
    two. Changes below ``rounding`` shrink no more, and say nothing of a rate.
    """
    change = changes[-1]
    if len(changes) < 3 or change <= rounding:
        return change if change <= rounding else math.nan
    before, over = (changes[-2], 1.0) if len(changes) == 3 else (changes[-3], 0.5)
    if change >= before:
        return math.inf
    rate: float = (change / before) ** over
    return change * max(1.0, rate / (1.0 - rate))
