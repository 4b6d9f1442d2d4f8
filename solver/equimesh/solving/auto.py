"""Solves by several candidates: the smallest error of interpolation, of finite elements, or of finite volumes."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeAlias

from equimesh.domains.domain import closed_of, map_mesh
from equimesh.equations.problem import Problem, in_blocks
from equimesh.errors import InputError
from equimesh.least_error.iteration import DescentEnd, LeastErrorSolve
from equimesh.least_error.nest import Level, coarse_level, nested_levels
from equimesh.least_error.subdomains import Subdomains
from equimesh.meshes.mesh import Grid, Mesh
from equimesh.monitors.least_error import Auto, LeastError
from equimesh.monitors.metrics import ArcLength, Curvature, Smoothed
from equimesh.monitors.monitor import MAX_ORTHOGONALITY, Monitor, weaken
from equimesh.quality.faces import check_cells, measure_faces, poisson_error
from equimesh.quality.interpolation import InterpolationErrors
from equimesh.quality.measures import measure_errors
from equimesh.quality.ritz import RitzErrors, coarsened, ritz_errors
from equimesh.single_domain.iteration import single_domain_steps
from equimesh.single_domain.level import Mode
from equimesh.solving.least_error import LEAST_ERROR_SETTINGS, end_of
from equimesh.solving.orthogonality import bounded, is_within
from equimesh.solving.solution import AnySolution, Solution, degree_of
from equimesh.solving.status import DescentProgress, SolveOptions, Status
from equimesh_schema import Candidate

DESCENT_WORK = 4.0
"""The work of a least-error candidate, about, in units of the work of a candidate that equidistributes a metric."""
SMOOTHING = 0.02
"""Radius of the smoothed curvature candidate, in units of the domain's shorter extent."""
SOLVER_SETTINGS: Mapping[str, tuple[Mapping[str, Any], ...]] = {
    "l2": (
        {"purpose": "finite_element", "distortion": 2.0, "smoothness": 0.5, "obliqueness": 5.0},
        {"rectilinear": True},
        {"purpose": "finite_element", "distortion": 0.5, "smoothness": 0.5},
    ),
    "h1": (
        {"norm": "h1", "distortion": 2.0, "smoothness": 0.5, "obliqueness": 5.0},
        {"rectilinear": True},
        {"norm": "h1", "distortion": 0.5, "smoothness": 1.0},
        {"purpose": "finite_element", "distortion": 0.5, "smoothness": 0.5},
    ),
}
"""The settings of the least-error candidates for finite elements, by the norm of the error that is compared.

On a grid those without a weight on angles are tried where the others have no good mesh with moderate angles."""
MUCH_DISTORTION = 1.2
"""The distortion of a mesh with moderate angles beyond which free ones often gain twice as much."""
SETTINGS_OF_DEGREE: tuple[Mapping[str, Any], ...] = (
    {"distortion": 0.5, "smoothness": 0.1},
    {"distortion": 2.0, "smoothness": 0.5, "obliqueness": 5.0},
    {"rectilinear": True},
)
"""The same for elements of degree 2 and more, of which a solver has nearly the error of interpolation."""
STRAIGHT_GAIN = 1.6
"""How many times smaller a descent makes the error of straight lines, at most: 1.51 of 60 random functions."""
NEAR_BEST = 0.85
"""The share of the best gain for a solver that the mesh with the smallest angles must have to be taken.

Of bilinear elements. For others it is the share that takes as many more nodes to make up for."""
FINER_ANGLE = 5.0
"""How much larger angles often become from the coarse grid of the comparison to the requested one, in degrees."""
MODERATE_ANGLE, ENOUGH = 60.0, 0.6
"""An angle below which many codes are content, and the share of the best gain with which such meshes go first."""


