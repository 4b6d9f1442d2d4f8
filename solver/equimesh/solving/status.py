"""The options of a solve, the estimates of its progress, and its status, with a remedy where it fails."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from enum import StrEnum
from typing import TypeAlias, TypedDict, TypeVar

from equimesh.equations.newton_solve import smallest_tolerance
from equimesh.equations.problem import Boundary, Problem
from equimesh.errors import DecompositionError
from equimesh.least_error.descent import Descent
from equimesh.least_error.nest import Level
from equimesh.meshes.mesh import Mesh
from equimesh.monitors.metrics import ArcLength
from equimesh.schwarz.conditions import Optimized, label
from equimesh.schwarz.records import Iteration, IterationNumbers
from equimesh.schwarz.settings import Acceleration, Schwarz
from equimesh.single_domain.level import TIGHT_DEVIATION, Mode, Step

# Progress of a solve: the share of the work that is done, and the records that an observer gets.

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
"""The largest ratio of two successive estimates of the number of iterations. A larger one gives no share.

The first changes often fall faster than the later ones.
"""
RATE_CHANGES = 6
"""Changes, at most, over which the rate is taken."""


def level_share(level: int, levels: int, within: float) -> float:
    """The share of nested grids that is done: all below ``level``, and the share ``within`` of that one."""
    # Sums of powers, each over that of one grid more: all grids, and those from this one on.
    whole, rest = LEVEL_RATIO**levels, LEVEL_RATIO ** (levels - level)
    return (rest - whole + rest * (1.0 / LEVEL_RATIO - 1.0) * within) / (1.0 - whole)


def approach(step: int, expected: float) -> float:
    """The share of ``expected`` steps that is done; with more steps than that it comes near 1 and stays below it."""
    return step / max(expected, step + 1.0)


@dataclass
class SweepProgress:
    """Estimates the progress of a single-domain solve on its nested grids.

    ``doing`` replaces the words of a sweep, for instance for a gradient map.
    """

    mode: Mode = Mode.DISCRETIZATION
    doing: str = ""
    _level: int = -1
    _expected: float = FIRST_SWEEPS
    _count: int = 0
    _relaxing: int = 0
    _is_lost: bool = False

    def look(self, step: Step) -> tuple[float | None, str]:
        """The share that is done and the words for the step; no share for relaxed equations, whose end is not known."""
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
        """The expected number of steps on the grid."""
        is_tight = self.mode is Mode.TIGHT and step.level + 1 == step.levels
        if is_tight and step.contraction < 1.0 and step.residual > TIGHT_DEVIATION:
            return step.step + math.log(step.residual / TIGHT_DEVIATION) / -math.log(step.contraction)
        return self._expected


@dataclass
class DescentProgress:
    """Estimates the progress of a least-error solve on nested grids, with ``starts`` first meshes on the coarse ones.

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
class IterationProgress:
    """Estimates the progress of a Schwarz iteration to ``tolerance``; without one all ``most`` iterations are made."""

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
        """The expected number of iterations, at the rate of the last changes; ``None`` where they show no rate."""
        last = self._changes[-1 - RATE_CHANGES :]
        if self.tolerance is None or len(last) < LEAST_CHANGES or not (0.0 < last[-1] < last[0]):
            return None
        rate = (last[-1] / last[0]) ** (1.0 / (len(last) - 1))
        error = estimate if math.isfinite(estimate) else last[-1]
        left = math.log(error / self.tolerance) / -math.log(rate) if error > self.tolerance else 1.0
        return min(self.most, number + max(1, math.ceil(round(left, 6))))


Event: TypeAlias = Step | Iteration | Descent
Observer: TypeAlias = Callable[[Event], None]
Course: TypeAlias = SweepProgress | DescentProgress | IterationProgress
MAX_UNKNOWN = 0.2
"""If a part with at most this share of the work cannot estimate its progress, its start is reported."""
_E = TypeVar("_E", bound=Event)


