"""Candidates for the next mesh: descents from the mesh before on coarse grids, and meshes of straight lines."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from equimesh.domains.domain import Domain, map_mesh
from equimesh.fields.expression import Field
from equimesh.least_error.cells import cells_of_grid
from equimesh.least_error.charts import DomainChart
from equimesh.least_error.descent import descend
from equimesh.least_error.iteration import MORE_POINTS, MORE_SLOPE_POINTS, weights_of
from equimesh.least_error.kernels import Norm, Rule
from equimesh.least_error.nest import GridLevel, nested_levels
from equimesh.least_error.objective import Objective, Weights
from equimesh.least_error.other_errors import ProjectedObjective, objective_of
from equimesh.least_error.starts import Start, coordinates_of, mesh_of, rectilinear
from equimesh.meshes.mesh import Grid, Mesh
from equimesh.meshes.nested import interpolated_values
from equimesh.numerics.types import Array
from equimesh.quality.elements import CellKind
from equimesh.rounds.norms import is_of_solver, measured

STEPS = ((17 * 17, 25), (33 * 33, 30), (129 * 129, 8))
"""Steps of descent, at most, on grids of at most this many points. The mesh before has done much of the work."""
STEPS_BEYOND = 3
"""On finer grids."""
MIN_DECREASE = 1e-3
"""Mean decrease of the objective in a step at which a descent on a coarse grid ends."""
MAX_COMPARED_POINTS = 33 * 33
"""Points of the grid, at most, up to which every candidate is descended."""
LINE_FLOORS = (1.0, 0.1)
"""Shares of straight lines for flat parts of u that are tried; see :func:`~equimesh.least_error.starts.rectilinear`."""
MAX_CLIMBING = 2
"""Candidates, at most, that are descended on the last grid of comparison; the others end on the grid before it."""
MAX_VALUE_POINTS = 17 * 17
"""Points of the grids on which the error of u leads a descent for its gradient: it finds fronts more surely."""
MEASURED_POINTS = 2
"""Gauss points a direction and cell at which candidates are compared; descents need no more."""
PARTS = "parts"
"""The name of candidates that keep more of the mesh before."""
SMOOTH, SHARP = (0.5, 1.0), (0.2, 0.3)
"""Weights of distortion and smoothness; see :class:`~equimesh.monitors.least_error.LeastError`."""
SAMPLED = (("whole", 0, SMOOTH), ("whole, sharper", 0, SHARP), (PARTS, 1, SHARP))
"""Candidates from the mesh before: their names, the numbers of the grids on which they begin, and their weights.