@dataclass(frozen=True, kw_only=True)
class CoarseCandidate:
    """A candidate with its errors on the coarse grid; ``None`` where its equations have no valid mesh there."""

    kind: str
    settings: Mapping[str, Any]
    monitor: Monitor
    errors: InterpolationErrors | None
    mesh: Mesh | None = None
    """Its coarse mesh of the domain."""
    coarse: DescentEnd | None = None
    """The coarse mesh from which a least-error solve continues."""
    starts: tuple[Any, ...] = ()
    """The starts of its descents."""
    solver: float = math.nan
    """How many times smaller the error of a solver is than on the uniform mesh; NaN where it is not compared."""
    angle: float = math.nan
    """The largest angle of non-orthogonality, in degrees; NaN where it is not compared."""

    def gain(self, auto: Auto) -> float:
        """The error of the uniform mesh over the error of the candidate; 0 where there is no mesh."""
        if self.errors is None:
            return 0.0
        gain = self.solver if auto.compares_solvers else self.errors.estimated_gain(auto.norm)
        return gain if math.isfinite(gain) else 0.0

    def candidate(self, *, chosen: bool) -> Candidate:
        """The entry of the certificate."""
        errors = self.errors
        return Candidate(
            kind=self.kind,
            settings=dict(self.settings),
            gain_l2=math.nan if errors is None else errors.gain_l2,
            gain_h1=math.nan if errors is None else errors.gain_h1,
            gain_solver=self.solver,
            chosen=chosen,
        )


@dataclass(frozen=True, kw_only=True)
class Choice:
    """The candidates, the best one first, and the chosen one."""

    tried: tuple[CoarseCandidate, ...]
    chosen: CoarseCandidate

    @property
    def comparison(self) -> tuple[Candidate, ...]:
        """The entries of the certificate."""
        return tuple(one.candidate(chosen=one is self.chosen) for one in self.tried)

    @property
    def least_error(self) -> Choice | None:
        """The choice of the best least-error candidate, where another one is chosen; ``None`` where there is none."""
        best = next((one for one in self.tried if one.coarse is not None), None)
        return None if best is None or best is self.chosen else replace(self, chosen=best)


def choose_monitor(
    problem: Problem[Any], options: SolveOptions, *, metrics_only: bool = False, subdomains: Subdomains | None = None
) -> Choice:
    """The best monitor for an :class:`~equimesh.monitors.least_error.Auto`, by the error on a coarse mesh.

    ``metrics_only`` leaves out least error, which subdomains of a grid cannot solve. ``subdomains`` are those of a
    descent on blocks. ``options`` are those of the comparison.
    """
    auto = problem.monitor
    if not isinstance(auto, Auto):
        raise TypeError("only an Auto monitor is chosen")
    coarse = _Coarse.of(problem, options.threads, subdomains)
    metrics = list(_metrics(auto))
    # Metrics follow the second derivatives of u, and none was ever the best for a solver.
    if in_blocks(problem) or auto.degree > 1 or (auto.compares_solvers and not metrics_only):
        metrics = []
    least = [] if metrics_only else least_errors(auto, on_blocks=in_blocks(problem))
    parts = _parts(options, [DESCENT_WORK] * len(least) + [1.0] * len(metrics))
    measured = _solver_measure(coarse, auto) if auto.compares_solvers else lambda one: one
    moderate = MODERATE_ANGLE - (0.0 if coarse.level.is_finest else FINER_ANGLE)
    tried = list[CoarseCandidate]()
    for (given, monitor), part in zip(least, parts, strict=False):
        if coarse.is_shared and not {"obliqueness", "rectilinear"} & {*given} and _is_enough(tried, auto, moderate):
            break
        if coarse.is_behind(monitor, tried):
            continue
        tried.append(measured(coarse.descended(monitor, given, part, tried)))
    tried += [measured(coarse.equidistributed(kind, given, one, next(parts))) for kind, given, one in metrics]
    tried.sort(key=lambda one: -one.gain(auto))
    return Choice(tried=tuple(tried), chosen=_straightest(tried, auto, moderate))


def _is_enough(tried: Sequence[CoarseCandidate], auto: Auto, moderate: float) -> bool:
    """Whether a candidate with moderate angles has nearly the best gain of a solver, and others would not have more."""
    best = max(one.gain(auto) for one in tried)
    good = [one for one in tried if one.angle < moderate and one.gain(auto) >= NEAR_BEST * best > 0.0]
    return any(one.coarse is not None and one.coarse.record.distortion <= MUCH_DISTORTION for one in good)


