"""The least-error mesh: descent on nested meshes, from the start that leads to the smallest measured error.

A grid on a domain and a domain in blocks are solved by the same code: a :class:`~equimesh.least_error.nest.Nest` has
their nested meshes. On the coarse meshes the descent runs from each of a few starts. The finer meshes continue from the
one with the smallest error there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from equimesh.blocks.blocks import Blocks
from equimesh.domains.domain import Domain
from equimesh.least_error.block_mesh import BlockNest, BlockStart
from equimesh.least_error.descent import Descent, StraightLines, descend
from equimesh.least_error.evaluation import Result
from equimesh.least_error.kernels import Norm, Rule
from equimesh.least_error.nest import Level, Nest, Start, last_compared
from equimesh.least_error.objective import Objective, Weights
from equimesh.least_error.other_errors import ProjectedObjective, objective_of
from equimesh.least_error.paved import descend_paved, paved_steps
from equimesh.least_error.projection import is_projected
from equimesh.least_error.restricted import Merged, Subdomains
from equimesh.least_error.starts import GridNest
from equimesh.meshes.mesh import Grid, Mesh
from equimesh.monitors.least_error import LeastError
from equimesh.numerics.types import Array
from equimesh.quality.interpolation import InterpolationErrors

MAX_LINES = 17
"""Lines of each family, at most, of the rectilinear starts that are compared."""
MAX_FINE_LINES = 257
"""Lines of each family, at most, of the start that is taken."""
FLOORS = (1.0, 0.1, 0.01)
"""Shares of lines for flat parts of u that are tried, as in :func:`~equimesh.least_error.starts.equidistributed`."""
MAX_GAIN_POINTS = 129 * 129
"""Points of the finest mesh on which the errors of other meshes are measured, for the records and to choose a start.

On finer ones that would take as long as a step.
"""
MIN_DECREASE = 2.5e-3
"""Mean decrease of the objective, thus of the logarithm of the error, in a step at which a descent ends."""
MAX_EFFORT = 10.0
"""The largest factor by which a low smoothness lowers that decrease."""
MAX_MORE_STEPS = 2.0
"""The largest factor by which it raises the limit of steps."""
MAX_LIFTED_ERRORS = {"l2": 1.5, "h1": 1.0}
"""The largest error of a mesh from a coarser one over that of straight lines; above it these are continued."""
DISTORTION_WEIGHT = 0.06
"""The weight of distortion in the objective for ``distortion = 1``."""
SMOOTHNESS_WEIGHT = 2.4e-4
"""The weight of smoothness in the objective for ``smoothness = 1``, for each cell of the mesh.

Second differences fall with the square of the spacing. Times the number of cells, the sum of their squares is the same
for one map on all meshes.
"""
IRREGULAR_STEPS = 1.5
"""How many times the usual steps are taken where lines end inside the domain: nodes there have farther to go."""
IRREGULAR_DISTORTION = 6.0
"""How many times the usual weight distortion has there: cells are bent around such nodes."""
OBLIQUENESS_WEIGHT = 10.0
"""The weight of corners with small angles, where these have a limit."""
MODERATE_COTANGENT = 1.0
"""The limit for the obliqueness of a monitor: 45 degrees, so that few angles are over 60."""
MARGIN_DEGREES = 10.0
"""The distance from the limit at which corners begin to have weight: some always go beyond."""
MAX_VALUE_POINTS = 9 * 9
"""Points of meshes on which the error of u leads a descent for its gradient: it finds fronts more surely."""
MORE_SLOPE_POINTS = 1
"""Gauss points a direction in addition for errors of the gradient, which are small at the points of a lean rule.

