"""Signs that a pool of Pebble's will not finish its tasks, although it says that it is active.

Workers take tasks out of one pipe, one at a time: by a lock, which the system does not take from a process that dies
with it. After that no worker gets a task, and none can be stopped. And a worker that dies at the moment it has begun
a task may be forgotten before the pool hears that it had begun; so may one that cannot read the task.

And when the server dies that workers are forked from, the pool takes them for dead while they still live for a moment,
and take its tasks.
"""

import signal
import time
from multiprocessing.process import BaseProcess
from typing import Any

from pebble import ProcessPool

# Seconds. Workers hold the lock for less than a millisecond; for more when they have to import a module for a task.
MAX_SILENT_SECONDS = 10.0
# The exit code of a process whose server died before it could tell: see :mod:`multiprocessing.popen_forkserver`.
SERVER_DIED_EXIT_CODE = 255


class PoolWatch:
    """What one pool looked like so far."""

    def __init__(self, pool: ProcessPool) -> None:
        self.pool = pool
        manager: Any = pool._pool_manager  # Pebble has no public access to it
        self._tasks, self._workers = manager.task_manager, manager.worker_manager
        self._free = time.monotonic()  # when last the lock was
        self._alive: dict[int, BaseProcess] = {}
        self._died = 0.0  # when last a worker had
        self._forgotten: dict[int, float] = {}  # tasks without a worker, and since when
        self._known: dict[int, Any] = {}
        self._last = 0  # task that was begun: the workers begin them in the order in which they came

    def defect(self) -> str:
        """Why the pool must be replaced; empty when it need not. Call it several times a second."""
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
        # Those that the pool stops itself do not count: it takes the lock first.
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