def _straightest(tried: Sequence[CoarseCandidate], auto: Auto, moderate: float) -> CoarseCandidate:
    """The first candidate; for finite elements the one with the smallest angles of those with nearly its gain.

    Where some have angles below ``moderate``, and ``ENOUGH`` of the best gain, it is one of them, and ``NEAR_BEST`` is
    the share of their best gain.
    """
    best = tried[0].gain(auto)
    if not auto.compares_solvers or best == 0.0:
        return tried[0]
    order = 0.5 * (auto.degree + 1) if auto.norm == "l2" else auto.degree  # over that of bilinear elements
    among = [one for one in tried if one.angle < moderate and one.gain(auto) >= ENOUGH**order * best] or tried
    least = NEAR_BEST**order * among[0].gain(auto)
    return min((one for one in among if one.gain(auto) >= least), key=lambda one: one.angle)


def least_errors(auto: Auto, *, on_blocks: bool = False) -> list[tuple[Mapping[str, Any], LeastError]]:
    """Settings and monitors of the candidates that minimise the error; straight lines are those of a grid."""
    own: dict[str, Any] = {"norm": auto.norm} if auto.degree == 1 else {"norm": auto.norm, "degree": auto.degree}
    if not auto.compares_solvers:
        settings: Sequence[Mapping[str, Any]] = [
            {**own, "distortion": distortion, "smoothness": smoothness}
            for distortion, smoothness in LEAST_ERROR_SETTINGS
        ]
    elif auto.degree == 1:
        settings = SOLVER_SETTINGS[auto.norm]
    else:
        settings = [{**own, **given} for given in SETTINGS_OF_DEGREE]
    return [
        (given, replace(auto.least_error(), **{"norm": "l2", **given}))
        for given in settings
        if not (on_blocks and "rectilinear" in given)
    ]


def _metrics(auto: Auto) -> Iterator[tuple[str, dict[str, Any], Monitor]]:
    """Kind, settings and monitor of the candidates that equidistribute a metric."""
    smoothed = Smoothed(monitor=Curvature(u=auto.u, norm=auto.norm, orthogonality=auto.orthogonality), radius=SMOOTHING)
    yield "curvature", {"norm": auto.norm, "smoothing": SMOOTHING}, smoothed
    yield "arc_length", {}, ArcLength(u=auto.u, orthogonality=auto.orthogonality)


def _parts(options: SolveOptions, works: list[float]) -> Iterator[SolveOptions]:
    """The parts of the comparison, one for each candidate."""
    for number, work in enumerate(works):
        before = sum(works[:number])
        words = f"comparing monitors, {number + 1} of {len(works)}"
        yield options.part(before / sum(works), (before + work) / sum(works), words)