From the coarsest grid fronts move far, from the next one rings keep their shape.
"""
DISPLACEMENT_SHARES = (1.0, 0.9, 0.8, 0.7, 0.6, 0.5)
"""Shares of the displacements of the mesh before that are tried on a coarse grid, until it is not folded there."""
LINES, STRAIGHT = "lines", "straight lines"
"""The names of the candidates whose first lines are straight: polished on the finer grids, and as they are."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidate:
    """A mesh of the reference square on the requested grid."""

    name: str
    origin: Start
    level: GridLevel
    """The finest grid on which it was descended."""
    mesh: Array
    """On the requested grid, shape ``(2, nodes)``."""
    coarse: Array
    """On the grid of ``level``."""
    error: float
    """The norm of the error of the interpolant of the recovered u."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Search:
    """The search for a mesh on which the interpolant of ``u`` has a small error, from the mesh ``before``."""

    u: Field
    domain: Domain
    before: Mesh
    """A mesh of the reference square."""
    norm: Norm
    degree: int = 1
    """The degree of the interpolant."""
    cells: CellKind = "quad"
    """The cells of the file, on which its error is measured."""
    of_solver: bool = False
    """Whether the error in L2 is that of a solver, in place of that of the interpolant, where it can be known.

    Of a u whose layers the values did not resolve it says little.
    """
    threads: int = 1

    def candidates(self) -> Iterator[Candidate]:
        """The candidates that are not folded, each with its measured error on the requested grid."""
        levels = self._levels
        *coarse, last = [level for level in levels[:-1] if level.grid.points <= MAX_COMPARED_POINTS] or levels[:1]
        straight = self._straight()
        found = list(self._climbed(coarse or [last], straight))
        if coarse:
            found = sorted(found, key=lambda one: one.error)[:MAX_CLIMBING]
            found = [again for one in found for again in self._descended_to(one, last)]
            if not any(one.origin.is_uniform for one in found) and (started := self._started([last])):
                found += self._climb(Start.uniform(PARTS), [last], started[1])
        yield from found
        if straight is not None:
            yield straight

    def error_on(self, mesh: Mesh) -> float:
        """The norm of the error of the interpolant of u on a mesh of the reference square, as of all candidates."""
        rule = rule_of(self.norm, self.degree, self.cells)
        return measured(self.u, self.domain, mesh, rule, self.threads, of_solver=self.of_solver)

    def _climbed(self, levels: list[GridLevel], straight: Candidate | None) -> Iterator[Candidate]:
        """The ends of the descents from all starts on the coarse levels."""
        begun = set()
        for name, first, weights in SAMPLED:
            started = self._started(levels[first:] or levels)
            if started and (started[0].number, weights) not in begun:
                begun.add((started[0].number, weights))
                yield from self._climb(Start.uniform(name), levels[started[0].number :], started[1])
        if straight is not None:
            origin, first_level = replace(straight.origin, name=LINES), (levels[1:] or levels)[0]
            yield from self._climb(origin, levels[first_level.number :], origin.first_mesh(first_level.grid))

    def _straight(self) -> Candidate | None:
        """The better of the meshes of straight lines."""
        level = self._levels[-1]
        found: list[Candidate] = []
        for floor in LINE_FLOORS:
            lines = rectilinear(self.u, self.domain, level.grid.shape, self.norm, floor)
            if lines is not None:
                origin = Start(name=STRAIGHT, s=lines[0], t=lines[1])
                found += self._candidate(origin, level, origin.first_mesh(level.grid))
        return min(found, key=lambda one: one.error, default=None)

    def _descended_to(self, candidate: Candidate, level: GridLevel) -> Iterator[Candidate]:
        """The candidate after the descent on one more level; none where it is folded."""
        mesh = _lifted(candidate.origin, candidate.coarse, candidate.level, level)
        mesh = self._descended(candidate.origin, level, mesh, MIN_DECREASE)
        yield from self._candidate(candidate.origin, level, mesh)

    def finished(self, candidate: Candidate) -> Candidate:
        """The candidate after descents on the finer grids; itself where these do not lower its error."""
        levels, at, mesh = self._levels, candidate.level, candidate.coarse
        for level in levels[at.number + 1 :] or [at]:
            mesh = self._descended(
                candidate.origin, level, _lifted(candidate.origin, mesh, at, level), min_decrease=0.0
            )
            at = level
        return min([candidate, *self._candidate(candidate.origin, at, mesh)], key=lambda one: one.error)

    def _started(self, levels: list[GridLevel]) -> tuple[GridLevel, Array] | None:
        """The mesh before on the first of the levels on whose grid it is not folded, with the level.

        Few of its nodes may be the nodes of a folded mesh. Then their displacements are reduced, down to a half.
        """
        for level in levels:
            mesh, uniform = self._sampled(level.grid), coordinates_of(Mesh.uniform(level.grid))
            for share in DISPLACEMENT_SHARES:
                reduced = uniform + share * (mesh - uniform)
                if not mesh_of(reduced, level.grid).is_folded:
                    return level, reduced
        return None

    def _climb(self, origin: Start, levels: list[GridLevel], mesh: Array) -> Iterator[Candidate]:
        """The end of the descents from a mesh on the first of the levels."""
        at = levels[0]
        for level in levels:
            mesh = self._descended(origin, level, _lifted(origin, mesh, at, level), MIN_DECREASE)
            at = level
        yield from self._candidate(origin, at, mesh)

    def _candidate(self, origin: Start, level: GridLevel, coarse: Array) -> Iterator[Candidate]:
        """The candidate with a mesh on the grid of a level; none where it is folded on the domain, or u not finite."""
        mesh = _lifted(origin, coarse, level, self._levels[-1])
        square = mesh_of(mesh, self.before.grid)
        if not (square.is_folded or map_mesh(square, self.domain).is_folded):
            error = self.error_on(square)
            if np.isfinite(error):
                yield Candidate(name=origin.name, origin=origin, level=level, mesh=mesh, coarse=coarse, error=error)

    def _descended(self, origin: Start, level: GridLevel, mesh: Array, min_decrease: float) -> Array:
        """The mesh after the steps of a level."""
        steps = next((steps for points, steps in STEPS if level.grid.points <= points), STEPS_BEYOND)
        for found, _ in descend(self._objective(origin, level), mesh, steps, min_decrease):
            mesh = found
        return mesh

    def _objective(self, origin: Start, level: GridLevel) -> Objective:
        is_coarse = level.grid.points <= MAX_VALUE_POINTS and not level.is_finest
        norm, cells = "l2" if is_coarse else self.norm, cells_of_grid(level.grid.shape)
        kind = self.cells if level.is_finest else "quad"  # as of one mesh alone
        rule = Rule(norm=norm, cells=kind, points=level.gauss_points + MORE_POINTS[self.degree], degree=self.degree)
        # On the coarsest grid the interpolant leads: solvers of other equations lose by a descent on this error there.
        of_solver = self.of_solver and self.norm == "l2" and level.number > 0 and is_of_solver(rule, cells)
        if of_solver or norm == "h1":
            rule = replace(rule, points=rule.points + MORE_SLOPE_POINTS)
        return (ProjectedObjective if of_solver else objective_of(self.u))(
            self.u,
            DomainChart(self.domain),
            cells,
            origin.first_mesh(level.grid),
            _weights(origin.name, level.grid.cells),
            rule,
            self.threads,
        )

    def _sampled(self, grid: Grid) -> Array:
        """The mesh before on a coarser grid."""
        before = self.before.grid.shape
        parts = [interpolated_values(q.reshape(before), grid.shape) for q in coordinates_of(self.before)]
        for ends in (parts[0], parts[1].T):
            ends[0], ends[-1] = 0.0, 1.0
        return np.stack([part.reshape(-1) for part in parts])

    @cached_property
    def _levels(self) -> list[GridLevel]:
        return nested_levels(self.before.grid)


def rule_of(norm: Norm, degree: int, cells: CellKind = "quad") -> Rule:
    """The rule by which candidates are compared."""
    points = MEASURED_POINTS + (MORE_SLOPE_POINTS if norm == "h1" else 0) + MORE_POINTS[degree]
    return Rule(norm=norm, cells=cells, points=points, degree=degree)


def _lifted(origin: Start, mesh: Array, coarse: GridLevel, fine: GridLevel) -> Array:
    """A mesh on a finer grid, or on its own."""
    return mesh if coarse.number == fine.number else origin.lifted(mesh, coarse.grid, fine.grid)


def _weights(name: str, cells: int) -> Weights:
    """The weights of a candidate on a grid with so many ``cells``."""
    distortion, smoothness = next((weights for known, _, weights in SAMPLED if known == name), SHARP)
    return weights_of(distortion, smoothness, cells)
