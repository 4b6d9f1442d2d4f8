"""The settings of a client: retries, deadlines and its key."""

from __future__ import annotations

import os
import random
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime

from equimesh_client.errors import BadArgument, DeadlineExceeded
from equimesh_schema.document import is_number

RETRIED = frozenset({429, 502, 503, 504})


@dataclass(frozen=True, kw_only=True)
class RetryPolicy:
    """Exponential backoff with jitter.

    ``retries`` further attempts follow a failed first one; the pause before the k-th is ``first * 2**(k-1)``
    seconds, at most ``longest``, times a random factor from 1/2 to 1. A longer ``Retry-After`` of the service replaces
    it; one above ``patience`` ends the retries at once.
    """

    retries: int = 5
    first: float = 0.25
    longest: float = 8.0
    patience: float = 60.0
    jitter: Callable[[], float] = field(default=random.random, repr=False)

    def __post_init__(self) -> None:
        for name in ("retries", "first", "longest", "patience"):
            value = getattr(self, name)
            if not (is_number(value) and value >= 0):
                raise BadArgument(f"{name} = {value!r:.40}: give a number that is not negative")

    def backoff(self, attempt: int) -> float:
        """Seconds to wait after failed attempt number ``attempt`` (from 0) when the service names no time."""
        whole = min(self.longest, self.first * 2.0 ** min(attempt, 60))
        return whole * (0.5 + 0.5 * self.jitter())


def policy_of(retries: int | RetryPolicy) -> RetryPolicy:
    """A policy, from itself or from the number of retries."""
    return retries if isinstance(retries, RetryPolicy) else RetryPolicy(retries=retries)


def pause_before_retry(
    policy: RetryPolicy, attempt: int, *, status: int | None, retry_after: float | None = None
) -> float | None:
    """Seconds to wait before the next attempt, or None when attempt number ``attempt`` (from 0) was the last.

    ``status`` is the HTTP status of the answer, None when the connection failed.
    """
    if attempt >= policy.retries or (status is not None and status not in RETRIED):
        return None
    if retry_after is not None and retry_after > policy.patience:
        return None
    return max(policy.backoff(attempt), retry_after or 0.0)


def retry_after_of(headers: Mapping[str, str], *, now: datetime | None = None) -> float | None:
    """Seconds of a ``Retry-After`` header (a number or an HTTP date); None without a valid one."""
    value = headers.get("retry-after", "").strip()
    if not value:
        return None
    if value.isascii() and value.isdigit():
        return float(value)
    try:
        then = parsedate_to_datetime(value)
    except ValueError:
        return None
    if then.tzinfo is None:
        then = then.replace(tzinfo=UTC)
    return max(0.0, (then - (now or datetime.now(UTC))).total_seconds())


DEFAULT_URL = "http://127.0.0.1:8000"
"""Address of a service with default settings on this machine."""
DEADLINE_SECONDS = 600.0
"""Time for a wait when the caller gives no deadline."""


def require_seconds(name: str, value: object) -> None:
    """Raise :class:`BadArgument` for a time that is no positive number."""
    if not (is_number(value) and value > 0):
        raise BadArgument(f"{name} = {value!r:.40}: give a positive number of seconds")


@dataclass(frozen=True, kw_only=True)
class Deadline:
    """A moment of the monotonic clock; ``seconds`` is what the caller allowed."""

    seconds: float
    end: float
    clock: Callable[[], float] = time.monotonic

    @classmethod
    def after(cls, seconds: float, clock: Callable[[], float] = time.monotonic) -> Deadline:
        """The moment ``seconds`` from now. Raises :class:`BadArgument` unless it is positive."""
        require_seconds("deadline", seconds)
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

    def __post_init__(self) -> None:
        require_seconds("timeout", self.timeout)

    @property
    def attempts(self) -> float:
        """Time for all attempts at a request, in seconds."""
        return self.timeout * (self.policy.retries + 1)

    def deadline(self, seconds: float | None = None) -> Deadline:
        """The deadline of a plain request, ``seconds`` from now; by default with time for all attempts."""
        return Deadline.after(self.attempts if seconds is None else seconds)


VARIABLE = "EQUIMESH_KEY"
HEADER = "Authorization"


def headers_with_key(headers: Mapping[str, str] | None, key: str | None) -> dict[str, str]:
    """The headers of every request, with the API key.

    ``key`` is by default that of the environment variable; an empty one is none. Headers with their own authorisation
    take precedence over the environment. Raises :class:`BadArgument` for two keys, and for a character that keys do not
    have; the message does not contain the key.
    """
    if not isinstance(key, str | None):
        raise BadArgument("the key is no text: give one, as `equimesh keys create` prints it")
    merged = dict(headers or {})
    own = any(name.lower() == HEADER.lower() for name in merged)
    secret = (os.environ.get(VARIABLE, "") if key is None and not own else key or "").strip()
    if not secret:
        return merged
    if own:
        raise BadArgument("give a key, or a header Authorization, not both")
    if not all("!" <= sign <= "~" for sign in secret):
        raise BadArgument(f"the key has a space or another character that no key has; check the value of {VARIABLE}")
    return {**merged, HEADER: f"Bearer {secret}"}
