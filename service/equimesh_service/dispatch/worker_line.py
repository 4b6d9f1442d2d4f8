"""The line for a worker: the reserved workers, and the requests that wait for one."""

import asyncio
import threading
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from typing import Any

from equimesh_service.dispatch.turns import Contender, KeyedLine, Turns
from equimesh_service.engine.port import Engine
from equimesh_service.store.rows import KeysInQueue

# The most requests that wait for a worker; further meshes enter the queue.
_MAX_LINE_LENGTH = 64


class WorkerLine:
    """Reserves free workers of an engine, for keys in turn: for their requests in the line, and for the queue.

    ``running`` returns the key of each mesh that a worker has; ``wake`` makes the dispatcher check the queue. ``lock``
    guards the line and the dispatcher's running tasks.
    """

    def __init__(self, engine: Engine, running: Callable[[], Iterable[str]], wake: Callable[[], None]) -> None:
        self._engine, self._running, self._wake = engine, running, wake
        self.lock = threading.RLock()  # reentrant: a task may end while it is submitted
        self.queue_is_empty = False  # as far as this service knows
        self._reserved = 0
        self._others: dict[Future[Any], str] = {}  # tasks that are no meshes and have a worker, with their keys
        self._turns = Turns()
        self._line = KeyedLine[Future[bool]]()
        self._is_turn_of_line = True  # for a key that waits in the line and in the queue
        self._closed = False

    def reserve(self, key_id: str = "", share: int = 1) -> bool:
        """Reserve a worker for a mesh that is not in the store yet; False when none is free or others wait."""
        with self.lock:
            free = self.queue_is_empty and not self._line and not self._closed and self._take_free_worker()
            if free:
                self._turns.start(key_id, share)
            return free

    def reserve_for_first(self) -> bool:
        """Reserve a worker for whoever is first in the line and the queue; False when none is free."""
        with self.lock:
            self.call_next()
            return self._take_free_worker()

    def choose(self, queue: KeysInQueue) -> str | None:
        """The key whose mesh in the queue gets the reserved worker; called under the lock.

        None when a request in the line got the worker, or when nobody waits and the worker is free again.
        """
        running = Counter(self._others.values())
        running.update(queue.running)
        in_line = self._line.contenders(running)
        in_queue = [
            Contender(key_id=key_id, share=share, running=running[key_id]) for key_id, share in queue.shares.items()
        ]
        if not in_line and not in_queue:
            self._reserved -= 1
            return None
        first = self._turns.first([*in_line, *in_queue])
        from_line = any(key.key_id == first.key_id for key in in_line)
        if from_line and first.key_id in queue.shares:
            from_line = self._is_turn_of_line
            self._is_turn_of_line = not from_line
        self._turns.start(first.key_id, first.share)
        if not from_line:
            return first.key_id
        self._line.pop(first.key_id).set_result(True)
        return None

    def use(self) -> None:
        """End a reservation, whose worker has its mesh or gets none; called under the lock."""
        self._reserved -= 1

    def release(self) -> None:
        """Release a reserved worker."""
        with self.lock:
            self._reserved -= 1
            self.call_next()
        self._wake()

    def occupy(self, task: Future[Any], key_id: str = "") -> None:
        """Let a task that is no mesh have the reserved worker until it ends."""
        with self.lock:
            self._reserved -= 1
            self._others[task] = key_id
        task.add_done_callback(self._free)

    def _free(self, task: Future[Any]) -> None:
        with self.lock:
            del self._others[task]
            self.call_next()
        self._wake()

    async def obtain(self, key_id: str = "", share: int = 1, seconds: float = 0.0) -> bool:
        """Reserve a worker, after a wait of at most ``seconds`` in the line; False when none becomes free in time."""
        if self.reserve(key_id, share):
            return True
        turn, reserved = self.join(key_id, share), False
        try:
            async with asyncio.timeout(seconds):
                reserved = await asyncio.shield(asyncio.wrap_future(turn))
        except TimeoutError:
            pass
        finally:
            if not reserved:
                self.leave(turn)
        return reserved

    def join(self, key_id: str = "", share: int = 1) -> Future[bool]:
        """Wait for a worker: True when one is reserved, False when the line is too long, or the service stops."""
        turn: Future[bool] = Future()
        with self.lock:
            if len(self._line) < _MAX_LINE_LENGTH and not self._closed:
                self._line.add(key_id, turn, share)
                self.call_next()
                if not self.queue_is_empty:
                    self._wake()
                return turn
        turn.set_result(False)
        return turn

    def leave(self, turn: Future[bool]) -> None:
        """Leave the line; a worker that was reserved meanwhile is released."""
        with self.lock:
            if self._line.remove(turn):
                return
        if turn.result():
            self.release()

    def call_next(self) -> None:
        """Reserve free workers for the first in the line, unless meshes wait in the queue; called under the lock."""
        while self._line and self.queue_is_empty and self._take_free_worker():
            first = self._turns.first(self._line.contenders(Counter(self._all_running())))
            self._turns.start(first.key_id, first.share)
            self._line.pop(first.key_id).set_result(True)

    def close(self) -> None:
        """Reserve no more workers; all waiting requests get False."""
        with self.lock:
            self._closed = True
            for turn in self._line.pop_all():
                turn.set_result(False)

    def _take_free_worker(self) -> bool:
        health = self._engine.health()
        free = health.ready and sum(1 for _ in self._all_running()) + self._reserved < health.workers
        self._reserved += free
        return free

    def _all_running(self) -> Iterator[str]:
        """The key of each task that a worker has."""
        yield from self._running()
        yield from self._others.values()
