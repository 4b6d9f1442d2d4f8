"""The least-error mesh: descent on nested grids, from the start that leads to the smallest measured error.

On the coarse grids the descent runs from each of a few starts. The finer grids continue from the one with the smallest
error there.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator
from dataclasses import dataclass, replace

import numpy as np

from equimesh.domains.closing import closed_of
from equimesh.domains.domain import Domain, map_mesh
from equimesh.least_error.cells import cells_of_grid
from equimesh.least_error.charts import DomainChart
from equimesh.least_error.descent import descend
from equimesh.least_error.elements import Norm, Rule
from equimesh.least_error.levels import Level, nested_levels
from equimesh.least_error.objective import Evaluation, Objective, Weights
from equimesh.least_error.starts import product, rectilinear, resampled
from equimesh.least_error.steps import Descent
from equimesh.least_error.straight_lines import StraightLines
from equimesh.least_error.ways import Way, coordinates_of, mesh_of
from equimesh.meshes.closed import Closed, interpolated_closed
from equimesh.meshes.grid import Grid
from equimesh.meshes.interpolation import interpolated_values
from equimesh.meshes.mesh import Mesh
from equimesh.monitors.least_error import LeastError
from equimesh.numerics.types import Array

MAX_COMPARED_POINTS = 17 * 17
"""Points of the grid, at most, on which the starts are compared."""
MAX_LINES = 17
"""Lines of each family, at most, of the rectilinear starts that are compared."""
MAX_FINE_LINES = 257
"""Lines of each family, at most, of the start that is taken."""
FLOORS = (1.0, 0.1, 0.01)
"""Shares of lines for flat parts of u that are tried, as in :func:`~equimesh.least_error.starts.rectilinear`."""
MAX_GAIN_POINTS = 129 * 129
"""Points of the finest grid on which the errors of other meshes are measured, for the records and to choose a start.

On finer grids that would take as long as a step.
"""
MIN_DECREASE = 2.5e-3
"""Mean decrease of the objective, thus of the logarithm of the error, in a step at which a descent ends."""
MAX_EFFORT = 10.0
"""The largest factor by which a low smoothness lowers that decrease."""
MAX_MORE_STEPS = 2.0
"""The largest factor by which it raises the limit of steps."""
MAX_LIFTED_ERRORS = {"l2": 1.5, "h1": 1.0}
"""The largest error of a mesh from a coarser grid over that of straight lines; above it these are continued."""
DISTORTION_WEIGHT = 0.06
"""The weight of distortion in the objective for ``distortion = 1``."""
SMOOTHNESS_WEIGHT = 2.4e-4
"""The weight of smoothness in the objective for ``smoothness = 1``, for each cell of the grid.

Second differences fall with the square of the spacing. Times the number of cells, the sum of their squares is the same
for one map on all grids.
"""
MAX_VALUE_POINTS = 9 * 9
"""Points of the grids on which the error of u leads the way to a small error of the gradient: it finds fronts surer."""
MORE_SLOPE_POINTS = 1
"""Gauss points a direction in addition for errors of the gradient, which are small at the points of a lean rule."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Reached:
    """The end of a descent on one grid."""

    way: Way
    level: Level
    mesh: Array
    """Reference coordinates, shape ``(2, nodes)``."""
    record: Descent
    """The record of the last step."""


