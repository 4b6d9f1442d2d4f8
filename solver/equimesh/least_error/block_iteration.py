"""The least-error mesh of a domain in blocks: descent on nested meshes, from the initial mesh of the domain."""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from equimesh.blocks.blocks import Blocks
from equimesh.least_error.block_levels import BlockLevel, block_levels, only_level
from equimesh.least_error.block_mesh import BlockMesh, Place
from equimesh.least_error.block_subdomains import LEADER, BlockSubdomains
from equimesh.least_error.descent import descend
from equimesh.least_error.elements import Rule
from equimesh.least_error.iteration import MAX_EFFORT, MORE_SLOPE_POINTS
from equimesh.least_error.objective import Evaluation, Objective, Weights
from equimesh.least_error.paved import descend_paved, is_paved, paved_steps
from equimesh.least_error.restricted import Merged
from equimesh.least_error.steps import Descent
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.monitors.least_error import LeastError
from equimesh.numerics.types import Array

DISTORTION_WEIGHT = 0.4
"""The weight of distortion in the objective for ``distortion = 1``."""
SMOOTHNESS_WEIGHT = 1.0
"""The weight of smoothness in the objective for ``smoothness = 1``."""
OBLIQUENESS_WEIGHT = 10.0
"""The weight of corners with small angles, where these have a limit."""
MARGIN_DEGREES = 10.0
"""The distance from the limit at which corners begin to have weight: some always go beyond."""
MAX_COMPARED_POINTS = 2500
"""Points of a coarse mesh, at most, on which weights are compared."""
MAX_GAIN_POINTS = 129 * 129
"""Points of the finest mesh on which the error of the initial mesh is measured for the records of its steps."""
MIN_DECREASE = 2e-3
"""Mean decrease of the objective in a step at which a descent ends."""
MAX_MORE_STEPS = 3.0
"""How many times the usual steps are taken on a mesh, at most, where the smoothness is low."""
FINER_POINTS = 4
"""Gauss points a direction of the rule that checks that of a mesh, and replaces it where the two differ."""
MAX_RULE_CHANGE = 0.1
"""The largest relative change of the error by the finer rule: a descent makes an error small where it is measured."""
MAX_CHECKED_POINTS = 20_000
"""Points of a mesh, at most, on which its rule is checked; a finer mesh is checked where the coarser one failed."""
MAX_LIFTED_ERROR = 1.0
"""The largest error of a mesh from a coarser one over that of the initial mesh; above it the descent begins anew."""


@dataclass(frozen=True, kw_only=True, eq=False)
class BlocksReached:
    """The end of a descent on one of the nested meshes."""

    place: Place
    record: Descent
    """The record of the last step."""