@dataclass(frozen=True, kw_only=True)
class _Coarse:
    """The coarse mesh on which candidates are compared."""

    problem: Problem[Any]
    """The requested problem."""
    solve: LeastErrorSolve
    """A descent for it, whose nested meshes are compared."""
    level: Level

    @classmethod
    def of(cls, problem: Problem[Any], threads: int, subdomains: Subdomains | None) -> _Coarse:
        """The finest of the nested meshes that is coarse enough."""
        monitor: Any = problem.monitor
        solve = LeastErrorSolve(
            monitor=monitor.least_error(),
            domain=problem.domain,
            grid=problem.grid,
            threads=threads,
            subdomains=subdomains,
        )
        return cls(problem=problem, solve=solve, level=coarse_level(solve.levels))

    @cached_property
    def uniform(self) -> Mesh:
        """The mesh with which others are compared."""
        nest = self.solve.nest
        return self._placed(nest.mesh(self.level, nest.initial(self.level)))

    @cached_property
    def plain(self) -> InterpolationErrors:
        """The errors of interpolation on the mesh with which others are compared, of the degree of the monitor."""
        auto: Any = self.problem.monitor
        return measure_errors(self.uniform, auto.u, degree=auto.degree, alone=True)

    @property
    def is_shared(self) -> bool:
        """Whether candidates share what one before them has found, beyond its starts: bilinear elements on a grid."""
        auto: Any = self.problem.monitor
        return bool(auto.compares_solvers and auto.degree == 1 and not in_blocks(self.problem))

    def descended(
        self, asked: LeastError, settings: Mapping[str, Any], options: SolveOptions, tried: Sequence[CoarseCandidate]
    ) -> CoarseCandidate:
        """The candidate that minimises the error, after those that were ``tried``."""
        solve = self._sharing(replace(self.solve, monitor=asked.on(self.problem.domain)), tried)
        levels = solve.levels[: self.level.number + 1]
        course = DescentProgress(levels, len(solve.starts) or 2, solve.last_compared(levels))
        reached = end_of(solve.coarse(self.level), options.part(course=course))
        mesh, errors = self._errors(self._placed(solve.nest.mesh(self.level, reached.mesh)), solve.monitor)
        return CoarseCandidate(
            kind="least_error",
            settings=settings,
            monitor=solve.monitor,
            errors=errors,
            mesh=mesh,
            coarse=reached,
            starts=solve.starts,
        )

    def is_behind(self, asked: LeastError, tried: Sequence[CoarseCandidate]) -> bool:
        """Whether straight lines are too far behind the first candidate to be chosen, by the error they begin with."""
        auto: Any = self.problem.monitor
        if not (self.is_shared and asked.rectilinear and auto.norm == "l2"):
            return False
        solve = self._sharing(replace(self.solve, monitor=asked.on(self.problem.domain)), tried)
        error = solve.first_error(solve.starts[-1], self.level)
        return STRAIGHT_GAIN * self.plain.l2 < ENOUGH * tried[0].gain(auto) * error

    def _sharing(self, solve: LeastErrorSolve, tried: Sequence[CoarseCandidate]) -> LeastErrorSolve:
        """The solve with the starts that a candidate before it has found on the grid for the same norm.

        For a solver straight lines begin with the best straight lines, and others where that candidate began.
        """
        if in_blocks(self.problem):
            return solve
        before = next((one for one in tried if getattr(one.monitor, "norm", "") == solve.monitor.norm), None)
        if before is None or before.coarse is None:
            return solve.with_starts()
        if not self.is_shared:
            return replace(solve, starts=before.starts)
        return replace(solve, starts=before.starts[-1:] if solve.monitor.rectilinear else (before.coarse.origin,))

    def equidistributed(
        self, kind: str, settings: Mapping[str, Any], monitor: Monitor, options: SolveOptions
    ) -> CoarseCandidate:
        """A candidate that equidistributes a metric, without a mesh where only relaxed equations have one."""
        grid: Any = self.solve.nest.grid(self.level)  # metrics are for grids alone
        problem, found = replace(self.problem, monitor=monitor, grid=grid), None
        for step in single_domain_steps(problem, mode=Mode.DISCRETIZATION, threads=options.threads):
            options.observe(step)
            if step.relaxation.cross_line > 0.0:
                found = None
                break
            found = step.mesh if step.is_exact and step.grid == grid else None
        mesh, errors = (None, None) if found is None else self._errors(self._placed(found), problem.monitor)
        return CoarseCandidate(kind=kind, settings=settings, monitor=problem.monitor, errors=errors, mesh=mesh)

    def _placed(self, mesh: Mesh) -> Mesh:
        """The mesh on the domain, from that of the reference square or of the blocks."""
        return map_mesh(mesh, self.problem.domain) if mesh.is_grid else mesh

    def _errors(self, mesh: Mesh, monitor: Monitor) -> tuple[Mesh | None, InterpolationErrors | None]:
        """The mesh and its interpolation errors; ``None`` if it folds."""
        if mesh.is_folded or monitor.u is None:
            return None, None
        degree, plain = degree_of(monitor), self.plain
        return mesh, measure_errors(mesh, monitor.u, degree=degree, alone=True).against(plain)


def _solver_measure(coarse: _Coarse, auto: Auto) -> Callable[[CoarseCandidate], CoarseCandidate]:
    """A function that adds to a candidate what a solver gets on the coarse mesh, and its angles."""
    closed = closed_of(coarse.problem.domain)

    def errors(mesh: Mesh) -> RitzErrors:
        mesh = coarsened(mesh, auto.degree)
        return ritz_errors(mesh, auto.u, triangles=auto.cells == "triangle", degree=auto.degree)

    there = errors(coarse.uniform)

    def measured(one: CoarseCandidate) -> CoarseCandidate:
        if one.mesh is None:
            return one
        angle = measure_faces(one.mesh, closed).non_orthogonality
        return replace(one, solver=errors(one.mesh).gain(there, auto.norm), angle=angle)

    return measured


