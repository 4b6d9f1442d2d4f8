"""The choice of a monitor by the measured interpolation error of candidates on a coarse grid."""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from equimesh.domains.domain import map_mesh
from equimesh.equations.problem import Problem
from equimesh.least_error.iteration import LeastErrorSolve, Reached
from equimesh.least_error.levels import GridLevel, coarse_level, last_compared, nested_levels
from equimesh.least_error.steps import Descent
from equimesh.least_error.ways import mesh_of
from equimesh.meshes.grid import Grid
from equimesh.meshes.mesh import Mesh
from equimesh.monitors.arc_length import ArcLength
from equimesh.monitors.auto import Auto
from equimesh.monitors.curvature import Curvature
from equimesh.monitors.monitor import Monitor
from equimesh.monitors.smoothed import Smoothed
from equimesh.quality.interpolation import InterpolationErrors
from equimesh.quality.measures import measure_interpolation
from equimesh.single_domain.iteration import single_domain_steps
from equimesh.single_domain.steps import Mode
from equimesh.solving.courses import Descending, descent_work
from equimesh.solving.options import SolveOptions
from equimesh_schema import Candidate

LEAST_ERROR_SETTINGS = ((0.5, 1.0), (0.5, 0.1))
"""``distortion`` and ``smoothness`` of the least-error candidates; the first are the defaults."""
DESCENT_WORK = 4.0
"""The work of a least-error candidate over that of one that equidistributes a metric, about."""
SMOOTHING = 0.02
"""Radius of the smoothed curvature candidate, in units of the domain's shorter extent."""


@dataclass(frozen=True, kw_only=True)
class Tried:
    """A candidate with its errors on the coarse grid; ``None`` where its equations have no valid mesh there."""

    kind: str
    settings: Mapping[str, Any]
    monitor: Monitor
    errors: InterpolationErrors | None
    coarse: Reached | None = None
    """The coarse mesh from which a least-error solve continues."""

    def gain(self, norm: str) -> float:
        """How many times smaller the error is than that of the uniform mesh; 0 where there is no mesh."""
        if self.errors is None:
            return 0.0
        gain = self.errors.estimated_gain(norm)
        return gain if math.isfinite(gain) else 0.0

    def candidate(self, *, chosen: bool) -> Candidate:
        """The entry of the certificate."""
        errors = self.errors
        return Candidate(
            kind=self.kind,
            settings=dict(self.settings),
            gain_l2=math.nan if errors is None else errors.gain_l2,
            gain_h1=math.nan if errors is None else errors.gain_h1,
            chosen=chosen,
        )


@dataclass(frozen=True, kw_only=True)
class Choice:
    """The candidates, the best one first, and the chosen one."""

    tried: tuple[Tried, ...]
    chosen: Tried

    @property
    def comparison(self) -> tuple[Candidate, ...]:
        """The entries of the certificate."""
        return tuple(one.candidate(chosen=one is self.chosen) for one in self.tried)

    @property
    def least_error(self) -> Choice | None:
        """The choice of the best least-error candidate, where another one is chosen; ``None`` where there is none."""
        best = next((one for one in self.tried if one.coarse is not None), None)
        return None if best is None or best is self.chosen else replace(self, chosen=best)


def choose_monitor(problem: Problem, options: SolveOptions, *, metrics_only: bool) -> Choice:
    """The best of the monitors that stand for an :class:`~equimesh.monitors.auto.Auto`, by the error on a coarse grid.

    ``metrics_only`` leaves out least error, which subdomains cannot solve. ``options`` are those of the comparison.
    """
    auto = problem.monitor
    if not isinstance(auto, Auto):
        raise TypeError("only an Auto monitor is chosen")
    level = coarse_level(nested_levels(problem.grid))
    coarse, metrics = replace(problem, grid=level.grid), list(_metrics(auto))
    weights = [] if metrics_only else list(LEAST_ERROR_SETTINGS)
    parts = _parts(options, [DESCENT_WORK] * len(weights) + [1.0] * len(metrics))
    tried = [_descended(problem, auto, level, pair, next(parts)) for pair in weights]
    tried += [_equidistributed(coarse, kind, given, monitor, next(parts)) for kind, given, monitor in metrics]
    tried.sort(key=lambda one: -one.gain(auto.norm))
    return Choice(tried=tuple(tried), chosen=tried[0])