@dataclass(frozen=True, kw_only=True)
class BlockSolve:
    """A solve for the mesh of least error of ``monitor`` on a ``domain`` in blocks."""

    monitor: LeastError
    domain: Blocks
    threads: int = 1
    """How many threads share the work; the mesh does not depend on it."""
    subdomains: BlockSubdomains | None = None
    """The subdomains that descend on the finest mesh; ``None`` for a descent of the whole mesh."""
    smallest_angle: float | None = None
    """The angle of corners, in degrees, below which few of them should be; ``None`` for no aim."""
    obliqueness: float = OBLIQUENESS_WEIGHT
    """The weight of corners near and beyond that angle."""

    @cached_property
    def levels(self) -> list[BlockLevel]:
        """The nested meshes, from coarse to fine."""
        return [only_level(self.domain.mesh)] if self.is_paved else block_levels(self.domain.mesh)

    @cached_property
    def is_paved(self) -> bool:
        """Whether the blocks are too small for coarser meshes. Smooth displacements are in their place then."""
        return self.subdomains is None and is_paved(self.domain.mesh)

    @property
    def effort(self) -> float:
        """How much farther a descent goes than with the usual smoothness: less of it asks for a smaller error."""
        return min(max(1.0, 1.0 / self.monitor.smoothness), MAX_EFFORT)

    def steps(self, start: QuadMesh | None = None, coarse: BlocksReached | None = None) -> Iterator[Descent]:
        """The records of all steps; the mesh of the last one is the result.

        ``start`` is a valid mesh of the same domain and numbers, from which the descent begins on a coarse mesh, and on
        the finest one again where that is better. Otherwise it begins with the initial mesh of the domain. ``coarse``
        continues from the result of :meth:`compared`.
        """
        reached = coarse
        if coarse is not None and coarse.place.mesh.level.is_finest:
            yield coarse.record
        for level in self.levels[0 if coarse is None else coarse.place.mesh.level.number + 1 :]:
            reached = yield from self._descend(level, reached, start)

    def compared(self) -> Generator[Descent, None, BlocksReached]:
        """The records of the descent to the mesh on which weights are compared; returns its end."""
        reached = yield from self._descend(self.levels[0], None, None)
        for level in self.levels[1 : last_compared(self.levels) + 1]:
            reached = yield from self._descend(level, reached, None)
        return reached

    def lifted_error(self, reached: BlocksReached) -> float:
        """The error of a mesh on the next finer one, which tells more of how the descent will end there."""
        number = reached.place.mesh.level.number + 1
        if number == len(self.levels):
            return reached.record.error
        mesh = self._mesh(self.levels[number])
        objective = self._objective(mesh, FINER_POINTS)
        return objective.error(reached.place.lifted(mesh, objective).unknowns)

    def initial_error(self, reached: BlocksReached) -> float:
        """The error of the initial mesh where :meth:`lifted_error` is measured."""
        number = min(reached.place.mesh.level.number + 1, len(self.levels) - 1)
        mesh = self._mesh(self.levels[number])
        return self._objective(mesh, FINER_POINTS).error(mesh.first.unknowns)

    def _descend(
        self, level: BlockLevel, before: BlocksReached | None, start: QuadMesh | None
    ) -> Generator[Descent, None, BlocksReached]:
        """Descent on one mesh, from the better one of that from the coarser mesh and of the given or initial one."""
        mesh = self._mesh(level)
        objective = self._objective(mesh)
        first, name = mesh.first, "initial"
        if start is not None:
            sampled = mesh.of_points(start.points)
            if objective.smallest_share(sampled.unknowns) > 0.0:
                first, name = sampled, "given"
        if before is not None:
            lifted = before.place.lifted(mesh, objective)
            # On fine meshes a coarser one has met what there is to meet.
            is_fine = level.points > MAX_GAIN_POINTS and start is None
            if is_fine or not objective.error(lifted.unknowns) > MAX_LIFTED_ERROR * objective.error(first.unknowns):
                first, name = lifted, before.record.start
        objective = self._enough(mesh, objective, first)
        objective.cut(first.unknowns)
        initial_error = objective.error(mesh.first.unknowns) if level.points <= MAX_GAIN_POINTS else None
        steps = self._most_steps(level)

        def record(step: int, place: Place, error: float, distortion: float) -> Descent:
            return Descent(
                level=level.number,
                levels=level.count,
                grid=None,
                step=step,
                steps=steps,
                error=error,
                gain=None if initial_error is None else initial_error / error if error > 0.0 else 1.0,
                distortion=distortion,
                min_jacobian=objective.smallest_share(place.unknowns),
                mesh=place.quad_mesh(self.domain.mesh),
                start=name,
            )

        last, place = None, first
        for step, (unknowns, now) in enumerate(self._moves(mesh, objective, first.unknowns)):
            place = Place(mesh=mesh, unknowns=unknowns)
            last = record(step, place, now.error, now.distortion)
            yield last
        if last is None:
            last = record(0, first, objective.error(first.unknowns), 0.0)
            yield last
        return BlocksReached(place=place, record=last)

    def _enough(self, mesh: BlockMesh, objective: Objective, first: Place) -> Objective:
        """The objective with enough Gauss points for the mesh that a descent begins with.

        Where u is singular, or a front narrower than a cell, few points see little of the error. The descent would
        make it small at these points alone.
        """
        if mesh.level.points > MAX_CHECKED_POINTS or mesh.level.gauss_points >= FINER_POINTS:
            return objective
        finer = self._objective(mesh, FINER_POINTS)
        here, there = objective.error(first.unknowns), finer.error(first.unknowns)
        return objective if abs(there - here) <= MAX_RULE_CHANGE * here else finer

    @property
    def weights(self) -> tuple[float, float, float, float]:
        """Distortion, smoothness, the smallest angle and its weight; NaN where angles have no limit."""
        angle = math.nan if self.smallest_angle is None else self.smallest_angle
        return self.monitor.distortion, self.monitor.smoothness, angle, self.obliqueness

    def with_weights(self, weights: Sequence[float]) -> BlockSolve:
        """The solve with these :attr:`weights`."""
        distortion, smoothness, angle, obliqueness = weights
        return replace(
            self,
            monitor=replace(self.monitor, distortion=distortion, smoothness=smoothness),
            smallest_angle=None if math.isnan(angle) else angle,
            obliqueness=obliqueness,
        )

    def follow(self, first: Array) -> None:
        """Descend in the subdomains of this part, where another part leads the same solve, from the mesh ``first``."""
        mesh = self._mesh(self.levels[-1])
        objective = self._objective(mesh)
        objective.cut(first)
        for _ in self._moves(mesh, objective, first):
            pass

    def _most_steps(self, level: BlockLevel) -> int:
        """Steps on a mesh at most; exchanges where subdomains descend."""
        more = min(self.effort, MAX_MORE_STEPS)
        if self.is_paved:
            return paved_steps(level.points, more)
        steps = round(level.steps * more)
        return self.subdomains.settings.exchanges(steps) if self.subdomains and level.is_finest else steps

    def _moves(
        self, mesh: BlockMesh, objective: Objective, first: Array
    ) -> Iterator[tuple[Array, Evaluation | Merged]]:
        """The meshes of a descent of the whole mesh, or of its subdomains."""
        least = MIN_DECREASE / self.effort
        if self.is_paved:
            return descend_paved(objective, mesh, first, least, min(self.effort, MAX_MORE_STEPS))
        if self.subdomains is None or not mesh.level.is_finest:
            return descend(objective, first, self._most_steps(mesh.level), least)
        if self.subdomains.channel.number == LEADER:
            self.subdomains.lead(self.weights, first)
        return self.subdomains.descend(
            objective, self.domain.mesh, first, self._most_steps(mesh.level), least, self.threads
        )

    def _mesh(self, level: BlockLevel) -> BlockMesh:
        return BlockMesh.of(self.domain, level, are_cut=self.monitor.cells == "triangle" and level.is_finest)

    def _objective(self, mesh: BlockMesh, gauss_points: int | None = None) -> Objective:
        level, monitor = mesh.level, self.monitor
        weights = Weights(
            distortion=DISTORTION_WEIGHT * monitor.distortion,
            smoothness=SMOOTHNESS_WEIGHT * monitor.smoothness,
        )
        if self.smallest_angle is not None:
            limit = 1.0 / math.tan(math.radians(self.smallest_angle + MARGIN_DEGREES))
            weights = replace(weights, obliqueness=self.obliqueness, largest_cotangent=limit)
        points = (gauss_points or level.gauss_points) + (MORE_SLOPE_POINTS if monitor.norm == "h1" else 0)
        rule = Rule(norm=monitor.norm, cells=monitor.cells if level.is_finest else "quad", points=points)
        first = mesh.first.unknowns
        objective = Objective(monitor.u, mesh.chart, mesh.cells, first, weights, rule, self.threads)
        objective.bound_cut_off(first, len(self.domain.mesh.cells) / mesh.cells.count)
        return objective


def last_compared(levels: Sequence[BlockLevel]) -> int:
    """The number of the mesh on which weights are compared."""
    return max((level.number for level in levels[:-1] if level.points <= MAX_COMPARED_POINTS), default=0)
