"""Signs that a pool of Pebble will not finish its tasks, although it reports that it is active.

Workers take tasks out of one pipe, one worker at a time, by a lock. If a worker dies with the lock, the system does not
release it: no worker gets a task any more, and none can be stopped. If a worker dies just after it began a task, or
cannot read the task, the pool may not know that the task was begun, and forgets it.

When the server that workers are forked from dies, the pool takes them for dead; for a moment they are alive and take
its tasks.
"""

import signal
import time
from multiprocessing.process import BaseProcess
from typing import Any

from pebble import ProcessPool

# Workers hold the lock for less than a millisecond; for longer when they import a module for a task.
MAX_SILENT_SECONDS = 10.0
# The exit code of a process whose server died first: see :mod:`multiprocessing.popen_forkserver`.
SERVER_DIED_EXIT_CODE = 255


class PoolWatch:
    """The observations of one pool."""

    def __init__(self, pool: ProcessPool) -> None:
        self.pool = pool
        manager: Any = pool._pool_manager  # Pebble has no public access to it
        self._tasks, self._workers = manager.task_manager, manager.worker_manager
        self._free = time.monotonic()  # when the lock was last free
        self._alive: dict[int, BaseProcess] = {}
        self._died = 0.0  # when a worker last died
        self._forgotten: dict[int, float] = {}  # the times since when tasks are without a worker
        self._known: dict[int, Any] = {}
        self._last = 0  # the last task that was begun; they are begun in order

    def defect(self) -> str:
        """Why the pool must be replaced, "" when it need not be. Call it several times a second."""
        if not self.pool.active:
            return "it broke"
        now = time.monotonic()
        with self._workers.workers_channel.lock(block=False) as free:
            if free:
                self._free = now
        before, self._alive = self._alive, self._workers.workers.copy()
        codes = {before[pid].exitcode for pid in before.keys() - self._alive.keys()}
        if SERVER_DIED_EXIT_CODE in codes:
            return "the server that its workers are forked from died"
        # Workers that the pool stops do not count, since it takes the lock first.
        if codes - {-signal.SIGTERM}:
            self._died = now
        if now - self._free > MAX_SILENT_SECONDS and self._died >= self._free:
            return "a worker died while it took a task or gave a result"
        earlier, self._known = self._known, self._tasks.tasks.copy()
        tasks, ended = self._known.values(), (earlier[name] for name in earlier.keys() - self._known.keys())
        begun = [task for task in tasks if task.started]
        self._last = max([self._last, *(task.id for task in (*begun, *ended) if not task.future.cancelled())])
        lost = [task.id for task in begun if task.worker_id not in self._alive]
        lost += [task.id for task in tasks if not task.started and task.id < self._last and not task.future.cancelled()]
        self._forgotten = {name: self._forgotten.get(name, now) for name in lost}
        if any(now - since > MAX_SILENT_SECONDS for since in self._forgotten.values()):
            return "a worker died as it began a task"
        return ""