@dataclass(frozen=True, kw_only=True)
class LeastErrorSolve:
    """A solve for the mesh of least error of ``monitor`` on the points of ``grid``."""

    monitor: LeastError
    domain: Domain
    grid: Grid
    threads: int = 1
    """How many threads share the work; the mesh does not depend on it."""

    @property
    def weights(self) -> Weights:
        """The weights of the objective."""
        return Weights(
            distortion=DISTORTION_WEIGHT * self.monitor.distortion,
            smoothness=SMOOTHNESS_WEIGHT * self.monitor.smoothness,
        )

    @property
    def closed(self) -> Closed:
        """Whether lines along xi, and those along eta, are closed."""
        return closed_of(self.domain)

    @property
    def effort(self) -> float:
        """How much farther a descent goes than with the usual smoothness: less of it asks for a smaller error."""
        return min(max(1.0, 1.0 / self.monitor.smoothness), MAX_EFFORT)

    def steps(
        self, start: Mesh | None = None, *, uniform_only: bool = False, coarse: Reached | None = None
    ) -> Iterator[Descent]:
        """The records of all steps; the mesh of the last one is the result.

        With ``start``, a valid mesh of the reference square on the same grid, the descent begins with that mesh on a
        coarse grid, and on the finest grid again where that is better. Otherwise it begins with the uniform mesh and,
        unless ``uniform_only``, with a rectilinear one. ``coarse`` continues from the result of :meth:`coarse`.
        """
        levels = nested_levels(self.grid)
        if start is not None:
            yield from self._continue(start, levels)
            return
        if coarse is None:
            coarse = yield from self._coarse(levels[: last_compared(levels) + 2], None, uniform_only=uniform_only)
        elif coarse.level.is_finest:
            yield coarse.record
        yield from self._climb(coarse.way, levels[coarse.level.number + 1 :], coarse)

    def coarse(self, level: Level) -> Generator[Descent, None, Reached]:
        """The records of the descent to one of the nested grids; returns its end."""
        return self._coarse(nested_levels(self.grid)[: level.number + 1], None, uniform_only=False)

    def _continue(self, start: Mesh, levels: list[Level]) -> Iterator[Descent]:
        """The records of the steps from a given mesh."""
        *coarse, finest = levels
        given, mesh = Way.given(self.weights, start, self.closed), coordinates_of(start)
        if coarse:
            reached = yield from self._coarse(coarse, start, uniform_only=False)
            if self._lifted_error(reached, finest) < self._error(given, finest, mesh):
                yield from self._climb(reached.way, [finest], reached)
                return
        yield from self._descend(given, finest, mesh)

    def _coarse(
        self, levels: list[Level], start: Mesh | None, *, uniform_only: bool
    ) -> Generator[Descent, None, Reached]:
        """The descents from all starts, up to the last of the ``levels`` for the best of them."""
        last = last_compared(levels)
        coarse, fine = levels[: last + 1], levels[last + 1 :]
        reached = []
        if start is not None:
            reached += yield from self._from_given(coarse[-1], start)
        if not reached:
            for way in [Way.uniform(self.weights, closed=self.closed)] if uniform_only else self._ways(coarse[-1]):
                reached.append((yield from self._climb(way, coarse)))
        if not fine:
            best = min(reached, key=lambda end: end.record.error)
            if best is not reached[-1]:
                yield best.record
            return best
        best = min(reached, key=lambda end: self._lifted_error(end, fine[0]))
        return (yield from self._climb(best.way, fine, best))

    def _lifted(self, reached: Reached, level: Level) -> Array:
        """A mesh on the next finer grid, or the first mesh of its way there where that has a much smaller error.

        Straight lines are drawn for each grid anew, and can meet a thin layer better than a mesh from a coarse grid. On
        fine grids the coarser one has met it.
        """
        way = reached.way
        lifted = way.lifted(reached.mesh, reached.level.grid, level.grid, self.domain)
        if way.is_uniform or level.grid.points > MAX_GAIN_POINTS:
            return lifted
        start = way.start(level.grid)
        most = MAX_LIFTED_ERRORS[self.monitor.norm] * self._error(way, level, start)
        return lifted if self._error(way, level, lifted) <= most else start

    def _lifted_error(self, reached: Reached, level: Level) -> float:
        """The error of a mesh on the next finer grid, which tells more of how the descent will end there."""
        return self._error(reached.way, level, self._lifted(reached, level))

    def _error(self, way: Way, level: Level, mesh: Array) -> float:
        """The error of a mesh on the grid of a level."""
        objective = self._objective(level, way, self._norm(level))
        objective.cut(mesh)
        return objective.error(mesh)

    def _ways(self, level: Level) -> Iterator[Way]:
        """The ways that are compared: from the uniform mesh, and from the best rectilinear one if that is better."""
        uniform = Way.uniform(self.weights, closed=self.closed)
        yield uniform
        objective = self._objective(level, uniform, self._norm(level))
        best, least = None, objective.error(uniform.start(level.grid))
        if not least > objective.rounding:
            return
        for floor in FLOORS:
            lines = self._lines(MAX_LINES, floor)
            if lines is None:
                continue
            mesh = product(
                *(
                    resampled(line, n, closed=closed)
                    for line, n, closed in zip(lines, level.grid.shape, self.closed, strict=True)
                )
            )
            if objective.smallest_share(mesh) > 0.0:
                error = objective.error(mesh)
                if error < least:
                    best, least = floor, error
        lines = None if best is None else self._lines(MAX_FINE_LINES, best)
        if lines is not None:
            yield Way(name="rectilinear", s=lines[0], t=lines[1], weights=self.weights, closed=self.closed)

    def _lines(self, most: int, floor: float) -> tuple[Array, Array] | None:
        """Rectilinear lines, at most ``most`` of each family."""
        counts = min(self.grid.n_xi, most), min(self.grid.n_eta, most)
        return rectilinear(self.monitor.u, self.domain, counts, self.monitor.norm, floor, closed=self.closed)

    def _from_given(self, level: Level, start: Mesh) -> Generator[Descent, None, list[Reached]]:
        """The end of the descent from a given mesh, on a coarse grid; none where it is folded there."""
        way = Way.uniform(self.weights, "given", self.closed)
        if any(self.closed):
            sampled = coordinates_of(interpolated_closed(start, level.grid, self.closed))
        else:
            sampled = np.stack([interpolated_values(q, level.grid.shape).reshape(-1) for q in (start.x, start.y)])
        if self._is_folded(sampled, level.grid) if any(self.closed) else mesh_of(sampled, level.grid).is_folded:
            return []
        return [(yield from self._descend(way, level, sampled))]

    def _is_folded(self, mesh: Array, grid: Grid) -> bool:
        return map_mesh(mesh_of(mesh, grid), self.domain).is_folded

    def _climb(self, way: Way, levels: list[Level], before: Reached | None = None) -> Generator[Descent, None, Reached]:
        """Descent on each of the levels, from the mesh of the level before it.

        Few lines around a ring can lie so far apart that their cells fold: closed ways begin on a finer grid then.
        """
        if before is None and any(self.closed):
            valid = [level for level in levels if not self._is_folded(way.start(level.grid), level.grid)]
            levels = valid or levels[-1:]
        for level in levels:
            start = way.start(level.grid) if before is None else self._lifted(before, level)
            before = yield from self._descend(way, level, start)
        if before is None:
            raise AssertionError("there is at least one level")
        return before

    def _descend(self, way: Way, level: Level, start: Array) -> Generator[Descent, None, Reached]:
        """Descent on one grid."""
        objective = self._objective(level, way, self._norm(level))
        start = objective.held(start)
        objective.cut(start)
        # Records are in the requested norm, also where another one leads the way.
        is_other = self._norm(level) != self.monitor.norm
        measured = self._objective(level, way, self.monitor.norm) if is_other else objective
        uniform_error = None
        if level.grid.points <= MAX_GAIN_POINTS:
            uniform_error = measured.error(coordinates_of(Mesh.uniform(level.grid)))

        steps = round(level.steps * min(self.effort, MAX_MORE_STEPS))

        def record(step: int, mesh: Array, error: float, distortion: float) -> Descent:
            square = mesh_of(mesh, level.grid)
            return Descent(
                level=level.number,
                levels=level.count,
                grid=level.grid,
                step=step,
                steps=steps,
                error=error,
                gain=None if uniform_error is None else uniform_error / error if error > 0.0 else 1.0,
                distortion=distortion,
                min_jacobian=map_mesh(square, self.domain).min_jacobian / self.domain.area,
                mesh=square,
                start=way.name,
            )

        mesh, last = start, None
        for step, (mesh, now) in enumerate(self._moves(objective, level, start, steps)):
            last = record(step, mesh, measured.error(mesh) if is_other else now.error, now.distortion)
            yield last
        if last is None:
            last = record(0, start, measured.error(start), 0.0)
            yield last
        return Reached(way=way, level=level, mesh=mesh, record=last)

    def _moves(
        self, objective: Objective, level: Level, start: Array, steps: int
    ) -> Iterator[tuple[Array, Evaluation]]:
        """The meshes of a descent on one grid, of all nodes or of straight lines."""
        min_decrease = MIN_DECREASE / self.effort
        if not self.monitor.rectilinear:
            yield from descend(objective, start, steps, min_decrease)
            return
        straight = StraightLines(objective, level.grid.shape)
        for lines, now in descend(straight, straight.lines(start), steps, min_decrease):
            yield straight.mesh(lines), now

    def _norm(self, level: Level) -> Norm:
        """The norm of the error that the descent on a grid lowers."""
        return "l2" if level.grid.points <= MAX_VALUE_POINTS and not level.is_finest else self.monitor.norm

    def _objective(self, level: Level, way: Way, norm: Norm) -> Objective:
        points = level.gauss_points + (MORE_SLOPE_POINTS if norm == "h1" else 0)
        # Cells that move far are cut the other way, which a descent on triangles does not see.
        cells = self.monitor.cells if level.is_finest else "quad"
        rule = Rule(norm=norm, cells=cells, points=points)
        objective = Objective(
            self.monitor.u,
            DomainChart(self.domain),
            cells_of_grid(level.grid.shape, self.closed),
            way.start(level.grid),
            replace(way.weights, smoothness=way.weights.smoothness * level.grid.cells),
            rule,
            self.threads,
        )
        objective.bound_cut_off(coordinates_of(Mesh.uniform(level.grid)), self.grid.cells / level.grid.cells)
        return objective


def last_compared(levels: list[Level]) -> int:
    """The number of the finest level up to which the descents from all starts run."""
    return max((level.number for level in levels if level.grid.points <= MAX_COMPARED_POINTS), default=0)
