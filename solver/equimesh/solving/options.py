"""How a solve goes about it, whatever the problem."""

from __future__ import annotations

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
    """How a solve goes about it, whatever the problem."""

    mode: Mode
    allow_relaxed: bool
    threads: int
    observe: Observer