# The choice of a mesh for codes with cell-centred unknowns, by the error of such a code on the candidates.
#
# Candidates are solved on a coarse grid, and measured there by :func:`equimesh.quality.faces.poisson_error`. The best
# ones are solved and measured on finer grids up to the requested one, together with the uniform mesh.

USUAL_BOUND = 55.0
"""The largest angle of non-orthogonality where none is given: corrections of fluxes converge well there."""
MAX_MEASURED_POINTS = 129 * 129
"""Points of the finest grid on which the error is measured: a direct solve takes half a second there."""
FINALISTS, SEMIFINALISTS = 4, 8
"""Candidates that are solved and measured on the finest grid, and on each one before it, besides the uniform mesh."""
UNIFORM_SHARE = 0.99
"""The share of the error of the uniform mesh that other meshes have to reach to be taken."""
WEIGHTS = ((3.0, 30.0), (10.0, 30.0), (10.0, 100.0), (30.0, 100.0), (100.0, 300.0), (300.0, 1000.0))
"""``distortion`` and ``smoothness`` of the least-error candidates."""
STRAIGHT_WEIGHTS = ((0.5, 1.0), (10.0, 30.0))
"""``distortion`` and ``smoothness`` of the rectilinear candidates."""
CURVATURES = (("l2", 0.01), ("l2", 0.03), ("l2", 0.1), ("h1", 0.03))
"""Norm and radius of smoothing of the curvature candidates."""
STRENGTHS = (1.0, 0.6, 0.3)
"""Strengths of each of them."""
ARC_SMOOTHINGS = (0.05, 0.1)
"""Radius of smoothing of the arc-length candidates."""

NO_SOURCE = (
    "the second derivatives of u are not finite at the centres of all cells: a code with fluxes between cell centres"
    " has no source there; take a function that is smooth on the whole domain, or leave out the purpose"
)
"""The reason why a u is refused."""
UNIFORM = "No candidate has a smaller error at cell centres than the uniform mesh, which this is."
"""The note of a uniform mesh."""

Solve: TypeAlias = Callable[[Problem, SolveOptions], Solution]
"""Solves a problem without a look at the bound of its angles."""


@dataclass(frozen=True, kw_only=True)
class CellCandidate:
    """A candidate with its mesh and the error at cell centres there, infinite where it cannot be used."""

    kind: str
    settings: Mapping[str, Any]
    monitor: Monitor
    solution: Solution
    error: float

    def rank(self) -> float:
        """The error, for the uniform mesh a little less: others have to be better by a hundredth."""
        return self.error * (UNIFORM_SHARE if self.kind == "uniform" else 1.0)

    def candidate(self, uniform: float, *, chosen: bool = False) -> Candidate:
        """The entry of the certificate; ``uniform`` is the error of the uniform mesh."""
        errors = self.solution.interpolation
        return Candidate(
            kind=self.kind,
            settings=dict(self.settings),
            gain_l2=math.nan if errors is None else errors.gain_l2,
            gain_h1=math.nan if errors is None else errors.gain_h1,
            gain_cells=uniform / self.error if 0.0 < self.error < math.inf else math.nan,
            chosen=chosen,
        )


