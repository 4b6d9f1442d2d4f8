"""A mesh for a requested interpolation error: the grid is found by prediction, and verified by solving."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Literal, Unpack, cast

import numpy as np

from equimesh.blocks.blocks import Blocks
from equimesh.domains.domain import UNIT_SQUARE, Domain
from equimesh.equations.problem import Boundary, Problem, require_domain
from equimesh.errors import InputError
from equimesh.inputs import keep_floats
from equimesh.meshes.mesh import Grid, Mesh
from equimesh.monitors.least_error import LeastError, NodalSolution
from equimesh.monitors.metrics import NORMS
from equimesh.monitors.monitor import Monitor, require_monitor
from equimesh.rounds.round import NO_SHAPE_OF_GOALS
from equimesh.rounds.shape import best_counts, counts_within, proportions, require_budget, with_counts
from equimesh.solving.solution import Solution, degree_of
from equimesh.solving.solve import Round, solve, solve_by
from equimesh.solving.status import Announcer, SolveArguments, complete_arguments
from equimesh_schema import Aim
from equimesh_schema.document import hinted, is_number, is_whole

FIRST_CELLS = 32
"""Cells a side, about, of the first grid, from whose error the others are predicted."""
RESOLVING_CELLS = 64
"""Cells a side, about, of the mesh at whose points the shapes of grids are compared."""
MIN_CELLS = 4
"""Cells, at least, in each direction of a grid."""
MAX_POINTS = 1025 * 1025
"""Points, at most, of the grid, where no other limit is given."""
ORDERS = {"l2": 1.0, "h1": 0.0}
"""How many more than the degree of the elements is the power of the spacing to which the error falls in each norm."""
MARGINS = (1.02, 1.05, 1.12)
"""The requested error over the error that is aimed at: of the prediction, and of each correction."""
LOOSE_SHARE = 0.8
"""A smaller share of the requested error means that a coarser grid may do."""
MAX_CORRECTIONS = 2
"""Solves, at most, after the one on the predicted grid."""
NO_U = "a target is an error of interpolating u, and this monitor has no u: give it one"
"""The reason why a target is refused for a monitor without u."""
NO_ERROR_OF_A_ROUND = "the error of the next mesh is known once your solver has solved on it: give max_points alone"
"""The reason why an error is refused for values of a solver."""
NO_NORM_OF_A_ROUND = "a round chooses its mesh in the norm of the monitor: give the same norm there, or leave this out"
"""The reason why another norm is refused for values of a solver."""
NO_GRID = "the grid for an error is found on domains with four sides: give max_points alone, or refine the blocks"
"""The reason why a target is refused on blocks."""


@hinted(points="did you mean 'max_points'?")
@dataclass(frozen=True, kw_only=True)
class Target:
    """A requested interpolation error of u, in place of a grid.

    ``norm`` is ``"l2"`` for the error of u, ``"h1"`` for that of its gradient; for values of a solver that of their
    monitor. ``error`` is the norm over the whole domain, in the units of u (of its gradient) times a length.
    ``max_points`` limits the grid. Without an ``error`` it is the least one on so many points, for which the shape of
    the grid is found. Raises :class:`~equimesh.errors.InputError` for values that cannot be used.
    """

    norm: Literal["l2", "h1"] = "l2"
    error: float | None = None
    max_points: int | None = None

    def __post_init__(self) -> None:
        if self.norm not in NORMS:
            raise InputError(f"norm = {self.norm!r}: choose 'l2' or 'h1'", field="norm")
        if self.error is None and self.max_points is None:
            raise InputError("an error is required, or max_points for the least one on so many points", field="error")
        keep_floats(self, "error")
        if self.error is not None and not (is_number(self.error) and 0.0 < self.error < math.inf):
            raise InputError(f"error = {self.error!r}: the requested error must be a positive number", field="error")
        if self.max_points is not None and not is_whole(self.max_points):
            raise InputError(
                f"max_points = {self.max_points!r:.40}: give a whole number, of at least 25 points on a grid",
                field="max_points",
            )

    @property
    def most(self) -> int:
        """The most points of the grid."""
        return MAX_POINTS if self.max_points is None else self.max_points

    @property
    def aimed(self) -> float:
        """The requested error; 0 for the least one."""
        return 0.0 if self.error is None else self.error

    def require_possible(self, domain: Domain | Blocks) -> None:
        """Raise :class:`~equimesh.errors.InputError` for too few points of a ``domain``, or for too many."""
        require_budget(self.most if self.error is None else min(self.most, MAX_POINTS), domain, "max_points")

    def grid(self, domain: Domain, cells: float = FIRST_CELLS) -> Grid:
        """The grid of about ``cells`` a side, in the proportions of the mesh lines of ``domain``."""
        n_xi, n_eta = (max(MIN_CELLS, round(cells * part)) + 1 for part in proportions(domain))
        return Grid(n_xi=n_xi, n_eta=n_eta)

    def largest_cells(self, domain: Domain) -> float:
        """The number of cells a side of the largest allowed grid."""
        cells = math.sqrt(self.most)
        while self.grid(domain, cells).points > self.most:
            cells -= 0.5
        return cells


def solve_to(
    target: Target,
    *,
    monitor: Monitor,
    domain: Domain | Blocks = UNIT_SQUARE,
    boundary: Boundary = Boundary.TRACE,
    began: Callable[[Grid], None] | None = None,
    **options: Unpack[SolveArguments],
) -> Solution:
    """The mesh of the smallest grid that was found for the error of ``target``.

    The error on about 33 points a side predicts the grid, since it falls with the square of the spacing in L2, and with
    the spacing in H1. The mesh on the predicted grid is solved and measured. Where its error is too large, or far
    smaller than requested, the grid is corrected, at most twice. ``target`` of the certificate has the numbers. Without
    an error the shape of the grid is found on coarse grids; the mesh is no worse than that on the largest grid in the
    proportions of the domain. So it is on blocks, by their counts; ``began`` is not called. Gains compare with the
    uniform mesh, or the initial one of blocks, of the counts that were chosen. With values of a solver it is
    :func:`~equimesh.rounds.round.adapt_round` with so many points.

    ``began`` is called with every grid before it is solved. ``options`` are those of
    :func:`~equimesh.solving.solve.solve`; the start is no mesh. Raises what that raises, and
    :class:`~equimesh.errors.InputError` for a target out of reach of ``target.max_points``, which names the error
    that the largest allowed grid would give.
    """
    if not isinstance(target, Target):
        raise InputError(f"target = {target!r:.40}: give Target(max_points=4000) or Target(error=1e-3)", field="target")
    require_monitor(monitor)
    if not isinstance(domain, Blocks):
        require_domain(domain)
    if isinstance(options.get("initial"), Mesh):
        raise InputError("a target chooses the grid, so that there is no mesh to start from", field="initial")
    if isinstance(monitor, NodalSolution):
        return _round_within(target, monitor, domain, boundary, options)
    if isinstance(domain, Blocks):
        return _least_on_blocks(target, monitor, domain, options)
    search = _Search(target, _problem(target, monitor, domain, boundary), began, options, _Work.of(options))
    if target.error is None:
        return search.least()
    tried = [search.at(min(FIRST_CELLS, target.largest_cells(domain)), math.nan)]
    if not tried[0].solution.status.succeeded:
        return tried[0].solution
    while True:
        last = tried[-1]
        if last.error <= target.aimed and last.error >= LOOSE_SHARE * target.aimed:
            break
        cells = search.next_cells(last, MARGINS[min(len(tried), len(MARGINS)) - 1])
        if len(tried) > 1 + MAX_CORRECTIONS or target.grid(domain, cells) == last.grid:
            break
        if last.error <= target.aimed and target.grid(domain, cells).points > LOOSE_SHARE * last.grid.points:
            break
        tried.append(search.at(cells, search.predicted(last, cells)))
        if not tried[-1].solution.status.succeeded:
            return tried[-1].solution
    return search.finish(tried)


def require_reachable(
    target: Target, *, monitor: Monitor, domain: Domain = UNIT_SQUARE, boundary: Boundary = Boundary.TRACE
) -> None:
    """Raise what :func:`solve_to` raises for a target out of reach, at the cost of the solve on the first grid."""
    problem = _problem(target, monitor, domain, boundary)
    if target.error is None:
        return
    search = _Search(target, problem, None, {"threads": 1, "check": False}, _Work(None))
    first = search.at(min(FIRST_CELLS, target.largest_cells(domain)), math.nan)
    if first.solution.status.succeeded and first.error > target.error:
        search.next_cells(first)


@dataclass(frozen=True, kw_only=True)
class _GridSolution:
    """The solution on a grid of about ``cells`` a side, with its error and the predicted error."""

    cells: float
    grid: Grid
    solution: Solution
    error: float
    predicted: float


@dataclass
class _Work:
    """The progress of all solves of a target. The solve on the second grid is expected, further ones are not."""

    announcer: Announcer | None
    grids: list[Grid] = field(default_factory=list)

    @classmethod
    def of(cls, options: SolveArguments) -> _Work:
        """The progress that is reported to the observer of the options."""
        return cls(Announcer.of(options.get("observe")))

    def begin(self, grid: Grid) -> Announcer | None:
        """The observer of the solve on the next grid."""
        self.grids.append(grid)
        if self.announcer is None:
            return None
        words, share = f"grid {len(self.grids)} for the target", None
        if len(self.grids) == 2:
            share = self.grids[0].points / (self.grids[0].points + grid.points)
        return self.announcer.part(share, 1.0, words)


@dataclass(frozen=True)
class _Search:
    """The search for the grid of a target."""

    target: Target
    problem: Problem
    began: Callable[[Grid], None] | None
    options: SolveArguments
    work: _Work

    def at(self, cells: float, predicted: float) -> _GridSolution:
        """The solution on about ``cells`` a side."""
        return self.on(self.target.grid(self.problem.domain, cells), predicted)

    def on(self, grid: Grid, predicted: float = math.nan) -> _GridSolution:
        """The solution on a grid."""
        if self.began is not None:
            self.began(grid)
        options: SolveArguments = {**self.options, "observe": self.work.begin(grid)}
        solution = solve(replace(self.problem, grid=grid), **options)
        errors = solution.interpolation
        error = math.nan if errors is None else {"l2": errors.l2, "h1": errors.h1}[self.target.norm]
        return _GridSolution(cells=_cells_of(grid), grid=grid, solution=solution, error=error, predicted=predicted)

    def least(self) -> Solution:
        """The solution with the least error on so many points: of the usual shape, or of that which is found."""
        target, domain = self.target, self.problem.domain
        u: Any = self.problem.monitor.on(domain).u
        usual: Any = with_counts(domain, counts_within(target.most, domain))
        first = self.on(usual)
        coarse = target.grid(domain, min(RESOLVING_CELLS, target.largest_cells(domain)))
        resolving: Any = solve(
            Problem(monitor=LeastError(u=u, norm=target.norm), grid=coarse, domain=domain),
            check=False,
            threads=self.options.get("threads"),
        )
        found: Any = with_counts(domain, best_counts(u, domain, target.most, target.norm, resolving.reference))
        if found == coarse or not first.solution.status.succeeded:
            return first.solution
        other = self.on(found)
        return other.solution if other.error < first.error else first.solution

    def predicted(self, last: _GridSolution, cells: float) -> float:
        """The error on about ``cells`` a side, from that of another grid."""
        spacing = last.cells / _cells_of(self.target.grid(self.problem.domain, cells))
        return float(last.error * spacing**self.order)

    @property
    def order(self) -> float:
        """The power of the spacing to which the error falls."""
        return degree_of(self.problem.monitor) + ORDERS[self.target.norm]

    def next_cells(self, last: _GridSolution, margin: float = MARGINS[0]) -> float:
        """Cells a side of the grid that the target needs; raises :class:`InputError` for one that is too large."""
        target, domain = self.target, self.problem.domain
        if not math.isfinite(last.error):
            raise InputError("the interpolation error of u is not finite on this domain", field="target.error")
        needed = float(last.cells * (margin * last.error / target.aimed) ** (1.0 / self.order))
        most = target.largest_cells(domain)
        if needed <= most:
            return min(max(needed, float(MIN_CELLS)), most)
        best = self.predicted(last, most)
        if best <= target.aimed and target.grid(domain, most) != last.grid:
            return most
        points = needed**2
        raise InputError(
            f"an error of {target.error:g} in {target.norm.upper()} needs about {points:.2g} points, and at most"
            f" {target.most} are allowed: the largest allowed grid, {target.grid(domain, most)}, would give about"
            f" {best:.2g}",
            field="target.error",
        )

    def finish(self, tried: list[_GridSolution]) -> Solution:
        """The solution on the smallest grid whose error is as requested, else the one of the smallest error."""
        target = self.target
        enough = [one for one in tried if one.error <= target.aimed]
        best = min(enough, key=lambda one: one.grid.points) if enough else min(tried, key=lambda one: one.error)
        predicted = best.predicted if math.isfinite(best.predicted) else best.error
        aim = Aim(
            norm=target.norm,
            error=target.aimed,
            grid=best.grid.shape,
            predicted=predicted,
            reached=best.error,
            solves=len(tried),
        )
        solution = replace(best.solution, target=aim)
        if enough:
            return solution
        missed = (
            f"The requested error of {target.error:g} was missed: it is {best.error:.3g} after {len(tried)} solves."
        )
        return replace(solution, detours=(*solution.detours, missed))


def require_target_of_a_round(target: Target, monitor: NodalSolution) -> None:
    """Raise :class:`~equimesh.errors.InputError` for what cannot choose the points of the next mesh of a solver."""
    if target.error is not None:
        raise InputError(NO_ERROR_OF_A_ROUND, field="target.error")
    if target.norm not in (Target.norm, monitor.norm):
        raise InputError(NO_NORM_OF_A_ROUND, field="target.norm")
    if monitor.adjoint is not None:
        raise InputError(NO_SHAPE_OF_GOALS, field="target")


def _round_within(
    target: Target, monitor: NodalSolution, domain: Domain | Blocks, boundary: Boundary, options: SolveArguments
) -> Solution:
    """The next mesh for the values of a solver, of as many points at most as the target has."""
    require_target_of_a_round(target, monitor)
    target.require_possible(domain)
    grid: Any = None if isinstance(domain, Blocks) else monitor.mesh_on(domain).grid
    problem: Problem[Any] = Problem(monitor=monitor, grid=grid, boundary=boundary, domain=domain)
    return cast("Solution", solve_by(Round(points=target.most), problem, complete_arguments(options)))


def _least_on_blocks(target: Target, monitor: Monitor, domain: Blocks, options: SolveArguments) -> Solution:
    """The solution with the least error on so many points: with the counts in proportion, or with those found."""
    if monitor.u is None:
        raise InputError(NO_U, field="target")
    if target.error is not None:
        raise InputError(NO_GRID, field="domain")
    target.require_possible(domain)
    most, work = target.most, _Work.of(options)
    usual = domain.with_counts(counts_within(most, domain))

    def on(blocks: Blocks, part: int) -> tuple[float, Solution]:
        share = 0.5 if part == 1 else None
        observe = work.announcer and work.announcer.part(share, 1.0, f"mesh {part} for the target")
        told: SolveArguments = {**options, "observe": observe}
        found: Any = solve(Problem(monitor=monitor, domain=blocks), **told)
        errors = found.interpolation
        return math.inf if errors is None else {"l2": errors.l2, "h1": errors.h1}[target.norm], found

    before, first = on(usual, 1)
    if before == 0.0 or not first.status.succeeded:
        return first
    of: Any = usual
    u: Any = monitor.on(of).u
    counts = best_counts(u, usual, most, target.norm, first.mesh)
    if np.array_equal(counts, usual.layout.counts):
        return first
    error, second = on(usual.with_counts(counts), 2)
    return second if error < before else first


def _cells_of(grid: Grid) -> float:
    return math.sqrt((grid.n_xi - 1) * (grid.n_eta - 1))


def _problem(target: Target, monitor: Monitor, domain: Domain, boundary: Boundary) -> Problem:
    """The problem on the first grid."""
    if monitor.u is None:
        raise InputError(NO_U, field="target")
    if isinstance(domain, Blocks):
        raise InputError(NO_GRID, field="domain")
    target.require_possible(domain)
    return Problem(monitor=monitor, grid=target.grid(domain), boundary=boundary, domain=domain)
