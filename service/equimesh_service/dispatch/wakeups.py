"""Wake-up calls inside one process: requests wait here for a change of their mesh."""

import asyncio
import sys
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from contextvars import Context
from dataclasses import dataclass, field

from starlette.concurrency import run_in_threadpool

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
