"""The choice of a mesh for codes with cell-centred unknowns, by the error of such a code on the candidates.

Candidates are solved on a coarse grid, and measured there by :func:`equimesh.quality.faces.poisson_error`. The best
ones are solved and measured on finer grids up to the requested one, together with the uniform mesh.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

from equimesh.domains.domain import map_mesh
from equimesh.equations.problem import Problem
from equimesh.errors import InputError
from equimesh.least_error.nest import coarse_level, nested_levels
from equimesh.meshes.mesh import Grid, Mesh
from equimesh.monitors.least_error import Auto
from equimesh.monitors.metrics import ArcLength, Curvature
from equimesh.monitors.monitor import MAX_ORTHOGONALITY, Monitor, weaken
from equimesh.monitors.smoothed import Smoothed
from equimesh.quality.faces import check_cells, measure_faces, poisson_error
from equimesh.solving.orthogonality import bounded, is_within
from equimesh.solving.solution import AnySolution, Solution
from equimesh.solving.status import SolveOptions, Status
from equimesh_schema import Candidate

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
