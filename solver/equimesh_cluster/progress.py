"""What a running solve tells its observer: one record for each sweep, from the records of all parts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

from equimesh.meshes.grid import Grid
from equimesh.single_domain.steps import Step
from equimesh.solving.courses import approach, level_share
from equimesh_cluster.parts.part_solution import PartStep


@dataclass(frozen=True, kw_only=True)
class Progress:
    """One step of a solve on a cluster.

    ``level`` counts from 0 to ``levels - 1``, the requested grid. The coarse levels are solved by one worker, so
    ``parts`` is 1 there and nothing is sent. ``messages`` and ``bytes`` are those that all parts sent since the record
    before. ``attempt`` is 2 or 3 after workers were lost; the parts then begin again. ``fraction`` is the share of the
    work that is done, 0 to 1, or None where it is not known, and ``phase`` says what is being done.
    """

    level: int
    levels: int
    grid: Grid
    step: int
    residual: float
    parts: int = 1
    messages: int = 0
    bytes: int = 0
    attempt: int = 1
    fraction: float | None = None
    phase: str = ""


USUAL_SWEEPS = 6
"""Sweeps that a grid usually takes."""

Observer: TypeAlias = Callable[[Progress], None]


def coarse_progress(step: Step, levels: int) -> Progress:
    """The record of a step on a level that one worker solves; ``levels`` are those of the whole solve."""
    is_relaxed = not step.relaxation.is_none
    return Progress(
        level=step.level,
        levels=levels,
        grid=step.grid,
        step=step.step,
        residual=step.residual,
        fraction=None if is_relaxed else _share(step.level, levels, step.step),
        phase=f"relaxing, step {step.step}" if is_relaxed else f"sweeping the {step.grid} grid",
    )


def _share(level: int, levels: int, step: int) -> float:
    """The share of all grids that is done after a sweep on one of them."""
    return level_share(level, levels, approach(step, USUAL_SWEEPS))


class Gathering:
    """Collects the records of the parts, and observes one record when all parts have sent theirs."""

    def __init__(self, observe: Observer | None) -> None:
        self._observe = observe
        self._count, self._attempt, self._done = 0, 0, 0.0
        self._waiting: dict[int, list[PartStep]] = {}

    def begin(self, count: int) -> None:
        """Begin an attempt with ``count`` parts."""
        self._count, self._attempt, self._waiting = count, self._attempt + 1, {}

    def add(self, number: int, record: PartStep) -> None:
        """Take the next record of part ``number``."""
        self._waiting.setdefault(number, []).append(record)
        while len(self._waiting) == self._count and all(self._waiting.values()):
            self._tell([self._waiting[k].pop(0) for k in range(self._count)])

    def _tell(self, records: list[PartStep]) -> None:
        """Observe the records of all parts as one."""
        if self._observe is None:
            return
        first = records[0]
        self._done = max(self._done, _share(first.level, first.levels, first.step))
        sent = [traffic for record in records for traffic in record.traffic.values()]
        self._observe(
            Progress(
                level=first.level,
                levels=first.levels,
                grid=first.grid,
                step=first.step,
                residual=first.residual,
                parts=self._count,
                messages=sum(traffic.messages for traffic in sent),
                bytes=sum(traffic.bytes for traffic in sent),
                attempt=self._attempt,
                fraction=self._done,
                phase=f"sweeping the {first.grid} grid in {self._count} parts",
            )
        )