The error of a solver depends on the gradient of u."""
MORE_POINTS = {1: 0, 2: 1, 3: 1, 4: 2}
"""Gauss points a direction in addition for elements of each degree."""
FINER_POINTS = 4
"""Gauss points a direction of the rule that checks that of a mesh, and replaces it where the two differ."""
MAX_RULE_CHANGE = 0.1
"""The largest relative change of the error by the finer rule: a descent makes an error small where it is measured."""
MAX_CHECKED_POINTS = 20_000
"""Points of a mesh, at most, on which its rule is checked; a finer mesh is checked where the coarser one failed."""


def weights_of(distortion: float, smoothness: float, cells: int) -> Weights:
    """The weights of the objective on a mesh with so many ``cells``, for those of a monitor."""
    return Weights(distortion=DISTORTION_WEIGHT * distortion, smoothness=SMOOTHNESS_WEIGHT * smoothness * cells)


@dataclass(frozen=True, kw_only=True, eq=False)
class DescentEnd:
    """The end of a descent on one of the nested meshes."""

    origin: Start
    level: Level
    mesh: Array
    """The unknowns, shape ``(2, nodes)``: reference coordinates on a grid."""
    record: Descent
    """The record of the last step."""
    history: tuple[Mapping[str, Any], ...] = ()
    """The numbers of all steps to it, where it was kept."""
    errors: InterpolationErrors | None = None
    """The errors of interpolation on quadrilaterals, next to those of the initial mesh, where they were measured."""


@dataclass(frozen=True, eq=False)
class LiftedMesh:
    """A mesh on the next finer level, with the start that it belongs to."""

    origin: Start
    mesh: Array
    measure: Callable[[], float]
    """Measures :attr:`error`."""

    @cached_property
    def error(self) -> float:
        """The error of the mesh by the quadrature of its level."""
        return self.measure()


@dataclass(frozen=True, kw_only=True)
class LeastErrorSolve:
    """A solve for the mesh of least error of ``monitor``, on the points of ``grid`` or on a ``domain`` in blocks."""

    monitor: LeastError
    domain: Domain | Blocks
    grid: Grid | None = None
    """``None`` for a domain in blocks."""
    threads: int = 1
    """How many threads share the work; the mesh does not depend on it."""
    subdomains: Subdomains | None = None
    """The subdomains that descend on the finest mesh; ``None`` for a descent of the whole mesh."""
    smallest_angle: float | None = None
    """The angle of corners, in degrees, below which few of them should be; ``None`` for no aim."""
    obliqueness: float = OBLIQUENESS_WEIGHT
    """The weight of corners near and beyond that angle."""
    starts: tuple[Any, ...] = ()
    """The starts, where they are known; none to find them."""
    _objectives: dict[tuple[int, Start, Norm, int], Objective] = field(default_factory=dict, init=False, repr=False)

    @cached_property
    def nest(self) -> Nest[Any, Any, Any]:
        """The nested meshes."""
        if isinstance(self.domain, Blocks):
            return BlockNest(domain=self.domain, is_nested=self.subdomains is not None)
        if self.grid is None:
            raise TypeError("a mesh of four sides needs a grid")
        return GridNest(domain=self.domain, finest=self.grid)

    @property
    def levels(self) -> Sequence[Level]:
        """The nested meshes, from coarse to fine."""
        return self.nest.levels

    @property
    def effort(self) -> float:
        """How much farther a descent goes than with the usual smoothness: less of it asks for a smaller error."""
        return min(max(1.0, 1.0 / self.monitor.smoothness), MAX_EFFORT)

    @property
    def more_steps(self) -> float:
        """How many times the steps of a level are taken, at most."""
        return min(self.effort, MAX_MORE_STEPS) * (1.0 if self.nest.is_regular else IRREGULAR_STEPS)

    def steps(
        self, start: Mesh | None = None, *, uniform_only: bool = False, coarse: DescentEnd | None = None
    ) -> Iterator[Descent]:
        """The records of all steps; the mesh of the last one is the result.

        With ``start``, a valid mesh of the reference square on the same grid, or of the same domain in blocks, the
        descent begins with that mesh on a coarse level, and on the finest one again where that is better. Otherwise it
        begins with the uniform or initial mesh and, unless ``uniform_only``, with a rectilinear one. ``coarse``
        continues from the result of :meth:`coarse`.
        """
        levels = self.levels
        if start is not None:
            yield from self._continue(start)
            return
        if coarse is None:
            coarse = yield from self._coarse(levels[: self.last_compared(levels) + 2], None, uniform_only=uniform_only)
        elif coarse.level.is_finest:
            yield coarse.record
        finer = levels[coarse.level.number + 1 :]
        if finer:
            yield from self._climb(coarse.origin, finer, self._lifted(coarse, finer[0]))

    def last_compared(self, levels: Sequence[Level]) -> int:
        """The number of the finest of the ``levels`` up to which the descents from all starts run."""
        return last_compared(levels, "interpolation" if self.grid is None else self.monitor.purpose)

    def with_starts(self) -> LeastErrorSolve:
        """The solve with the starts that it finds, for others of the same u."""
        return replace(self, starts=tuple(self._starts_of(self.levels[self.last_compared(self.levels)])))

    def coarse(self, level: Level) -> Generator[Descent, None, DescentEnd]:
        """The records of the descent to one of the nested meshes; returns its end."""
        return self._coarse(self.levels[: level.number + 1], None, uniform_only=False)

    def lifted_error(self, reached: DescentEnd) -> float:
        """The error of a mesh on the next finer level, which tells more of how the descent will end there."""
        if reached.level.is_finest:
            return reached.record.error
        level = self.levels[reached.level.number + 1]
        mesh = self._lifted(reached, level).mesh
        return self._objective(level, reached.origin, self.monitor.norm, FINER_POINTS).error(mesh)

    def first_error(self, origin: Start, level: Level) -> float:
        """The error of the first mesh of a start."""
        return self._error(origin, level, self.nest.first_mesh(origin, level))

    def _continue(self, start: Mesh) -> Iterator[Descent]:
        """The records of the steps from a given mesh."""
        *coarse, finest = self.levels
        given = self.nest.given(start)
        mesh = self.nest.first_mesh(given, finest)
        if coarse:
            reached = yield from self._coarse(coarse, start, uniform_only=False)
            lifted = self._lifted(reached, finest)
            if lifted.error < self._error(given, finest, mesh):
                yield from self._climb(reached.origin, [finest], lifted)
                return
        # Distortion is that of the initial mesh: from step to step of a sequence cells would become flatter.
        yield from self._descend(self.nest.from_coarse(start), finest, mesh)

    def _coarse(
        self, levels: Sequence[Level], start: Mesh | None, *, uniform_only: bool
    ) -> Generator[Descent, None, DescentEnd]:
        """The descents from all starts, up to the last of the ``levels`` for the best of them."""
        last = self.last_compared(levels)
        coarse, fine = levels[: last + 1], levels[last + 1 :]
        reached = []
        if start is not None:
            reached += yield from self._from_given(coarse[-1], start)
        if not reached:
            for origin in [self.nest.uniform()] if uniform_only else self.starts or self._starts_of(coarse[-1]):
                reached.append((yield from self._climb(origin, coarse)))
        if not fine:
            best = min(reached, key=lambda end: end.record.error)
            if best is not reached[-1]:
                yield best.record
            return best
        lifted = [self._lifted(end, fine[0]) for end in reached]
        first = min(lifted, key=lambda one: one.error) if len(lifted) > 1 else lifted[0]
        return (yield from self._climb(first.origin, fine, first))

    def _lifted(self, reached: DescentEnd, level: Level) -> LiftedMesh:
        """A mesh on the next finer level, or the first mesh of its start there where that has a much smaller error.

        Straight lines are drawn for each level anew, and can meet a thin layer better than a mesh from a coarse one.
        Where lines end inside, the initial mesh can be better, too. On fine meshes the coarser one has met it.
        """
        origin, norm = reached.origin, self._norm(level)
        mesh = self.nest.lifted(
            origin, reached.mesh, reached.level, level, lambda: self._objective(level, origin, norm, is_next=True)
        )
        lifted = LiftedMesh(origin, mesh, lambda: self._error(origin, level, mesh))
        if (origin.is_uniform and self.nest.is_regular) or level.points > MAX_GAIN_POINTS:
            return lifted
        start = self.nest.first_mesh(origin, level)
        first = LiftedMesh(origin, start, lambda: self._error(origin, level, start))
        return lifted if lifted.error <= MAX_LIFTED_ERRORS[self.monitor.norm] * first.error else first

    def _error(self, origin: Start, level: Level, mesh: Array) -> float:
        """The error of a mesh of a level."""
        objective = self._objective(level, origin, self._norm(level))
        objective.cut(mesh)
        return objective.error(mesh)

    def _starts_of(self, level: Level) -> Iterator[Start]:
        """The starts that are compared: from the uniform mesh, and from the best rectilinear one if that is better."""
        uniform = self.nest.uniform()
        yield uniform
        norm = self._norm(level)
        objective = self._objective(level, uniform, norm)
        best, least = None, objective.error(self.nest.first_mesh(uniform, level))
        if not least > objective.rounding:
            return
        for floor in FLOORS:
            origin = self.nest.rectilinear(self.monitor.u, self.monitor.norm, MAX_LINES, floor, self.monitor.degree)
            if origin is None:
                continue
            mesh = self.nest.first_mesh(origin, level)
            if objective.smallest_share(mesh) > 0.0:
                error = objective.error(mesh)
                if error < least:
                    best, least = floor, error
        if best is not None:
            origin = self.nest.rectilinear(self.monitor.u, self.monitor.norm, MAX_FINE_LINES, best, self.monitor.degree)
            if origin is not None:
                yield origin

    def _from_given(self, level: Level, start: Mesh) -> Generator[Descent, None, list[DescentEnd]]:
        """The end of the descent from a given mesh, on a coarse level; none where it is folded there."""
        sampled = self.nest.sampled(start, level)
        if sampled is None:
            return []
        return [(yield from self._descend(self.nest.from_coarse(start), level, sampled))]

    def _climb(
        self, origin: Start, levels: Sequence[Level], lifted: LiftedMesh | None = None
    ) -> Generator[Descent, None, DescentEnd]:
        """Descent on each level, from the mesh of the level before it, on the first one from the mesh ``lifted`` there.

        Without that a start begins where it is not folded.
        """
        if lifted is None:
            valid = [level for level in levels if not self.nest.is_folded(self.nest.first_mesh(origin, level), level)]
            levels = valid or levels[-1:]
        first, *finer = levels
        start = self.nest.first_mesh(origin, first) if lifted is None else lifted.mesh
        reached = yield from self._descend(origin, first, start)
        for level in finer:
            reached = yield from self._descend(origin, level, self._lifted(reached, level).mesh)
        return reached

    def _descend(self, origin: Start, level: Level, start: Array) -> Generator[Descent, None, DescentEnd]:
        """Descent on one level."""
        norm = self._norm(level)
        objective = self._objective(level, origin, norm)
        start = objective.held(start)
        objective = self._enough(objective, level, origin, start)
        objective.cut(start)
        # Records are in the requested norm, also where another one leads the descent.
        is_other = norm != self.monitor.norm
        measured = self._objective(level, origin, self.monitor.norm) if is_other else objective
        uniform_error = None
        if level.points <= MAX_GAIN_POINTS:
            uniform_error = measured.error(self.nest.initial(level))

        steps = self._most_steps(level)

        def record(step: int, mesh: Array, error: float, distortion: float) -> Descent:
            return Descent(
                level=level.number,
                levels=level.count,
                grid=self.nest.grid(level),
                step=step,
                steps=steps,
                error=error,
                gain=None if uniform_error is None else uniform_error / error if error > 0.0 else 1.0,
                distortion=distortion,
                min_jacobian=self.nest.min_jacobian(level, mesh),
                mesh=self.nest.mesh(level, mesh),
                start=origin.name,
            )

        mesh, last = start, None
        for step, (mesh, now) in enumerate(self._moves(objective, level, origin, start)):
            last = record(step, mesh, measured.error(mesh) if is_other else now.error, now.distortion)
            yield last
        if last is None:
            last = record(0, start, measured.error(start), 0.0)
            yield last
        return DescentEnd(origin=origin, level=level, mesh=mesh, record=last)

    def _enough(self, objective: Objective, level: Level, origin: Start, start: Array) -> Objective:
        """The objective with enough Gauss points for the mesh that a descent begins with.

        Where u is singular at a corner that turns inwards, or a front narrower than a cell, few points see little of
        the error. The descent would make it small at these points alone.
        """
        if self.nest.is_regular or level.points > MAX_CHECKED_POINTS or level.gauss_points >= FINER_POINTS:
            return objective
        finer = self._objective(level, origin, self._norm(level), FINER_POINTS)
        here, there = objective.error(start), finer.error(start)
        return objective if abs(there - here) <= MAX_RULE_CHANGE * here else finer

    @property
    def weights(self) -> tuple[float, float, float, float]:
        """Distortion, smoothness, the smallest angle and its weight; NaN where angles have no limit."""
        angle = math.nan if self.smallest_angle is None else self.smallest_angle
        return self.monitor.distortion, self.monitor.smoothness, angle, self.obliqueness

    def with_weights(self, weights: Sequence[float]) -> LeastErrorSolve:
        """The solve with these :attr:`weights`."""
        distortion, smoothness, angle, obliqueness = weights
        return replace(
            self,
            monitor=replace(self.monitor, distortion=distortion, smoothness=smoothness),
            smallest_angle=None if math.isnan(angle) else angle,
            obliqueness=obliqueness,
        )

    def follow(self, start: Array, first: Array) -> None:
        """Descend in subdomains on the finest mesh, from ``first``, which another solve has reached.

        ``start`` is the first mesh of its start.
        """
        finest = self.levels[-1]
        origin = BlockStart(name="", starts={finest.number: start})
        objective = self._objective(finest, origin, self.monitor.norm)
        objective = self._enough(objective, finest, origin, first)
        objective.cut(first)
        for _ in self._moves(objective, finest, origin, first):
            pass

    def _most_steps(self, level: Level) -> int:
        """Steps on a level at most; exchanges where subdomains descend."""
        if self.nest.is_paved:
            return paved_steps(level.points, self.more_steps)
        steps = round(level.steps * self.more_steps)
        return self.subdomains.settings.exchanges(steps) if self.subdomains and level.is_finest else steps

    def _moves(
        self, objective: Objective, level: Level, origin: Start, start: Array
    ) -> Iterator[tuple[Array, Result | Merged]]:
        """The meshes of a descent on one level: of all nodes, of straight lines, or of subdomains."""
        least, steps, nest = MIN_DECREASE / self.effort, self._most_steps(level), self.nest
        if self.monitor.rectilinear and isinstance(nest, GridNest):
            straight = StraightLines(objective, nest.grid(nest.levels[level.number]).shape)
            for lines, now in descend(straight, straight.lines(start), steps, least):
                yield straight.mesh(lines), now
        elif nest.is_paved:
            chart: Any = nest.chart(level)  # of curves, as only blocks are paved
            yield from descend_paved(objective, chart, nest.initial(level), start, least, self.more_steps)
        elif self.subdomains is not None and level.is_finest:
            self.subdomains.begin(self.weights, nest.first_mesh(origin, level), start)
            owner = nest.owners(self.subdomains.settings)
            yield from self.subdomains.descend(objective, owner, start, steps, least, self.threads)
        else:
            yield from descend(objective, start, steps, least)

    def _norm(self, level: Level) -> Norm:
        """The norm of the error that the descent on a level lowers."""
        return "l2" if level.points <= MAX_VALUE_POINTS and not level.is_finest else self.monitor.norm

    def _objective(
        self, level: Level, origin: Start, norm: Norm, gauss_points: int | None = None, *, is_next: bool = False
    ) -> Objective:
        """The objective of a level; on a small mesh of quadrilaterals, which are never cut, the one that there was.

        On any mesh of these it is kept until it is asked for again, where a descent ``is_next``.
        """
        key = level.number, origin, norm, gauss_points or level.gauss_points
        found = self._objectives.pop(key, None) or self._new_objective(level, origin, norm, key[-1])
        if (is_next or level.points <= MAX_GAIN_POINTS) and self.monitor.cells == "quad":
            self._objectives[key] = found
        return found

    def _new_objective(self, level: Level, origin: Start, norm: Norm, gauss_points: int) -> Objective:
        # Cells that move far are cut the other way, which a descent on triangles does not see.
        kind = self.monitor.cells if level.is_finest else "quad"
        cells = self.nest.cells(level, are_cut=kind == "triangle")
        of_solver = self.monitor.purpose == "finite_element" and norm == "l2" and is_projected(cells)
        points = gauss_points + (MORE_SLOPE_POINTS if norm == "h1" or of_solver else 0)
        points += MORE_POINTS[self.monitor.degree]
        weights = weights_of(self.monitor.distortion, self.monitor.smoothness, cells.count)
        if not self.nest.is_regular:
            weights = replace(weights, distortion=IRREGULAR_DISTORTION * weights.distortion)
        if self.smallest_angle is not None:
            limit = 1.0 / math.tan(math.radians(self.smallest_angle + MARGIN_DEGREES))
            weights = replace(weights, obliqueness=self.obliqueness, largest_cotangent=limit)
        elif self.monitor.obliqueness > 0.0:
            weights = replace(weights, obliqueness=self.monitor.obliqueness, largest_cotangent=MODERATE_COTANGENT)
        rule = Rule(norm=norm, cells=kind, points=points, degree=self.monitor.degree)
        chart, start = self.nest.chart(level), self.nest.first_mesh(origin, level)
        kind_of_error = ProjectedObjective if of_solver else objective_of(self.monitor.u)
        objective = kind_of_error(self.monitor.u, chart, cells, start, weights, rule, self.threads)
        objective.bound_cut_off(self.nest.initial(level), self.nest.finest_cells / cells.count)
        return objective
