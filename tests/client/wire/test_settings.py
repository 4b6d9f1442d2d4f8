"""Deadlines as values."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from typing import Any

import pytest

from equimesh_client import BadArgument, ProblemError, RetryPolicy
from equimesh_client.wire.settings import Deadline, Settings, headers_with_key, pause_before_retry, retry_after_of


def test_time_runs_down_to_zero() -> None:
    now = [10.0]
    deadline = Deadline.after(3.0, clock=lambda: now[0])
    assert deadline.left == 3.0
    now[0] = 12.5
    assert deadline.left == 0.5
    now[0] = 14.0
    assert deadline.left == 0.0
    assert str(deadline.exceeded("waiting")) == "waiting: the deadline of 3 s has passed"


@pytest.mark.parametrize("seconds", [0.0, -1.0, math.nan])
def test_a_deadline_is_a_positive_number(seconds: float) -> None:
    with pytest.raises(BadArgument, match="positive number of seconds"):
        Deadline.after(seconds)


def test_a_plain_request_has_time_for_all_attempts() -> None:
    settings = Settings(url="http://h", timeout=2.0, policy=RetryPolicy(retries=4))
    assert settings.deadline().seconds == settings.attempts == 10.0
    assert settings.deadline(1.5).seconds == 1.5


# The API key: where it comes from and where it goes.


def spec(**more: Any) -> dict[str, Any]:
    return {"monitor": {"u": {"expression": "x"}}, "grid": {"n_xi": 5, "n_eta": 4}, **more}


def test_the_key_goes_with_every_request_and_nowhere_else(
    connect: Any, service: Any, fault: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("EQUIMESH_KEY", " em_1_environment\n")
    connect(service.url).generate("x", 5)
    assert {request.headers["authorization"] for request in service.requests} == {"Bearer em_1_environment"}
    requested = [
        ({"key": "em_2_given"}, "Bearer em_2_given"),
        ({"key": ""}, None),
        ({"headers": {"authorization": "Basic me"}}, "Basic me"),
    ]
    for options, header in requested:
        connect(service.url, **options).capabilities()
        assert service.requests[-1].headers.get("authorization") == header
    for options in ({"key": "em_2", "headers": {"AUTHORIZATION": "x"}}, {"key": "em 2"}, {"key": "em_\u00e4"}):
        with pytest.raises(BadArgument) as caught:
            connect(service.url, **options)
        assert "em_" not in str(caught.value)
        assert "em 2" not in str(caught.value)
    # a redirect is not followed: the key is for this address
    other = f"{service.url}/v1/elsewhere"
    service.faults = [fault("capabilities", "status", status=307, headers={"Location": other})]
    with pytest.raises(ProblemError, match=other):
        connect(service.url).capabilities()
    assert service.seen("GET", "elsewhere") == []


def test_the_environment_gives_the_key_unless_there_is_another(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("EQUIMESH_KEY", " em_1_a ")
    assert headers_with_key(None, None) == {"Authorization": "Bearer em_1_a"}
    assert headers_with_key({"X": "1"}, "em_2_b") == {"X": "1", "Authorization": "Bearer em_2_b"}
    assert headers_with_key(None, "") == {}
    assert headers_with_key({"authorization": "Basic x"}, None) == {"authorization": "Basic x"}


def test_a_key_that_cannot_be_one_is_refused_and_not_shown() -> None:
    with pytest.raises(BadArgument, match="not both"):
        headers_with_key({"authorization": "Basic x"}, "em_1_a")
    for key in ("em 1", "em_\n1", "em_\u00e9"):
        with pytest.raises(BadArgument, match="the key has a space") as caught:
            headers_with_key(None, key)
        assert key not in str(caught.value)


# Decisions about retries, without a network.


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
