"""Numbers of threads."""

from __future__ import annotations

import pytest

import equimesh as em
from cases import problem
from equimesh.numerics import threads as workers


def test_threads_are_checked() -> None:
    assert workers.thread_count(None) >= 1
    with pytest.raises(em.InputError, match="threads = 0"):
        em.solve(problem("paper", 9), threads=0)
