"""The choice of a monitor by the measured interpolation error of candidates on a coarse grid."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from equimesh.domains.domain import map_mesh
from equimesh.equations.problem import Problem
from equimesh.inputs import finite_or_none
from equimesh.least_error.iteration import LeastErrorSolve
from equimesh.meshes.grid import MIN_POINTS, Grid
from equimesh.meshes.mesh import Mesh
from equimesh.monitors.arc_length import ArcLength
from equimesh.monitors.auto import Auto
from equimesh.monitors.curvature import Curvature
from equimesh.monitors.least_error import LeastError
from equimesh.monitors.monitor import Monitor
from equimesh.monitors.smoothed import Smoothed
from equimesh.quality.interpolation import InterpolationErrors
from equimesh.quality.measures import measure_interpolation
from equimesh.single_domain.iteration import single_domain_steps
from equimesh.single_domain.steps import Mode, Step
from equimesh.solving.certificate import Candidate

MAX_COARSE_POINTS = 33
"""Points a side, at most, of the grid on which candidates are compared."""
LEAST_ERROR_SETTINGS = ((0.5, 1.0), (0.15, 0.3), (0.5, 0.1))
"""``distortion`` and ``smoothness`` of the least-error candidates; the first are the defaults."""
SMOOTHING = 0.02
"""Radius of the smoothed curvature candidate, in units of the domain's shorter extent."""


@dataclass(frozen=True, kw_only=True)
class Tried:
    """A candidate with its errors on the coarse grid; ``None`` where its equations have no valid mesh there."""

    kind: str
    settings: Mapping[str, Any]
    monitor: Monitor
    errors: InterpolationErrors | None

    def gain(self, norm: str) -> float:
        """How many times smaller the error is than that of the uniform mesh; 0 where there is no mesh."""
        if self.errors is None:
            return 0.0
        gain = self.errors.gain_l2 if norm == "l2" else self.errors.gain_h1
        return gain if math.isfinite(gain) else 0.0


def choose_monitor(problem: Problem, *, metrics_only: bool, threads: int) -> tuple[Problem, tuple[Candidate, ...]]:
    """The problem with the best monitor in place of its :class:`~equimesh.monitors.auto.Auto`, and the comparison.

    The comparison lists the best candidate first. ``metrics_only`` leaves out least error, which subdomains cannot
    solve.
    """
    auto = problem.monitor
    if not isinstance(auto, Auto):
        raise TypeError("only an Auto monitor is chosen")
    coarse = replace(problem, grid=coarse_grid(problem.grid))
    tried = [
        Tried(kind=kind, settings=settings, monitor=monitor, errors=_errors(coarse, monitor, threads))
        for kind, settings, monitor in _candidates(auto, metrics_only=metrics_only)
    ]
    tried.sort(key=lambda one: -one.gain(auto.norm))
    comparison = tuple(
        Candidate(
            kind=one.kind,
            settings=dict(one.settings),
            gain_l2=None if one.errors is None else finite_or_none(one.errors.gain_l2),
            gain_h1=None if one.errors is None else finite_or_none(one.errors.gain_h1),
            chosen=one is tried[0],
        )
        for one in tried
    )
    return replace(problem, monitor=tried[0].monitor), comparison


def coarse_grid(grid: Grid) -> Grid:
    """The grid on which candidates are compared: of the same proportions, with at most 33 points a side."""
    share = min(1.0, (MAX_COARSE_POINTS - 1) / (max(grid.shape) - 1))
    n_xi, n_eta = (max(MIN_POINTS, round(share * (n - 1)) + 1) for n in grid.shape)
    return Grid(n_xi=n_xi, n_eta=n_eta)


def _candidates(auto: Auto, *, metrics_only: bool) -> Iterator[tuple[str, dict[str, Any], Monitor]]:
    """Kind, settings and monitor of every candidate."""
    if not metrics_only:
        for distortion, smoothness in LEAST_ERROR_SETTINGS:
            settings = {"norm": auto.norm, "distortion": distortion, "smoothness": smoothness}
            yield (
                "least_error",
                settings,
                LeastError(u=auto.u, norm=auto.norm, distortion=distortion, smoothness=smoothness),
            )
    smoothed = Smoothed(monitor=Curvature(u=auto.u, norm=auto.norm), radius=SMOOTHING)
    yield "curvature", {"norm": auto.norm, "smoothing": SMOOTHING}, smoothed
    yield "arc_length", {}, ArcLength(u=auto.u)


def _errors(coarse: Problem, monitor: Monitor, threads: int) -> InterpolationErrors | None:
    """The interpolation errors of the candidate's mesh on the coarse grid."""
    if isinstance(monitor, LeastError):
        bound = monitor.on(coarse.domain)
        *_, last = LeastErrorSolve(monitor=bound, domain=coarse.domain, grid=coarse.grid, threads=threads).steps()
        reference = last.mesh
    else:
        found = _equidistributed(replace(coarse, monitor=monitor), threads)
        if found is None:
            return None
        reference = found
    mesh, uniform = (map_mesh(one, coarse.domain) for one in (reference, Mesh.uniform(coarse.grid)))
    return None if mesh.is_folded else measure_interpolation(mesh, monitor.u, uniform=uniform)


def _equidistributed(problem: Problem, threads: int) -> Mesh | None:
    """The mesh of a metric, ``None`` where the requested equations are not satisfied without relaxation."""
    found: Step | None = None
    for step in single_domain_steps(problem, mode=Mode.DISCRETIZATION, threads=threads):
        if step.relaxation.cross_line > 0.0:
            return None
        found = step
    return found.mesh if found is not None and found.is_exact and found.grid == problem.grid else None
