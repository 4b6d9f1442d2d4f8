"""The few threads that check the input of clients."""

from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

from anyio import CapacityLimiter, from_thread, to_thread

from equimesh_service.problems.problem import Problem

Checked = TypeVar("Checked")
# Few, so that checks leave the processors to other work.
_THREAD_COUNT = 4
# The most additional threads of one key that only wait for a worker to read samples.
_MAX_WAITING_OF_KEY = 32
# The most of them for all keys together.
_MAX_WAITING = 128


class CheckThreads:
    """The threads; created in a running event loop."""

    def __init__(self, threads: int = _THREAD_COUNT) -> None:
        self._limiter = CapacityLimiter(threads)
        self._waiting: Counter[str] = Counter()  # by key

    async def run(self, function: Callable[..., Checked], *arguments: Any) -> Checked:
        """The result of ``function``, called in one of the threads."""
        return await to_thread.run_sync(function, *arguments, limiter=self._limiter)

    @contextmanager
    def while_waiting(self, key_id: str) -> Iterator[None]:
        """Let another check start while this one waits for a worker; entered inside a check.

        Otherwise a few slow checks would block the quick checks of others. Raises a 429 problem at the limit of the
        key, and a 503 problem at the limit of all keys together.
        """
        from_thread.run_sync(self._begin_wait, key_id)
        try:
            yield
        finally:
            from_thread.run_sync(self._end_wait, key_id)

    def _begin_wait(self, key_id: str) -> None:
        if self._waiting[key_id] >= _MAX_WAITING_OF_KEY:
            who = "This key has" if key_id else "Callers without a key have"
            detail = (
                f"{who} {_MAX_WAITING_OF_KEY} uploads waiting to be read, the limit: send more when these are answered."
            )
            raise Problem("quota-exceeded", detail, headers={"Retry-After": "5"})
        if self._waiting.total() >= _MAX_WAITING:
            detail = f"{_MAX_WAITING} uploads are waiting to be read, the limit."
            raise Problem("unavailable", detail, headers={"Retry-After": "5"})
        self._waiting[key_id] += 1
        self._limiter.total_tokens += 1

    def _end_wait(self, key_id: str) -> None:
        self._waiting[key_id] -= 1
        if not self._waiting[key_id]:
            del self._waiting[key_id]
        self._limiter.total_tokens -= 1