def solve_for_finite_volumes(
    problem: Problem, options: SolveOptions, solve: Solve, final: Solve | None = None
) -> Solution:
    """The mesh of the candidate with the smallest error of a cell-centred code; the uniform mesh where none is better.

    ``solve`` gives meshes of single-domain and least-error solves. ``final``, where it is given, those of a Schwarz
    iteration: the candidates are metrics then, and the mesh is its result. On more than ``MAX_MEASURED_POINTS`` points
    the error is that on a coarser grid.

    Raises :class:`~equimesh.errors.InputError` where second derivatives of u are not finite on the domain.
    """
    auto = problem.monitor
    if not isinstance(auto, Auto):
        raise TypeError("only an Auto monitor is chosen")
    auto = replace(auto, orthogonality=_bound(problem, auto.orthogonality)).on(problem.domain)
    first, *finer = (replace(problem, grid=grid) for grid in _measured_grids(problem.grid))
    uniform = _uniform(first, auto)
    if uniform.error == math.inf:
        raise InputError(NO_SOURCE, field="monitor.for")
    candidates = list(_candidates(auto, metrics_only=final is not None))
    solves = _Solves(options, _rounds(len(candidates), [first, *finer], problem))
    tried = [
        _on_coarse_grid(replace(first, monitor=monitor), kind, settings, solves.next(solve))
        for kind, settings, monitor in candidates
    ]
    tried = sorted([uniform, *tried], key=CellCandidate.rank)
    plain, rest = uniform.error, list[Candidate]()
    for number, here in enumerate(finer):
        kept = [one for one in tried if one.kind != "uniform" and one.error < math.inf]
        kept = kept[: FINALISTS if number + 1 == len(finer) else SEMIFINALISTS]
        rest = [one.candidate(plain) for one in tried if one.kind != "uniform" and one not in kept] + rest
        uniform = _uniform(here, auto)
        plain = uniform.error
        solves.begin(number + 1)
        tried = sorted(
            [uniform, *(_on_fine_grid(here, one, solves.next(solve)) for one in kept)], key=CellCandidate.rank
        )
    comparison = [one.candidate(plain, chosen=one is tried[0]) for one in tried] + rest
    solves.begin(len(finer) + 1)
    return replace(_end(problem, tried[0], auto, solves.next(final or solve), final), comparison=tuple(comparison))


@dataclass(frozen=True, kw_only=True)
class _Round:
    """The solves of at most ``count`` candidates on one grid."""

    grid: Grid
    count: int

    @property
    def work(self) -> float:
        """The work of all of them, by their points."""
        return float(self.grid.points * self.count)


def _rounds(candidates: int, grids: Sequence[Problem], problem: Problem) -> list[_Round]:
    """The rounds of solves on the measured grids, and the solve on the requested one where it is finer."""
    counts = [candidates, *[SEMIFINALISTS] * (len(grids) - 2), FINALISTS][: len(grids)]
    rounds = [_Round(grid=here.grid, count=min(count, candidates)) for here, count in zip(grids, counts, strict=True)]
    return [*rounds, _Round(grid=problem.grid, count=1)] if grids[-1].grid != problem.grid else rounds


class _Solves:
    """The solves of all candidates, each as a part of the whole work."""

    def __init__(self, options: SolveOptions, rounds: list[_Round]) -> None:
        self._options, self._rounds = options, rounds
        self._round, self._number = 0, 0

    def begin(self, number: int) -> None:
        """Begin a round."""
        self._round, self._number = number, 0

    def next(self, solve: Solve) -> Callable[[Problem], Solution]:
        """The function that solves the next candidate of this round."""
        part = self._part()
        self._number += 1
        return lambda problem: solve(problem, part)

    def _part(self) -> SolveOptions:
        """The part of the next candidate."""
        if self._round >= len(self._rounds):
            return self._options.part(None)
        here, total = self._rounds[self._round], sum(one.work for one in self._rounds)
        before = sum(one.work for one in self._rounds[: self._round]) + self._number * here.grid.points
        words = f"candidate {self._number + 1} of {here.count}"
        return self._options.part(before / total, min(1.0, (before + here.grid.points) / total), words)


def _end(
    problem: Problem, chosen: CellCandidate, auto: Auto, solve: Callable[[Problem], Solution], final: Solve | None
) -> Solution:
    """The solution of the best candidate on the requested grid, or of the uniform mesh where that turns out better."""
    is_measured = problem.grid.points <= MAX_MEASURED_POINTS
    if chosen.kind == "uniform":
        return _uniform(problem, auto, is_measured=False).solution
    if final is None and is_measured:
        return chosen.solution
    chosen = _on_fine_grid(problem, chosen, solve, is_measured=is_measured)
    uniform = _uniform(problem, auto, is_measured=is_measured)
    is_better = chosen.error < math.inf and chosen.rank() <= uniform.rank()
    return chosen.solution if is_better else uniform.solution


def _bound(problem: Problem, asked: float | None) -> float:
    """The bound of the angles: the given one, or the usual one, unless the uniform mesh has a larger angle."""
    if asked is not None:
        return asked
    uniform = measure_faces(map_mesh(Mesh.uniform(problem.grid), problem.domain)).non_orthogonality
    return min(MAX_ORTHOGONALITY, max(USUAL_BOUND, uniform + 1.0))


