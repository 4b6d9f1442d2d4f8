"""The line for a worker: the reserved workers, and the requests that wait for one."""

import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future

from equimesh_service.engine.port import Engine

# The most requests that wait for a worker; further meshes enter the queue.
_MAX_LINE_LENGTH = 64


class WorkerLine:
    """Reserves free workers of an engine, in turn for requests in the line and for the queue.

    ``count_running`` returns the number of workers that have a mesh; ``wake`` is called when a reserved worker is
    released. ``lock`` guards the line and the dispatcher's running tasks.
    """

    def __init__(self, engine: Engine, count_running: Callable[[], int], wake: Callable[[], None]) -> None:
        self._engine, self._count_running, self._wake = engine, count_running, wake
        self.lock = threading.RLock()  # reentrant: a task may end while it is submitted
        self.queue_is_empty = False  # as far as this service knows
        self._reserved = 0
        self._turns: deque[Future[bool]] = deque()
        self._is_turn_of_line = False  # used only while meshes wait in the queue, too
        self._closed = False

    def reserve(self) -> bool:
        """Reserve a worker for a mesh that is not in the store yet; False when none is free or others wait."""
        with self.lock:
            return self.queue_is_empty and not self._turns and not self._closed and self._take_free_worker()

    def reserve_for_queue(self) -> bool:
        """Reserve a worker for a mesh that may be in the queue; False when none is free."""
        with self.lock:
            self.call_next()
            return self._take_free_worker()

    def use(self) -> None:
        """Note that a reserved worker has its mesh; called under the lock."""
        self._reserved -= 1

    def end_turn_of_queue(self, *, is_empty: bool) -> None:
        """End the turn of the queue, which was empty or not; called under the lock."""
        self._reserved -= 1
        self.queue_is_empty = is_empty
        self._is_turn_of_line = True

    def release(self) -> None:
        """Release a reserved worker."""
        with self.lock:
            self._reserved -= 1
            self.call_next()
        self._wake()

    def join(self) -> Future[bool]:
        """Wait for a worker: True when one is reserved, False when the line is too long, or the service stops."""
        turn: Future[bool] = Future()
        with self.lock:
            if len(self._turns) < _MAX_LINE_LENGTH and not self._closed:
                self._turns.append(turn)
                self.call_next()
                return turn
        turn.set_result(False)
        return turn

    def leave(self, turn: Future[bool]) -> None:
        """Leave the line; a worker that was reserved meanwhile is released."""
        with self.lock:
            if turn in self._turns:
                self._turns.remove(turn)
                return
        if turn.result():
            self.release()

    def call_next(self) -> None:
        """Reserve free workers for the first in the line; called under the lock."""
        while self._turns and (self.queue_is_empty or self._is_turn_of_line) and self._take_free_worker():
            self._is_turn_of_line = False
            self._turns.popleft().set_result(True)

    def close(self) -> None:
        """Reserve no more workers; all waiting requests get False."""
        with self.lock:
            self._closed = True
            while self._turns:
                self._turns.popleft().set_result(False)

    def _take_free_worker(self) -> bool:
        health = self._engine.health()
        free = health.ready and self._count_running() + self._reserved < health.workers
        self._reserved += free
        return free
