"""The single-domain mesh, in nested iteration from the uniform mesh on a coarse grid up.

The coarsest level is solved by guarded Newton, finer ones by the chord iteration from the coarser solution; where that
does not converge, by guarded Newton, too.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import RectBivariateSpline

from equimesh import chord as chord_iteration
from equimesh import newton
from equimesh.equations import MeshEquations
from equimesh.grid import SMALLEST, Grid
from equimesh.mesh import Mesh
from equimesh.problem import Problem

COARSEST = 17
MOST_STEPS = 60
SMALLEST_ADVANCE = 1.0 / 64.0
# Where a level falls short of the asked ``a``, finer ones go on from there, up to so many points in a direction.
FINEST_CONTINUATION = 65
TOLERANCE = 1e-12
# Rounding errors of the fluxes grow like the number of points in a direction; no tolerance can be below them.
ROUNDING = 64 * np.finfo(np.float64).eps


@dataclass(frozen=True, kw_only=True)
class NewtonRecord:
    """One Newton step of a single-domain solve, or one sweep of the chord iteration.

    ``level`` of ``levels`` is the grid of the nested iteration (0 the coarsest), ``a`` the strength of the monitor that
    the step solves for, below the asked one while continuation is at work. ``residual`` is relative to the mean flux;
    of a sweep it is the largest deviation of a squared metric length from the mean of its line. ``converged`` is set by
    the last step of a level at the asked ``a``, ``failed`` where it fell short.
    """

    level: int
    levels: int
    grid: Grid
    a: float
    step: int
    residual: float
    mesh: Mesh
    converged: bool = False
    failed: bool = False


@dataclass(frozen=True)
class LocalSolution:
    """How a guarded Newton solve ended: residual relative to the mean flux, and whether it met the tolerance."""

    mesh: Mesh
    steps: int
    residual: float
    converged: bool


def newton_steps(
    equations: MeshEquations, start: Mesh, tolerance: float = TOLERANCE, most_steps: int = MOST_STEPS
) -> Iterator[LocalSolution]:
    """Guarded Newton steps for one set of mesh equations, never through a folded mesh.

    ``tolerance`` is relative to the mean flux, and is raised to the rounding floor of the grid where it lies below.
    """
    z = equations.vector(start)
    unit = equations.mean_flux(z)
    floor = ROUNDING * max(equations.shape)
    steps = newton.iterate(
        equations.residual,
        equations.jacobian,
        z,
        admissible=lambda candidate: not equations.mesh(candidate).is_folded,
        tolerance=max(tolerance, floor) * unit,
    )
    for record in steps:
        met = record.residual <= max(tolerance, floor) * unit
        yield LocalSolution(equations.mesh(record.z), record.step, record.residual / unit, met)
        if record.step >= most_steps:
            return


def iterate(problem: Problem, start: Mesh | None = None, *, chord: bool = True) -> Iterator[NewtonRecord]:
    """Newton steps and chord sweeps up the nested grids to the single-domain solution.

    ``start`` is a mesh of the problem's own grid: Newton then begins there, without nested iteration. Where Newton
    fails on a level, continuation in ``a`` from the uniform mesh (exact for ``a = 0``) is tried; where that falls short
    of the asked ``a``, it goes on from there on the next finer grids, up to 65 points in a direction. The last record
    has ``converged`` or ``failed`` set and the finest mesh that was reached. ``chord=False`` uses Newton on all levels:
    a reference, hundreds of times slower on fine grids.
    """
    grids = [problem.grid] if start is not None else nested_grids(problem.grid)
    mesh = start if start is not None else Mesh.uniform(grids[0])
    reached = problem.monitor.a
    for level, grid in enumerate(grids):
        guess = mesh if mesh.x.shape == grid.shape else prolong(mesh, grid)
        record = NewtonRecord(
            level=level, levels=len(grids), grid=grid, a=problem.monitor.a, step=0, residual=np.nan, mesh=guess
        )
        here = replace(problem, grid=grid)
        if reached < problem.monitor.a:
            records = _continuation(here, record, reached)
        else:
            records = _solve_level(here, guess, record, chord=chord and level > 0)
        for record in records:
            yield record
        if record.failed and (level + 1 == len(grids) or max(grids[level + 1].shape) > FINEST_CONTINUATION):
            return
        mesh, reached = record.mesh, record.a


def nested_grids(grid: Grid) -> list[Grid]:
    """Grids from coarse to fine, each with about half the cells a side of the next, down to 17 points or fewer."""
    grids = [grid]
    while max(grids[0].shape) > COARSEST:
        grids.insert(0, halved(grids[0]))
    return grids


def halved(grid: Grid) -> Grid:
    """The grid with about half the cells a side, as far as a direction has points to spare."""
    n_xi, n_eta = (n // 2 + 1 if n >= 2 * SMALLEST else n for n in grid.shape)
    return Grid(n_xi=n_xi, n_eta=n_eta)


def prolong(mesh: Mesh, grid: Grid) -> Mesh:
    """The mesh interpolated to another grid: by cubic splines, linearly if those fold.

    A valid mesh interpolated linearly may still fold; the uniform mesh is returned then.
    """
    for degree in (3, 1):
        candidate = _interpolate(mesh, grid, degree)
        if not candidate.is_folded:
            return candidate
    return Mesh.uniform(grid)


def _interpolate(mesh: Mesh, grid: Grid, degree: int) -> Mesh:
    xi, eta = (np.linspace(0, 1, n) for n in mesh.x.shape)
    new_xi, new_eta = (np.linspace(0, 1, n) for n in grid.shape)
    x, y = (RectBivariateSpline(xi, eta, q, kx=degree, ky=degree, s=0)(new_xi, new_eta) for q in (mesh.x, mesh.y))
    return Mesh.of_unit_square(x, y)


def _solve_level(problem: Problem, guess: Mesh, label: NewtonRecord, *, chord: bool) -> Iterator[NewtonRecord]:
    """Chord sweeps from the guess if asked; else, or on failure, Newton from it; on failure, continuation in ``a``."""
    record = label
    if chord:
        for record in _chord(problem, guess, label):
            yield record
        if record.converged:
            return
    for record in _newton(problem, guess, label):
        if record.failed:
            break
        yield record
    if record.failed:
        yield from _continuation(problem, replace(label, mesh=Mesh.uniform(problem.grid)), 0.0)


def _chord(problem: Problem, guess: Mesh, label: NewtonRecord) -> Iterator[NewtonRecord]:
    for sweep in chord_iteration.iterate(problem, guess):
        if not sweep.failed:
            yield replace(label, step=sweep.sweep, residual=sweep.deviation, mesh=sweep.mesh, converged=sweep.converged)


def _newton(problem: Problem, guess: Mesh, label: NewtonRecord) -> Iterator[NewtonRecord]:
    last = None
    for last in map(_on_the_sides, newton_steps(problem.equations(), guess)):
        if last.converged:
            break
        yield replace(label, a=problem.monitor.a, step=last.steps, residual=last.residual, mesh=last.mesh)
    if last is None:
        raise AssertionError("a Newton iteration yields its start")
    yield replace(
        label,
        a=problem.monitor.a,
        step=last.steps,
        residual=last.residual,
        mesh=last.mesh,
        converged=last.converged,
        failed=not last.converged,
    )


def _on_the_sides(solution: LocalSolution) -> LocalSolution:
    return replace(solution, mesh=Mesh.of_unit_square(solution.mesh.x, solution.mesh.y))


def _continuation(problem: Problem, label: NewtonRecord, reached: float) -> Iterator[NewtonRecord]:
    """From the label's mesh, near the solution for ``a = reached``, in adaptive steps to the asked ``a``.

    The last record has ``converged`` or ``failed``; in the latter case its ``a`` is what was reached.
    """
    asked, mesh = problem.monitor.a, label.mesh
    advance = (asked - reached) / 3
    while reached < asked:
        target = min(asked, reached + advance)
        attempt = replace(problem, monitor=replace(problem.monitor, a=target))
        record = label
        for record in _newton(attempt, mesh, label):
            if not (record.failed or record.converged):
                yield record
        if record.converged:
            reached, mesh, advance = target, record.mesh, 1.5 * advance
            yield replace(record, converged=reached == asked)
        elif advance < SMALLEST_ADVANCE * asked:
            yield replace(record, mesh=mesh, a=reached, failed=True)
            return
        else:
            advance /= 2
