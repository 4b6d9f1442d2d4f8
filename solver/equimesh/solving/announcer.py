"""Adds the share of the work that is done, and a phase in words, to each record of a solve, for its observer.

Work has parts, and a part has parts of its own: an :class:`Announcer` is one of them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TypeAlias, TypeVar

from equimesh.least_error.steps import Descent
from equimesh.schwarz.records import Iteration
from equimesh.single_domain.steps import Step
from equimesh.solving.courses import Descending, Iterating, Sweeping

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