@dataclass
class _ReportedProgress:
    """The progress that was reported so far: the share of the work never falls."""

    observer: Observer
    fraction: float = 0.0

    @property
    def is_awaited(self) -> bool:
        """Whether the observer takes a record now: one with a method ``is_due`` takes few, and copies take long."""
        is_due = getattr(self.observer, "is_due", None)
        return is_due is None or is_due()


@dataclass(frozen=True)
class Announcer:
    """An observer that adds ``fraction`` and ``phase`` to records, of one part of the work of a solve.

    The part begins at the share ``begin`` of the whole work, and ends at ``end``; both are ``None`` where that is not
    known, as for work that nobody expected. ``doing`` is put before the words of a step.
    """

    told: _ReportedProgress
    begin: float | None = 0.0
    end: float | None = 1.0
    doing: str = ""
    course: Course = field(default_factory=SweepProgress)

    @classmethod
    def of(cls, observer: Observer | None) -> Announcer | None:
        """The announcer of a whole solve; one that is given already stays, since it is a part of larger work."""
        if observer is None or isinstance(observer, Announcer):
            return observer
        return cls(_ReportedProgress(observer))

    def part(
        self, begin: float | None = 0.0, end: float | None = 1.0, doing: str = "", course: Course | None = None
    ) -> Announcer:
        """A part of this one, between two shares of it; ``None`` for work whose share is not known."""
        words = ": ".join(text for text in (self.doing, doing) if text)
        course = SweepProgress() if course is None else course
        if begin is None or end is None or self.begin is None or self.end is None:
            return replace(self, begin=None, end=None, doing=words, course=course)
        width = self.end - self.begin
        return replace(self, begin=self.begin + width * begin, end=self.begin + width * end, doing=words, course=course)

    def __call__(self, event: Event) -> None:
        """Announce a record."""
        self.announce(event)

    def announce(self, event: _E) -> _E:
        """Call the observer with a record, and return that record. Nothing changes it later, so it can be kept.

        Where the observer takes none now, return ``event`` itself.
        """
        share, phase = self._look(event)
        fraction = None
        if self.begin is not None and self.end is not None:
            if share is None and self.end - self.begin <= MAX_UNKNOWN:
                share = 0.0
            if share is not None:
                self.told.fraction = max(self.told.fraction, self.begin + (self.end - self.begin) * share)
                fraction = self.told.fraction
        if not self.told.is_awaited:
            return event
        phase = f"{self.doing}: {phase}" if self.doing else phase
        record = replace(event, fraction=fraction, phase=phase)
        if isinstance(record, Step):
            record = record.snapshot()
        self.told.observer(record)
        return record

    def _look(self, event: Event) -> tuple[float | None, str]:
        """The share of this part that is done, and the words for the step."""
        match event, self.course:
            case Step(), SweepProgress() as course:
                return course.look(event)
            case Descent(), DescentProgress() as course:
                return course.look(event)
            case Iteration(), IterationProgress() as course:
                return course.look(event)
        raise AssertionError(f"{type(event).__name__} is no record of {type(self.course).__name__}")


# Options of one solve that do not belong to its problem.


class Initial(StrEnum):
    """The start of a solve: ``NESTED``, the solution on a grid half as fine; ``UNIFORM``, the uniform mesh."""

    NESTED = "nested"
    UNIFORM = "uniform"


