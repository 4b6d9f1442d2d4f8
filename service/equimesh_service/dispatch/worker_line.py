"""The order in which requests get workers: the turns of keys, the line for a worker, and side workers."""

from __future__ import annotations

import asyncio
import threading
from collections import Counter, OrderedDict, deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import CancelledError, Future
from dataclasses import dataclass
from functools import partial
from typing import Any, Generic, TypeVar

from equimesh_service.engine.port import Engine, Health
from equimesh_service.store.rows import KeysInQueue

Item = TypeVar("Item")


@dataclass(frozen=True, kw_only=True)
class Contender:
    """A key with waiting tasks, its share, and the number of its running tasks."""

    key_id: str
    share: int = 1
    running: int = 0


class Turns:
    """The turns of the keys of one service. Tags are numbers without a unit; callers hold a lock.

    A key that has not started anything for a while is first among its equals, and gains nothing more by its wait.
    """

    def __init__(self) -> None:
        self._latest = 0.0  # the largest start tag up to now
        self._next: dict[str, float] = {}  # the next start tag of each key whose tag is later than the latest

    def first(self, contenders: Iterable[Contender]) -> Contender:
        """The contender whose turn it is; the first of equal ones."""
        return min(contenders, key=self._place)

    def start(self, key_id: str, share: int = 1) -> None:
        """Note that a task of a key starts."""
        self._latest = max(self._latest, self._next.get(key_id, 0.0))
        self._next[key_id] = self._latest + 1.0 / share
        # Earlier tags would count as the latest one.
        self._next = {key: tag for key, tag in self._next.items() if tag > self._latest}

    def _place(self, contender: Contender) -> tuple[float, float]:
        return contender.running / contender.share, self._next.get(contender.key_id, 0.0)


class KeyedLine(Generic[Item]):
    """Waiting items, each of a key. Items of one key are taken in the order in which they came."""

    def __init__(self) -> None:
        self._items: OrderedDict[str, deque[Item]] = OrderedDict()  # by key; the key that was served last comes last
        self._shares: dict[str, int] = {}
        self._length = 0

    def __len__(self) -> int:
        return self._length

    def add(self, key_id: str, item: Item, share: int = 1) -> None:
        """Add an item at the end of its key's line."""
        self._items.setdefault(key_id, deque()).append(item)
        self._shares[key_id] = share
        self._length += 1

    def remove(self, item: Item) -> bool:
        """Remove an item; False when it does not wait."""
        for key_id, items in self._items.items():
            if item in items:
                items.remove(item)
                self._shrink(key_id)
                return True
        return False

    def pop(self, key_id: str) -> Item:
        """Remove and return the first item of a key."""
        item = self._items[key_id].popleft()
        self._items.move_to_end(key_id)
        self._shrink(key_id)
        return item

    def pop_all(self) -> list[Item]:
        """Remove and return all items."""
        return [self.pop(key_id) for key_id, items in list(self._items.items()) for _ in range(len(items))]

    def contenders(self, running: Mapping[str, int]) -> list[Contender]:
        """The keys with waiting items, given the number of running tasks of each key."""
        return [
            Contender(key_id=key_id, share=self._shares[key_id], running=running.get(key_id, 0))
            for key_id in self._items
        ]

    def _shrink(self, key_id: str) -> None:
        self._length -= 1
        if not self._items[key_id]:
            del self._items[key_id], self._shares[key_id]


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
        """Reserve a worker for the first in the line and the queue; False when none is free."""
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
            self._tell_queue()

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
            self._tell_queue()

    def _tell_queue(self) -> None:
        """Let the dispatcher look for a mesh in the queue, unless that is empty: each of its looks takes a switch."""
        if not self.queue_is_empty:
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
                self._tell_queue()
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
