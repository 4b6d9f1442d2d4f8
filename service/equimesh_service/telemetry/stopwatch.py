"""A stopwatch for the parts of a request and of the work that it waits for: the header Server-Timing."""

import time
from collections.abc import Mapping
from contextvars import ContextVar


class Stopwatch:
    """The seconds of each part, in the order in which the parts first ended."""

    def __init__(self) -> None:
        self._last = time.perf_counter()
        self.laps: dict[str, float] = {}

    def lap(self, name: str) -> None:
        """End a part: it began when the part before it ended."""
        now = time.perf_counter()
        self.laps[name] = self.laps.get(name, 0.0) + now - self._last
        self._last = now

    def include(self, laps: Mapping[str, float]) -> None:
        """Take over parts that another process has measured since the last part ended."""
        for name, seconds in laps.items():
            self.laps[name] = self.laps.get(name, 0.0) + seconds
            self._last += seconds

    def to_header(self) -> str:
        """The parts in milliseconds, as the header Server-Timing (W3C Server Timing)."""
        return ", ".join(f"{name};dur={1e3 * max(seconds, 0.0):.2f}" for name, seconds in self.laps.items())


_current: ContextVar[Stopwatch | None] = ContextVar("stopwatch", default=None)


def start() -> Stopwatch:
    """A new stopwatch, the current one of this task."""
    stopwatch = Stopwatch()
    _current.set(stopwatch)
    return stopwatch


def lap(name: str) -> None:
    """End a part of the current request; nothing outside of requests."""
    stopwatch = _current.get()
    if stopwatch is not None:
        stopwatch.lap(name)


def include(laps: Mapping[str, float]) -> None:
    """Take over the parts of a worker in the current request; nothing outside of requests."""
    stopwatch = _current.get()
    if stopwatch is not None:
        stopwatch.include(laps)