class SolveArguments(TypedDict, total=False):
    """Options of :func:`~equimesh.solving.solve.solve`. Each of them may be left out."""

    initial: Initial | Mesh
    """The start: nested (default), uniform, or a mesh of the reference square, such as the ``reference`` of the
    solution for a monitor a time step earlier. Where such a mesh is far from the solution, the start is nested. On a
    domain in blocks a mesh of the domain, such as the ``mesh`` of a solution.
    """
    mode: Mode
    """The condition that ends a single-domain solve. Default: at the error of the grid. A Schwarz iteration has its own
    tolerance.
    """
    allow_relaxed: bool
    """Whether a mesh of relaxed equations is accepted where no valid mesh satisfies the requested ones. Default: True.
    Its status is ``RELAXED``, and its certificate lists what was relaxed.
    """
    threads: int | None
    """The number of threads that share the work on large grids; the mesh does not depend on it. Default: None, one a
    core.
    """
    observe: Observer | None
    """A function that is called with every step of a single-domain solve and of a nested start, with every Schwarz
    iteration, and with every step of descent. With an ``Auto`` monitor it also gets the steps of the candidates on
    coarse grids. Every record has ``fraction``, the share of the work that is done, and ``phase``, the work in words.
    Default: None.
    """
    check: bool
    """Whether a solve without the requested mesh raises. Default: True. With False, its status reports the failure."""


DEFAULTS: SolveArguments = {
    "initial": Initial.NESTED,
    "mode": Mode.DISCRETIZATION,
    "allow_relaxed": True,
    "threads": None,
    "observe": None,
    "check": True,
}
"""The values of options that are not given."""


def complete_arguments(arguments: SolveArguments) -> SolveArguments:
    """The options of a solve: the given ones, and the defaults of the others.

    Raises :class:`TypeError` for an option that does not exist; the message names the nearest one.
    """
    unknown = [name for name in arguments if name not in DEFAULTS]
    if unknown:
        nearest = get_close_matches(unknown[0], ["problem", "schwarz", *DEFAULTS], n=1)
        advice = f"did you mean {nearest[0]!r}?" if nearest else f"it has {', '.join(DEFAULTS)}"
        raise TypeError(f"solve() has no option {unknown[0]!r}; {advice}")
    return {**DEFAULTS, **arguments}


@dataclass(frozen=True)
class SolveOptions:
    """The options that all methods share, checked."""

    threads: int
    """The number of threads that share the work."""
    observer: Announcer | None
    """The observer, which is called with every step and iteration."""

    def observe(self, event: _E) -> _E:
        """Call the observer, if there is one, with a record; returns the record that the observer got."""
        return event if self.observer is None else self.observer.announce(event)

    def part(
        self, begin: float | None = 0.0, end: float | None = 1.0, doing: str = "", course: Course | None = None
    ) -> SolveOptions:
        """The options for a part of the work, as :meth:`~equimesh.solving.status.Announcer.part`."""
        return self if self.observer is None else replace(self, observer=self.observer.part(begin, end, doing, course))


class Status(StrEnum):
    """The end of a solve. :attr:`sentence` describes it.

    A folded mesh never counts as one of the first three.
    """

    CONVERGED = "converged"
    """The mesh satisfies the equations to the tolerance: success."""
    RELAXED = "relaxed"
    """The mesh is valid and satisfies weaker equations, which the certificate lists: success, if allowed."""
    COMPLETED = "completed"
    """All steps of a Schwarz iteration or a descent were taken, without a tolerance to meet: success."""
    NOT_CONVERGED = "not_converged"
    """A Schwarz iteration reached its limit of iterations before its tolerance."""
    NEWTON_FAILED = "newton_failed"
    """The solve stalled, also with relaxed equations, or these were not allowed."""
    FOLDED = "folded"
    """The solve ended, but its mesh has an inverted cell on the domain."""

    @property
    def succeeded(self) -> bool:
        """Whether the mesh is the requested one, or an allowed approximation of it."""
        return self in (Status.CONVERGED, Status.RELAXED, Status.COMPLETED)

    @property
    def sentence(self) -> str:
        """The status in a sentence."""
        return _SENTENCES[self]


_SENTENCES = {
    Status.CONVERGED: "The mesh satisfies the equidistribution equations to the requested tolerance.",
    Status.RELAXED: "The mesh is valid, but solves weaker equations: those requested had no valid mesh within bounds.",
    Status.COMPLETED: "The mesh is finished: all its steps were taken.",
    Status.NOT_CONVERGED: "The Schwarz iteration did not reach its tolerance within the allowed iterations.",
    Status.NEWTON_FAILED: "No valid mesh was found that satisfies the requested equations.",
    Status.FOLDED: "The mesh has an inverted cell.",
}


