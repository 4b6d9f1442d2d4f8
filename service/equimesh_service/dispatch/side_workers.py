"""Side workers: they write files, draw pictures and read samples, for all keys in turn."""

import threading
from collections import Counter
from collections.abc import Callable
from concurrent.futures import CancelledError, Future
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

from equimesh_service.dispatch.turns import Contender, KeyedLine, Turns
from equimesh_service.engine.port import Engine, Health

Result = TypeVar("Result")


@dataclass(frozen=True)
class _Task:
    key_id: str
    begin: Callable[[], Future[Any]]
    result: Future[Any]


class SideWorkers:
    """Gives an engine as many tasks as it has workers, from the keys in turn.

    However many tasks one key has waiting, the first task of another key begins as soon as a running one ends. While
    others wait, a key has no second worker. One worker is always free for other keys: however long the tasks of one key
    take, those of another begin. Callers without a key may have all workers. Every method returns at once and may be
    called from any thread.
    """

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._lock = threading.Lock()  # guards the next four
        self._turns = Turns()
        self._waiting = KeyedLine[_Task]()
        self._running = Counter[str]()  # the number of running tasks by key
        self._free = engine.health().workers
        self._most_of_key = max(1, self._free - 1)

    def submit(
        self, key_id: str, function: Callable[..., Result], *arguments: Any, time_limit: float | None = None
    ) -> Future[Result]:
        """Run ``function(*arguments)`` when it is the key's turn; see :class:`~equimesh_service.engine.port.Engine`."""
        result: Future[Result] = Future()
        result.set_running_or_notify_cancel()
        begin = partial(self._engine.submit, function, *arguments, time_limit=time_limit)
        with self._lock:
            self._waiting.add(key_id, _Task(key_id, begin, result))
        self._fill()
        return result

    def health(self) -> Health:
        """Whether tasks can run now."""
        return self._engine.health()

    def close(self) -> None:
        """Stop all workers; running and waiting tasks are given up."""
        self._engine.close()

    def _fill(self) -> None:
        while (task := self._next()) is not None:
            try:
                running = task.begin()
            except Exception as error:  # whatever the error, the worker stays free
                running = Future()
                running.set_exception(error)
            if running.done():  # without workers; a callback would start each task inside the one before
                self._end(task, running)
            else:
                running.add_done_callback(partial(self._end_and_fill, task))

    def _next(self) -> _Task | None:
        with self._lock:
            waiting = [key for key in self._waiting.contenders(self._running) if self._may_have_more(key)]
            if not self._free or not waiting:
                return None
            key_id = self._turns.first(waiting).key_id
            self._turns.start(key_id)
            self._running[key_id] += 1
            self._free -= 1
            return self._waiting.pop(key_id)

    def _may_have_more(self, key: Contender) -> bool:
        return not key.key_id or key.running < self._most_of_key

    def _end_and_fill(self, task: _Task, ended: Future[Any]) -> None:
        self._end(task, ended)
        self._fill()

    def _end(self, task: _Task, ended: Future[Any]) -> None:
        with self._lock:
            self._free += 1
            self._running[task.key_id] -= 1
            self._running += Counter()  # without the keys that have no task left
        error = CancelledError() if ended.cancelled() else ended.exception()
        if error is None:
            task.result.set_result(ended.result())
        else:
            task.result.set_exception(error)
