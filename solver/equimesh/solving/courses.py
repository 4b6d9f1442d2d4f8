"""Progress estimates, one for each kind of solve, from the records of the steps so far.

A share is an estimate from what is known of the work ahead: grids that are still to come have known numbers of points,
and steps become smaller at a rate that shows. Where nothing is known there is no share.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from equimesh.least_error.levels import Level
from equimesh.least_error.steps import Descent
from equimesh.schwarz.records import IterationNumbers
from equimesh.single_domain.steps import TIGHT_DEVIATION, Mode, Step

LEVEL_RATIO = 0.25
"""The work on a nested grid, over that on the next finer one."""
FIRST_SWEEPS = 10
"""Sweeps that the first grid usually takes. A finer one usually takes as many as the grid before it."""
LEAST_SWEEPS = 2
"""Sweeps that a grid takes at least."""
LEAST_CHANGES = 3
"""Changes of a Schwarz iteration that show a rate."""
STEADY_RATIO = 1.35
"""The largest ratio of two numbers of iterations, expected one after the other, of which the second is believed.

The first changes often fall faster than the later ones.
"""
RATE_CHANGES = 6
"""Changes, at most, over which the rate is taken."""


def level_share(level: int, levels: int, within: float) -> float:
    """The share of nested grids that is done: all below ``level``, and the share ``within`` of that one."""
    total = sum(LEVEL_RATIO**k for k in range(levels))
    below = sum(LEVEL_RATIO**k for k in range(levels - level, levels))
    return (below + LEVEL_RATIO ** (levels - 1 - level) * within) / total


def approach(step: int, expected: float) -> float:
    """The share of ``expected`` steps that is done; with more steps than that it comes near 1 and stays below it."""
    return step / max(expected, step + 1.0)


@dataclass
class Sweeping:
    """The course of a single-domain solve up its nested grids, or of a gradient map with its own ``doing``."""

    mode: Mode = Mode.DISCRETIZATION
    doing: str = ""
    _level: int = -1
    _expected: float = FIRST_SWEEPS
    _count: int = 0
    _relaxing: int = 0
    _is_lost: bool = False

    def look(self, step: Step) -> tuple[float | None, str]:
        """The share that is done and what is being done; no share for relaxed equations, whose end nobody knows."""
        if step.level != self._level:
            self._is_lost = self._is_lost or step.level < self._level  # the solve has begun again, on other grids
            self._expected = max(LEAST_SWEEPS, self._count or FIRST_SWEEPS)
            self._level, self._count, self._relaxing = step.level, 0, 0
        if not step.relaxation.is_none:
            self._relaxing += 1
            return None, f"relaxing, step {self._relaxing}"
        self._count += 1
        share = 1.0 if step.converged else approach(step.step, self._steps(step))
        phase = f"{self.doing} on the {step.grid} grid" if self.doing else f"sweeping the {step.grid} grid"
        return None if self._is_lost else level_share(step.level, step.levels, share), phase

    def _steps(self, step: Step) -> float:
        """How many steps the grid is expected to take."""
        is_tight = self.mode is Mode.TIGHT and step.level + 1 == step.levels
        if is_tight and step.contraction < 1.0 and step.residual > TIGHT_DEVIATION:
            return step.step + math.log(step.residual / TIGHT_DEVIATION) / -math.log(step.contraction)
        return self._expected


@dataclass
class Descending:
    """The course of a least-error solve on nested grids, from ``starts`` first meshes on the coarse ones.

    ``compared`` is the number of the last grid on which the starts are compared.
    """

    levels: Sequence[Level]
    starts: int
    compared: int
    _seen: list[str] = field(default_factory=list)

    def look(self, step: Descent) -> tuple[float | None, str]:
        """The share that is done, by the largest numbers of steps and the points of their grids."""
        if step.start not in self._seen:
            self._seen.append(step.start)
        coarse = sum(_work(level) for level in self.levels if level.number <= self.compared)
        total = descent_work(self.levels, self.starts, self.compared)
        done = sum(_work(level) for level in self.levels if level.number < step.level)
        done += sum(_work(level) for level in self.levels if level.number == step.level) * step.step / step.steps
        before = self._seen.index(step.start) if step.level <= self.compared else self.starts - 1
        share = min(1.0, (min(before, self.starts - 1) * coarse + done) / total) if total else 1.0
        return share, f"descending, step {step.step} of {step.steps}"


def descent_work(levels: Sequence[Level], starts: int, compared: int) -> float:
    """The work of a descent, from all starts on the levels up to number ``compared``, if all steps are taken."""
    return sum((starts if level.number <= compared else 1) * _work(level) for level in levels)


def _work(level: Level) -> float:
    """The work on a grid, if all of its steps are taken."""
    return float(level.steps * level.points * level.gauss_points**2)


@dataclass
class Iterating:
    """The course of a Schwarz iteration to ``tolerance``; without one all ``most`` iterations are made."""

    tolerance: float | None
    most: int
    _changes: list[float] = field(default_factory=list)
    _expected: float = math.nan

    def look(self, record: IterationNumbers) -> tuple[float | None, str]:
        """The share that is done; none before the changes show a rate."""
        number = record.iteration
        if number == 0:
            self._changes = []
        else:
            self._changes = [*self._changes[: number - 1], record.change]
        phase = f"iteration {number}"
        if self.tolerance is None:
            return number / self.most, f"{phase} of {self.most}"
        if number and record.meets(self.tolerance):
            return 1.0, phase
        total, before = self._total(number, record.estimate), self._expected
        self._expected = math.nan if total is None else total
        if total is None or not 1.0 / STEADY_RATIO <= total / before <= STEADY_RATIO:
            return None, phase
        return number / total, f"{phase} of {'at most' if total == self.most else 'about'} {total}"

    def _total(self, number: int, estimate: float) -> int | None:
        """How many iterations are expected, at the rate of the last changes; ``None`` where they show none."""
        last = self._changes[-1 - RATE_CHANGES :]
        if self.tolerance is None or len(last) < LEAST_CHANGES or not (0.0 < last[-1] < last[0]):
            return None
        rate = (last[-1] / last[0]) ** (1.0 / (len(last) - 1))
        error = estimate if math.isfinite(estimate) else last[-1]
        left = math.log(error / self.tolerance) / -math.log(rate) if error > self.tolerance else 1.0
        return min(self.most, number + max(1, math.ceil(round(left, 6))))
