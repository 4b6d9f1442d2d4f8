"""Deadlines, and the settings of a client."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from equimesh_client.errors import BadArgument, DeadlineExceeded
from equimesh_client.wire.retry import RetryPolicy

DEFAULT_URL = "http://127.0.0.1:8000"
"""Address of a service with default settings on this machine."""
DEADLINE_SECONDS = 600.0
"""Time for a wait when the caller gives no deadline."""


@dataclass(frozen=True, kw_only=True)
class Deadline:
    """A moment of the monotonic clock; ``seconds`` is what the caller allowed."""

    seconds: float
    end: float
    clock: Callable[[], float] = time.monotonic

    @classmethod
    def after(cls, seconds: float, clock: Callable[[], float] = time.monotonic) -> Deadline:
        """The moment ``seconds`` from now. Raises :class:`BadArgument` unless it is positive."""
        if not seconds > 0:
            raise BadArgument(f"deadline = {seconds}: must be a positive number of seconds")
        return cls(seconds=seconds, end=clock() + seconds, clock=clock)

    @property
    def left(self) -> float:
        """Seconds that remain, at least 0."""
        return max(0.0, self.end - self.clock())

    def exceeded(self, doing: str) -> DeadlineExceeded:
        """The exception for a deadline that has passed while ``doing`` something."""
        return DeadlineExceeded(f"{doing}: the deadline of {self.seconds:g} s has passed")


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of a client: base ``url``, ``timeout`` of a single answer in seconds, retry ``policy``."""

    url: str
    timeout: float
    policy: RetryPolicy

    @property
    def attempts(self) -> float:
        """Time for all attempts at a request, in seconds."""
        return self.timeout * (self.policy.retries + 1)

    def deadline(self, seconds: float | None = None) -> Deadline:
        """The deadline of a plain request, ``seconds`` from now; by default with time for all attempts."""
        return Deadline.after(self.attempts if seconds is None else seconds)