def _metrics(auto: Auto) -> Iterator[tuple[str, dict[str, Any], Monitor]]:
    """Kind, settings and monitor of the candidates that equidistribute a metric."""
    smoothed = Smoothed(monitor=Curvature(u=auto.u, norm=auto.norm, orthogonality=auto.orthogonality), radius=SMOOTHING)
    yield "curvature", {"norm": auto.norm, "smoothing": SMOOTHING}, smoothed
    yield "arc_length", {}, ArcLength(u=auto.u, orthogonality=auto.orthogonality)


def comparison_share(grid: Grid) -> float:
    """The share of the comparison in the whole work, if the mesh is one of least error afterwards."""
    levels = nested_levels(grid)
    level = coarse_level(levels)
    compared = last_compared(levels)
    first = len(LEAST_ERROR_SETTINGS) * descent_work(levels[: level.number + 1], 2, compared)
    return first / (first + descent_work(levels[level.number + 1 :], 1, compared))


def _parts(options: SolveOptions, works: list[float]) -> Iterator[SolveOptions]:
    """The parts of the comparison, one for each candidate."""
    for number, work in enumerate(works):
        before = sum(works[:number])
        words = f"comparing monitors, {number + 1} of {len(works)}"
        yield options.part(before / sum(works), (before + work) / sum(works), words)


def _descended(
    problem: Problem, auto: Auto, level: GridLevel, weights: tuple[float, float], options: SolveOptions
) -> Tried:
    """The candidate that minimises the error."""
    settings = {"norm": auto.norm, "distortion": weights[0], "smoothness": weights[1]}
    monitor = auto.least_error(*weights).on(problem.domain)
    solve = LeastErrorSolve(monitor=monitor, domain=problem.domain, grid=problem.grid, threads=options.threads)
    levels = nested_levels(problem.grid)[: level.number + 1]
    reached = _end_of(solve.coarse(level), options.part(course=Descending(levels, 2, last_compared(levels))))
    errors = _errors(replace(problem, grid=level.grid), mesh_of(reached.mesh, level.grid))
    return Tried(kind="least_error", settings=settings, monitor=monitor, errors=errors, coarse=reached)


def _end_of(steps: Generator[Descent, None, Reached], options: SolveOptions) -> Reached:
    """The end of a descent, after all steps were reported to the observer."""
    while True:
        try:
            options.observe(next(steps))
        except StopIteration as end:
            reached: Reached = end.value
            return reached


def _equidistributed(
    coarse: Problem, kind: str, settings: Mapping[str, Any], monitor: Monitor, options: SolveOptions
) -> Tried:
    """A candidate that equidistributes a metric, without a mesh where only relaxed equations have one."""
    problem, found = replace(coarse, monitor=monitor), None
    for step in single_domain_steps(problem, mode=Mode.DISCRETIZATION, threads=options.threads):
        options.observe(step)
        if step.relaxation.cross_line > 0.0:
            found = None
            break
        found = step.mesh if step.is_exact and step.grid == problem.grid else None
    errors = None if found is None else _errors(problem, found)
    return Tried(kind=kind, settings=settings, monitor=problem.monitor, errors=errors)


def _errors(coarse: Problem, reference: Mesh) -> InterpolationErrors | None:
    """The interpolation errors of a mesh of the reference square; ``None`` for one that folds on the domain."""
    mesh, uniform = (map_mesh(one, coarse.domain) for one in (reference, Mesh.uniform(coarse.grid)))
    return None if mesh.is_folded else measure_interpolation(mesh, coarse.monitor.u, uniform=uniform)
