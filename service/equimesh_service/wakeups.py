"""Wake-up calls inside one process: requests wait here until something happens to their mesh."""

from __future__ import annotations

import asyncio
from collections import defaultdict


class Wakeups:
    """Lets coroutines of one event loop wait for news of a mesh; any thread may announce news.

    News are a hint to look at the store, never the news themselves: what a worker writes on its own comes
    without one, so every wait has a timeout.
    """

    def __init__(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._waiting: dict[str, set[asyncio.Event]] = defaultdict(set)
        self.closing = False

    def announce(self, mesh_id: str) -> None:
        """Wake all that wait for this mesh; from any thread."""
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._wake, mesh_id)

    async def wait(self, mesh_id: str, timeout: float) -> None:
        """Return at the next announcement, or after ``timeout`` seconds."""
        event = asyncio.Event()
        self._waiting[mesh_id].add(event)
        try:
            if not self.closing:
                async with asyncio.timeout(timeout):
                    await event.wait()
        except TimeoutError:
            pass
        finally:
            self._waiting[mesh_id].discard(event)
            if not self._waiting[mesh_id]:
                del self._waiting[mesh_id]

    def close(self) -> None:
        """Wake everyone for good: the service ends."""
        self.closing = True
        for mesh_id in list(self._waiting):
            self._wake(mesh_id)

    def _wake(self, mesh_id: str) -> None:
        for event in self._waiting.get(mesh_id, ()):
            event.set()
