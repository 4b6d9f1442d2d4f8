"""Decisions on retries: whether and when a request is sent again; no I/O."""

import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime

from equimesh_client.errors import BadArgument

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
        if self.retries < 0 or self.first < 0 or self.longest < 0 or self.patience < 0:
            raise BadArgument("numbers of a retry policy must not be negative")

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
