"""Deadlines as values."""

from __future__ import annotations

import math

import pytest

from equimesh_client import BadArgument, RetryPolicy
from equimesh_client.wire.settings import Deadline, Settings


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
