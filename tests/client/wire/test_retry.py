"""Decisions about retries, without a network."""

from __future__ import annotations

from datetime import UTC, datetime

import pytest

from equimesh_client import BadArgument, RetryPolicy
from equimesh_client.wire.settings import pause_before_retry, retry_after_of


def policy(jitter: float = 1.0, retries: int = 3) -> RetryPolicy:
    return RetryPolicy(retries=retries, first=0.25, longest=1.0, patience=60.0, jitter=lambda: jitter)


def test_the_pause_doubles_up_to_the_longest() -> None:
    pauses = [pause_before_retry(policy(retries=9), k, status=None) for k in range(5)]
    assert pauses == [0.25, 0.5, 1.0, 1.0, 1.0]


def test_jitter_takes_at_most_half() -> None:
    assert pause_before_retry(policy(jitter=0.0), 1, status=503) == 0.25


def test_a_huge_attempt_number_does_not_overflow() -> None:
    assert policy().backoff(10**6) == 1.0


@pytest.mark.parametrize("status", [None, 429, 502, 503, 504])
def test_what_is_repeated(status: int | None) -> None:
    assert pause_before_retry(policy(), 2, status=status) is not None
    assert pause_before_retry(policy(), 3, status=status) is None


@pytest.mark.parametrize("status", [400, 401, 403, 404, 409, 410, 413, 415, 422, 500, 501, 507])
def test_what_is_not_repeated(status: int) -> None:
    assert pause_before_retry(policy(), 0, status=status) is None


def test_retry_after_counts_when_it_is_longer() -> None:
    assert pause_before_retry(policy(), 0, status=429, retry_after=7.0) == 7.0
    assert pause_before_retry(policy(), 0, status=429, retry_after=0.0) == 0.25
    assert pause_before_retry(policy(), 0, status=429, retry_after=61.0) is None


@pytest.mark.parametrize(
    ("value", "seconds"),
    [
        ("3", 3.0),
        (" 120 ", 120.0),
        ("Sat, 21 Nov 2026 12:00:10 GMT", 10.0),
        ("Sat, 21 Nov 2026 11:59:00 GMT", 0.0),
        ("Sat, 21 Nov 2026 12:00:10 -0000", 10.0),
        ("soon", None),
        ("-3", None),
        ("٣", None),
        ("", None),
    ],
)
def test_retry_after_is_a_number_or_a_date(value: str, seconds: float | None) -> None:
    now = datetime(2026, 11, 21, 12, tzinfo=UTC)
    assert retry_after_of({"retry-after": value}, now=now) == seconds


def test_a_policy_has_no_negative_number() -> None:
    with pytest.raises(BadArgument):
        RetryPolicy(retries=-1)