def _measured_grids(grid: Grid) -> list[Grid]:
    """The grids on which candidates are measured, from coarse to fine; the last is the requested one, if small."""
    grids = [level.grid for level in nested_levels(grid)]
    coarse = coarse_level(nested_levels(grid)).grid
    return [coarse, *(one for one in grids if coarse.points < one.points <= MAX_MEASURED_POINTS)]


def _candidates(auto: Auto, *, metrics_only: bool) -> Iterator[tuple[str, dict[str, Any], Monitor]]:
    """Kind, settings and monitor of the candidates."""
    if not metrics_only:
        for distortion, smoothness in WEIGHTS:
            settings: dict[str, Any] = {"distortion": distortion, "smoothness": smoothness}
            yield "least_error", settings, auto.least_error(distortion, smoothness)
        for distortion, smoothness in STRAIGHT_WEIGHTS:
            settings = {"rectilinear": True, "distortion": distortion, "smoothness": smoothness}
            yield "least_error", settings, replace(auto.least_error(distortion, smoothness), rectilinear=True)
    for norm, radius in CURVATURES:
        curvature = Curvature(u=auto.u, norm="h1" if norm == "h1" else "l2", orthogonality=auto.orthogonality)
        for strength in STRENGTHS:
            settings = {"norm": norm, "smoothing": radius, "strength": strength}
            yield "curvature", settings, weaken(Smoothed(monitor=curvature, radius=radius), strength)
    for radius in ARC_SMOOTHINGS:
        arc_length = ArcLength(u=auto.u, orthogonality=auto.orthogonality)
        yield "arc_length", {"smoothing": radius}, Smoothed(monitor=arc_length, radius=radius)


def _on_coarse_grid(
    problem: Problem, kind: str, settings: Mapping[str, Any], solve: Callable[[Problem], Solution]
) -> CellCandidate:
    """The candidate on the coarse grid; it cannot be used where an angle is larger than the bound there."""
    solution = solve(problem)
    usable = solution.status.succeeded and is_within(solution) and _passes(solution)
    error = _error(solution) if usable else math.inf
    return CellCandidate(kind=kind, settings=settings, monitor=problem.monitor, solution=solution, error=error)


def _on_fine_grid(
    problem: Problem, one: CellCandidate, solve: Callable[[Problem], Solution], *, is_measured: bool = True
) -> CellCandidate:
    """The candidate on a finer grid, weakened until its angles are within the bound."""
    solution = bounded(solve(replace(problem, monitor=one.monitor)), lambda weaker, _: solve(weaker))
    if not (solution.status.succeeded and _passes(solution)):
        return replace(one, solution=solution, error=math.inf)
    return replace(one, solution=solution, error=_error(solution) if is_measured else 0.0)


def _uniform(problem: Problem, auto: Auto, *, is_measured: bool = True) -> CellCandidate:
    """The uniform mesh."""
    solution = uniform_solution(problem, auto, UNIFORM)
    error = _error(solution) if is_measured else math.inf
    monitor = solution.problem.monitor
    return CellCandidate(kind="uniform", settings={}, monitor=monitor, solution=solution, error=error)


def uniform_solution(problem: Problem[Any], auto: Auto, note: str) -> AnySolution:
    """The uniform mesh, or the initial one of blocks, as a solution, with the reason for it."""
    mesh = problem.initial
    return Solution(
        problem=replace(problem, monitor=auto.least_error()),
        schwarz=None,
        mesh=mesh,
        reference=mesh if problem.grid is None else Mesh.uniform(problem.grid),
        status=Status.COMPLETED,
        newton_steps=0,
        residual=math.nan,
        note=note,
        detours=(note,),
    )


def _passes(solution: Solution) -> bool:
    """Whether the cells pass the checks of OpenFOAM, or the cells of the uniform mesh fail them, too."""
    uniform = map_mesh(Mesh.uniform(solution.problem.grid), solution.problem.domain)
    return check_cells(solution.mesh).passed or not check_cells(uniform).passed


def _error(solution: Solution) -> float:
    u = solution.problem.monitor.u
    return math.inf if u is None else poisson_error(solution.mesh, u)
