"""Waiting inside one process: for a change of a mesh, and for one of the few threads that check input."""

from __future__ import annotations

import asyncio
import sys
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import Context
from dataclasses import dataclass, field
from typing import Any, TypeVar

from anyio import CapacityLimiter, from_thread, to_thread
from starlette.concurrency import run_in_threadpool

from equimesh_service.problems.problem import Problem

# The number of no event: a waiter who has seen it waits for the end of the mesh.
END = sys.maxsize


@dataclass(frozen=True, eq=False)
class _Waiter:
    seen: int | None
    call: asyncio.Event = field(default_factory=asyncio.Event)


class Wakeups:
    """Lets coroutines of one event loop wait for news of a mesh; any thread may announce news.

    An announcement only hints that the store has changed. Workers and other services announce nothing, so a task polls
    the store for all waiters, every ``poll`` seconds while there are any. ``look`` returns the number of the last event
    of each given mesh that is not finished or gone.
    """

    def __init__(self, look: Callable[[Sequence[str]], Mapping[str, int]], poll: float) -> None:
        self._loop = asyncio.get_running_loop()
        self._look, self._poll = look, poll
        self._waiting: dict[str, set[_Waiter]] = defaultdict(set)
        self._watching: asyncio.Task[None] | None = None
        self.closing = False

    def announce(self, mesh_id: str) -> None:
        """Wake all waiters for this mesh; from any thread."""
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._wake, mesh_id)

    async def wait(self, mesh_id: str, timeout: float, *, seen: int | None = None) -> bool:
        """Return True at the next announcement, False after ``timeout`` seconds.

        With ``seen``, also return True soon after the mesh has an event of a larger number, or is finished or gone.
        """
        if self.closing:
            return True
        waiter = _Waiter(seen)
        self._waiting[mesh_id].add(waiter)
        if seen is not None and self._watching is None:
            # Not in the context of this request: the task serves all others, too, and outlives it.
            self._watching = self._loop.create_task(self._watch(), context=Context())
        try:
            async with asyncio.timeout(timeout):
                return await waiter.call.wait()
        except TimeoutError:
            return False
        finally:
            self._waiting[mesh_id].discard(waiter)
            if not self._waiting[mesh_id]:
                del self._waiting[mesh_id]

    def close(self) -> None:
        """Wake all waiters, now and in future: the service stops."""
        self.closing = True
        if self._watching is not None:
            self._watching.cancel()
        for mesh_id in list(self._waiting):
            self._wake(mesh_id)

    async def _watch(self) -> None:
        while self._watched():
            await asyncio.sleep(self._poll)
            watched = self._watched()
            try:
                last = await run_in_threadpool(self._look, watched)
            except Exception:  # each waiter gets the error when it reads the store itself
                last = {}
            for mesh_id in watched:
                self._wake(mesh_id, last.get(mesh_id))
        self._watching = None

    def _watched(self) -> list[str]:
        return [mesh_id for mesh_id, here in self._waiting.items() if any(one.seen is not None for one in here)]

    def _wake(self, mesh_id: str, last: int | None = None) -> None:
        """Wake the waiters for a mesh: all, or those that have not seen its event number ``last``."""
        for waiter in self._waiting.get(mesh_id, ()):
            if last is None or (waiter.seen is not None and waiter.seen < last):
                waiter.call.set()


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
