"""The choice of a monitor by candidates: the smallest error of finite elements, or of interpolation."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from equimesh.domains.domain import closed_of, map_mesh
from equimesh.equations.problem import Problem, in_blocks
from equimesh.least_error.iteration import DescentEnd, LeastErrorSolve
from equimesh.least_error.nest import Level, coarse_level
from equimesh.least_error.restricted import Subdomains
from equimesh.meshes.mesh import Mesh
from equimesh.monitors.least_error import Auto, LeastError
from equimesh.monitors.metrics import ArcLength, Curvature
from equimesh.monitors.monitor import Monitor
from equimesh.monitors.smoothed import Smoothed
from equimesh.quality.faces import measure_faces
from equimesh.quality.interpolation import InterpolationErrors
from equimesh.quality.measures import measure_errors
from equimesh.quality.ritz import RitzErrors, coarsened, ritz_errors
from equimesh.single_domain.iteration import single_domain_steps
from equimesh.single_domain.level import Mode
from equimesh.solving.least_error import LEAST_ERROR_SETTINGS, end_of
from equimesh.solving.solution import degree_of
from equimesh.solving.status import DescentProgress, SolveOptions
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
    # Metrics follow the second derivatives of u, and none was ever the best for a solver.
    without = in_blocks(problem) or auto.degree > 1 or (auto.compares_solvers and not metrics_only)
    metrics = [] if without else list(_metrics(auto))
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
            coarse=replace(reached, errors=errors),
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
