"""The lines of the table: measured numbers and their goals."""

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass, field
from statistics import median
from typing import Any, TypeVar

T = TypeVar("T")

RUNS = 5


@dataclass(frozen=True, kw_only=True)
class Row:
    """One measured number. ``goal`` is its upper limit, or with ``at_least`` its lower limit.

    ``counts`` do not depend on the machine: sweeps by grid, Newton steps.
    """

    what: str
    value: float
    unit: str
    goal: float | None = None
    at_least: bool = False
    note: str = ""
    counts: dict[str, int] = field(default_factory=dict)

    @property
    def met(self) -> bool | None:
        """Whether the goal is met; ``None`` where there is none."""
        if self.goal is None:
            return None
        return self.value >= self.goal if self.at_least else self.value <= self.goal

    def plain(self) -> dict[str, Any]:
        """The row as plain data, ready for JSON."""
        return {**asdict(self), "met": self.met}


WIDTHS = (54, 17, 7, 7)  # of what, measured, goal, met; notes follow
HEADING = ("", "measured", "goal (of the developers, on an idle machine)")


def lines(rows: Iterable[Row]) -> Iterator[str]:
    """The lines of a table with a heading, each as soon as its row is measured."""
    yield _line(HEADING)
    for row in rows:
        goal = "" if row.goal is None else f"{'>=' if row.at_least else '<='} {row.goal:g}"
        met = {None: "", True: "met", False: "not met"}[row.met]
        counted = ", ".join(f"{name}: {count}" for name, count in row.counts.items())
        note = "; ".join(part for part in (counted, row.note) if part)
        yield _line((row.what, f"{row.value:.3g} {row.unit}", goal, met, note))


def _line(cells: tuple[str, ...]) -> str:
    padded = [text.ljust(width) for text, width in zip(cells, WIDTHS, strict=False)]
    return "  ".join([*padded, *cells[len(WIDTHS) :]]).rstrip()


def cpu_seconds(work: Callable[[], T], runs: int = RUNS) -> tuple[float, T]:
    """Median CPU time of ``work`` in all threads of this process, and its last result."""
    times = []
    for _ in range(runs):
        start = time.process_time()
        result = work()
        times.append(time.process_time() - start)
    return median(times), result
