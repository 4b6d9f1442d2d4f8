"""Threads that check what clients send: few, so that they leave the processors to others."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

from anyio import CapacityLimiter, from_thread, to_thread

Checked = TypeVar("Checked")
_THREADS = 4
# Beside them, threads that only wait for a worker to look at samples.
_MOST_ASIDE = 64


class Checkers:
    """A few threads for checks; made in a running event loop."""

    def __init__(self, threads: int = _THREADS) -> None:
        self._limiter = CapacityLimiter(threads)
        self._aside = 0

    async def run(self, function: Callable[..., Checked], *arguments: Any) -> Checked:
        """What ``function`` returns in one of the threads."""
        return await to_thread.run_sync(function, *arguments, limiter=self._limiter)

    @contextmanager
    def aside(self) -> Iterator[None]:
        """Let another check take the place of this one, which waits for a worker; to be used inside a check.

        Else a few slow ones, each waiting for its turn, would keep all the quick ones of others waiting, too.
        """
        made = from_thread.run_sync(self._step_aside)
        try:
            yield
        finally:
            if made:
                from_thread.run_sync(self._step_back)

    def _step_aside(self) -> bool:
        if self._aside >= _MOST_ASIDE:
            return False
        self._aside += 1
        self._limiter.total_tokens += 1
        return True

    def _step_back(self) -> None:
        self._aside -= 1
        self._limiter.total_tokens -= 1
