"""Progress of a solve: the share of the work that is done, and the records that an observer gets."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeAlias, TypeVar

from equimesh.least_error.descent import Descent
from equimesh.least_error.nest import Level
from equimesh.schwarz.records import Iteration, IterationNumbers
from equimesh.single_domain.steps import TIGHT_DEVIATION, Mode, Step

# Progress estimates, one for each kind of solve, from the records of the steps so far.
#
# A share is an estimate from what is known of the work ahead: grids that are still to come have known numbers of
# points, and steps become smaller at a rate that shows. Where nothing is known there is no share.

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


Event: TypeAlias = Step | Iteration | Descent
Observer: TypeAlias = Callable[[Event], None]
Course: TypeAlias = Sweeping | Descending | Iterating
MAX_UNKNOWN = 0.2
"""If a part with at most this share of the work cannot estimate its progress, its start is reported."""
_E = TypeVar("_E", bound=Event)


@dataclass
class _Told:
    """The progress that was reported so far: the share of the work never falls."""

    observer: Observer
    fraction: float = 0.0


@dataclass(frozen=True)
class Announcer:
    """An observer that adds ``fraction`` and ``phase`` to records, of one part of the work of a solve.

    The part begins at the share ``begin`` of the whole work, and ends at ``end``; both are ``None`` where that is not
    known, as for work that nobody expected. ``doing`` is put before the words of a step.
    """

    told: _Told
    begin: float | None = 0.0
    end: float | None = 1.0
    doing: str = ""
    course: Course = field(default_factory=Sweeping)

    @classmethod
    def of(cls, observer: Observer | None) -> Announcer | None:
        """The announcer of a whole solve; one that is given already stays, since it is a part of larger work."""
        if observer is None or isinstance(observer, Announcer):
            return observer
        return cls(_Told(observer))

    def part(
        self, begin: float | None = 0.0, end: float | None = 1.0, doing: str = "", course: Course | None = None
    ) -> Announcer:
        """A part of this one, between two shares of it; ``None`` for work whose share is not known."""
        words = ": ".join(text for text in (self.doing, doing) if text)
        course = Sweeping() if course is None else course
        if begin is None or end is None or self.begin is None or self.end is None:
            return replace(self, begin=None, end=None, doing=words, course=course)
        width = self.end - self.begin
        return replace(self, begin=self.begin + width * begin, end=self.begin + width * end, doing=words, course=course)

    def __call__(self, event: Event) -> None:
        """Announce a record."""
        self.announce(event)

    def announce(self, event: _E) -> _E:
        """Hand a record to the observer, which may keep it: nothing changes it later. Returns that record."""
        share, phase = self._look(event)
        fraction = None
        if self.begin is not None and self.end is not None:
            if share is None and self.end - self.begin <= MAX_UNKNOWN:
                share = 0.0
            if share is not None:
                self.told.fraction = max(self.told.fraction, self.begin + (self.end - self.begin) * share)
                fraction = self.told.fraction
        phase = f"{self.doing}: {phase}" if self.doing else phase
        record = replace(event, fraction=fraction, phase=phase)
        if isinstance(record, Step):
            record = record.snapshot()
        self.told.observer(record)
        return record

    def _look(self, event: Event) -> tuple[float | None, str]:
        """The share of this part that is done, and what is being done."""
        match event, self.course:
            case Step(), Sweeping() as course:
                return course.look(event)
            case Descent(), Descending() as course:
                return course.look(event)
            case Iteration(), Iterating() as course:
                return course.look(event)
        raise AssertionError(f"{type(event).__name__} is no record of {type(self.course).__name__}")