# Remedies after a solve that did not reach the requested mesh.

# More iterations than this are not suggested.
MAX_SUGGESTED_ITERATIONS = 1000
# From fewer iterations than this the number of those still needed cannot be predicted.
MIN_RECORDED_ITERATIONS = 5


def after_newton(problem: Problem, *, nested: bool, reached: float = 1.0) -> str:
    """The remedy where no valid mesh was found; continuation ``reached`` this strength of the monitor."""
    if reached == 0.0:
        return _sentence(
            "replace a jump of u, or a change too fast for this grid, by a steep tanh",
            *_weaker(problem, reached),
            *_settings(problem, nested=nested),
        )
    return _sentence(*_weaker(problem, reached), "add grid points", *_settings(problem, nested=nested))


def _weaker(problem: Problem, reached: float) -> list[str]:
    """Ways to request less adaptation."""
    monitor = problem.monitor
    if isinstance(monitor, ArcLength):
        lower = f"lower a to {reached * monitor.a:.2g} or less" if 0.0 < reached < 1.0 else "lower a"
        return [lower, "raise b", "smooth the monitor"]
    return ["smooth the monitor"]


def after_rounding() -> str:
    """The remedy where rounding errors of u are as large as its variation over a cell."""
    return _sentence("subtract a constant from u, so that its values are not much larger than it varies")


def after_mapping() -> str:
    """The remedy for a valid mesh of the reference square that folds on the domain."""
    return _sentence("add grid points: the sides curve too much for this grid")


def after_folding(problem: Problem, schwarz: Schwarz | None, *, nested: bool) -> str:
    """The remedy for a solve that ended with an inverted cell."""
    more = ["run more iterations"] if schwarz is not None and schwarz.tolerance is None else []
    return _sentence(*more, *_weaker(problem, 1.0), *_settings(problem, nested=nested))


def after_schwarz(
    problem: Problem, schwarz: Schwarz, last: IterationNumbers, rate: float | None, tolerance: float
) -> str:
    """The remedy for a Schwarz iteration that did not reach its ``tolerance``.

    ``rate`` is the observed rate, or the predicted one if that is slower.
    """
    ideas = []
    left = max(last.estimate, last.mismatch / 2) / max(tolerance, smallest_tolerance(problem))
    if rate is None or last.iteration < MIN_RECORDED_ITERATIONS:
        ideas.append("allow more iterations")
    elif 0.0 < rate < 1.0 and 1.0 < left < math.inf:
        more = math.ceil(math.log(left) / -math.log(rate)) + 1
        if more <= MAX_SUGGESTED_ITERATIONS:
            ideas.append(f"allow more iterations (about {more} more at the observed rate of {rate:.2g})")
    wider = 2 * schwarz.overlap
    if _fits(problem, schwarz, wider):
        ideas.append(f"widen the overlap, to {wider} points for instance")
    if last.transmission != label(Optimized()):
        ideas.append("use the optimized transmission condition")
    if not schwarz.line_corrections and schwarz.accelerated_by is not Acceleration.NEWTON:
        ideas.append("allow line corrections, 3 for instance")
    return _sentence(*ideas, "solve as a single domain")


def _settings(problem: Problem, *, nested: bool) -> list[str]:
    ideas = [] if nested else ["start nested"]
    return ideas if problem.boundary is Boundary.TRACE else [*ideas, "use the trace boundary condition"]


def _fits(problem: Problem, schwarz: Schwarz, overlap: int) -> bool:
    try:
        replace(schwarz, overlap=overlap).decompose(problem.grid)
    except DecompositionError:
        return False
    return True


def _sentence(*ideas: str) -> str:
    listed = ", or ".join([", ".join(ideas[:-1]), ideas[-1]]) if len(ideas) > 1 else ideas[0]
    return listed[0].upper() + listed[1:] + "."
