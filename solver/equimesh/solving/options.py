"""Options of one solve that do not belong to its problem."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import TypeAlias

from equimesh.schwarz.records import Iteration
from equimesh.single_domain.steps import Mode, Step

Event: TypeAlias = Step | Iteration
Observer: TypeAlias = Callable[[Event], None]


class Initial(StrEnum):
    """Where a solve starts: ``NESTED``, the solution on a grid half as fine; ``UNIFORM``, the uniform mesh."""

    NESTED = "nested"
    UNIFORM = "uniform"


@dataclass(frozen=True)
class SolveOptions:
    """The options of a call of :func:`~equimesh.solving.solve.solve`, checked."""

    mode: Mode
    """When a single-domain solve is done."""
    allow_relaxed: bool
    """Whether a mesh of relaxed equations is a success."""
    threads: int
    """How many share the work."""
    observer: Observer | None
    """Is called with every step and iteration."""

    def observe(self, event: Event) -> None:
        """Hand a record to the observer, if there is one. It may keep the record: nothing changes it later."""
        if self.observer is not None:
            self.observer(event.snapshot() if isinstance(event, Step) else event)
