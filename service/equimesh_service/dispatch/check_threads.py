"""Threads that check what clients send: few, so that they leave the processors to others."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

from anyio import CapacityLimiter, from_thread, to_thread

from equimesh_service.problems.problem import Problem

Checked = TypeVar("Checked")
_THREADS = 4
# Beside them, threads that only wait for a worker to look at samples: for one key, and in all.
_MOST_OF_KEY, _MOST_ASIDE = 32, 128


class Checkers:
    """A few threads for checks; made in a running event loop."""

    def __init__(self, threads: int = _THREADS) -> None:
        self._limiter = CapacityLimiter(threads)
        self._aside: Counter[str] = Counter()  # by key

    async def run(self, function: Callable[..., Checked], *arguments: Any) -> Checked:
        """What ``function`` returns in one of the threads."""
        return await to_thread.run_sync(function, *arguments, limiter=self._limiter)

    @contextmanager
    def aside(self, key_id: str) -> Iterator[None]:
        """Let another check take the place of this one, which waits for a worker; to be used inside a check.

        Else a few slow ones, each waiting for its turn, would keep all the quick ones of others waiting, too. Raises a
        429 problem when the key has as many of them as it may have, and a 503 problem when all keys together have.
        """
        from_thread.run_sync(self._step_aside, key_id)
        try:
            yield
        finally:
            from_thread.run_sync(self._step_back, key_id)

    def _step_aside(self, key_id: str) -> None:
        if self._aside[key_id] >= _MOST_OF_KEY:
            who = "This key has" if key_id else "Callers without a key have"
            detail = f"{who} {_MOST_OF_KEY} requests whose samples wait to be read: send more when these are answered."
            raise Problem("quota-exceeded", detail, headers={"Retry-After": "5"})
        if self._aside.total() >= _MOST_ASIDE:
            detail = f"The samples of {_MOST_ASIDE} requests wait to be read, which is as many as may."
            raise Problem("unavailable", detail, headers={"Retry-After": "5"})
        self._aside[key_id] += 1
        self._limiter.total_tokens += 1

    def _step_back(self, key_id: str) -> None:
        self._aside[key_id] -= 1
        if not self._aside[key_id]:
            del self._aside[key_id]
        self._limiter.total_tokens -= 1
