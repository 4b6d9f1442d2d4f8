"""Communication of the parts of a run: messages between workers, channels, tasks, and reports to the driver."""

from __future__ import annotations

import asyncio
import pickle
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

import numpy as np
from distributed import Client, WorkerPlugin, get_worker
from distributed.protocol.serialize import to_serialize

from equimesh.numerics.types import Array
from equimesh_cluster.messages import PeerError, PeerFailedError, PeerLostError

if TYPE_CHECKING:
    from distributed import Worker


# The messages of parts: a plugin of a worker that takes them on the worker's own port.
#
# A box holds what has come for one part. It is there while the task of that part runs, and no longer. A message for a
# part that has not begun is sent again by its sender a little later, so nothing is kept for parts that never begin.

PLUGIN = "equimesh-messages"
"""The name of the plugin on a worker."""
MESSAGES = "equimesh_messages"
"""The name of the request that brings messages."""
END = "equimesh_end"
"""The name of the request that ends a run."""
GONE = {"cancelled", "released", "forgotten", "error"}
"""States of a task whose result nobody waits for any more."""

Message = tuple[str, list[Array]]


class Box:
    """The messages for one part, and whether its run has ended."""

    def __init__(self, key: str) -> None:
        self.key = key
        self.changed = threading.Condition()
        self.ended: PeerError | None = None
        self._arrived: dict[tuple[int, str], deque[list[Array]]] = {}

    def put(self, sender: int, messages: Sequence[Message]) -> None:
        """Keep messages of one sender, in their order."""
        with self.changed:
            for tag, arrays in messages:
                self._arrived.setdefault((sender, tag), deque()).append(list(arrays))
            self.changed.notify_all()

    def take(self, sender: int, tag: str) -> list[Array]:
        """The next arrays of a sender under a tag, once they have come.

        Raises :class:`~equimesh_cluster.messages.PeerError` where the run has ended.
        """
        with self.changed:
            self.changed.wait_for(lambda: self.ended is not None or (sender, tag) in self._arrived)
            self.require_running()
            waiting = self._arrived[sender, tag]
            arrays = waiting.popleft()
            if not waiting:
                del self._arrived[sender, tag]
            return arrays

    def end(self, reason: PeerError) -> None:
        """Let everyone who waits know that the run has ended. The first reason is kept."""
        with self.changed:
            self.ended = self.ended or reason
            self.changed.notify_all()

    def require_running(self) -> None:
        """Raise the :class:`~equimesh_cluster.messages.PeerError` with which the run has ended, if it has."""
        if self.ended is not None:
            raise type(self.ended)(*self.ended.args)


class Messages(WorkerPlugin):
    """The boxes of all parts that run on one worker, by run and number of the part."""

    name = PLUGIN

    def __init__(self) -> None:
        self.boxes: dict[tuple[str, int], Box] = {}
        self._lock = threading.Lock()
        self._worker: Worker | None = None

    def setup(self, worker: Worker) -> None:
        """Take requests of other workers from now on."""
        self._worker = worker
        worker.handlers[MESSAGES] = self.deliver
        worker.handlers[END] = self.end

    def teardown(self, worker: Worker) -> None:
        """Take no more requests, and end all runs."""
        worker.handlers.pop(MESSAGES, None)
        worker.handlers.pop(END, None)
        for box in self._all():
            box.end(PeerLostError("the worker is closing"))

    def open(self, run: str, number: int, key: str) -> Box:
        """A box for a part whose task begins."""
        box = Box(key)
        with self._lock:
            self.boxes[run, number] = box
        state = None if self._worker is None else self._worker.state.tasks.get(key)
        if state is None or state.state in GONE:
            box.end(PeerLostError("the run was given up before this part began"))
        return box

    def close(self, run: str, number: int) -> None:
        """Remove the box of a part whose task is done."""
        with self._lock:
            self.boxes.pop((run, number), None)

    def deliver(self, run: str, to: int, sender: int, messages: Sequence[Message]) -> bool:
        """Put messages into the box of a part. Returns whether there is one."""
        with self._lock:
            box = self.boxes.get((run, to))
        if box is None:
            return False
        box.put(sender, messages)
        return True

    def end(self, run: str, reason: str, failed: bool) -> int:
        """End a run for its parts on this worker, since a part ``failed`` or is lost. Returns how many these are."""
        error = PeerFailedError(reason) if failed else PeerLostError(reason)
        ended = [box for (name, _), box in self._items() if name == run]
        for box in ended:
            box.end(error)
        return len(ended)

    def transition(self, key: Any, start: str, finish: str, **_: Any) -> None:
        """End the run of a part whose result nobody waits for any more: its client is gone, or has given it up."""
        if start == "executing" and finish in GONE:
            for box in self._all():
                if box.key == key:
                    box.end(PeerLostError("the client of the run has gone, or has given it up"))

    def _items(self) -> list[tuple[tuple[str, int], Box]]:
        with self._lock:
            return list(self.boxes.items())

    def _all(self) -> list[Box]:
        return [box for _, box in self._items()]


async def install(worker: Worker) -> None:
    """Let a worker take messages of parts. It stays so; a second call changes nothing."""
    if PLUGIN not in worker.plugins:
        await worker.plugin_add(plugin=Messages(), name=PLUGIN, catch_errors=False)


def plugin_of(worker: Worker) -> Messages:
    """The plugin of a worker. Raises :class:`~equimesh_cluster.messages.PeerLostError` where there is none."""
    plugin = worker.plugins.get(PLUGIN)
    if not isinstance(plugin, Messages):
        raise PeerLostError(f"the worker {worker.address} was started again during the run")
    return plugin


def packed(messages: Sequence[Message]) -> list[list[Any]]:
    """Messages for the wire: arrays travel as frames, without being pickled."""
    return [[tag, [to_serialize(array) for array in arrays]] for tag, arrays in messages]


TOPIC = "equimesh"
"""The topic of Dask's events under which parts report."""
# Seconds until a message is sent again to a part that has not begun: first, and at most.
FIRST_RETRY_SECONDS = 0.005
MAX_RETRY_SECONDS = 0.5
# Seconds within which all parts begin: a worker may first have to end another task.
MAX_START_SECONDS = 600.0


@dataclass(frozen=True, kw_only=True)
class Seat:
    """A part of a run, and the workers of all its parts. ``identity`` names the process of this part."""

    run: str
    number: int
    addresses: tuple[str, ...]
    identity: str
    key: str

    @property
    def count(self) -> int:
        """The number of parts."""
        return len(self.addresses)


class WorkerChannel:
    """A :class:`~equimesh_cluster.messages.Channel` between tasks on workers.

    Messages go from worker to worker. The event loop of the worker sends them, one request at a time to each of the
    other workers' parts, so they arrive in their order.
    """

    def __init__(self, seat: Seat, worker: Worker, plugin: Messages, box: Box) -> None:
        self.number, self.count = seat.number, seat.count
        self._seat, self._worker, self._plugin, self._box = seat, worker, plugin, box
        self._waiting: dict[int, deque[Message]] = {to: deque() for to in range(seat.count)}
        self._sending: set[int] = set()
        self._unsent = 0

    def send(self, to: int, tag: str, arrays: Sequence[Array]) -> None:
        """Send copies of the arrays to part ``to``; return at once."""
        self._box.require_running()
        if not 0 <= to < self.count:
            raise ValueError(f"part {to} does not exist: there are {self.count}")
        message = tag, [np.array(array, order="C") for array in arrays]
        with self._box.changed:
            self._unsent += 1
        self._worker.loop.add_callback(self._enqueue, to, message)

    def receive(self, sender: int, tag: str) -> Sequence[Array]:
        """The next arrays that part ``sender`` sent under ``tag``, once they have come.

        Raises :class:`~equimesh_cluster.messages.PeerFailedError` where a part failed, and
        :class:`~equimesh_cluster.messages.PeerLostError` where a worker was lost or the client has gone.
        """
        return self._box.take(sender, tag)

    def report(self, value: object) -> None:
        """Hand a small value, such as a record of a step, to the observer of the run."""
        self._box.require_running()
        event = {"run": self._seat.run, "number": self.number, "value": pickle.dumps(value)}
        self._worker.log_event(TOPIC, event)

    def require_running(self) -> None:
        """Raise :class:`~equimesh_cluster.messages.PeerError` where the run has ended; for work without messages."""
        self._box.require_running()

    def flush(self) -> None:
        """Wait until all messages have arrived."""
        with self._box.changed:
            self._box.changed.wait_for(lambda: self._box.ended is not None or self._unsent == 0)
        self._box.require_running()

    def _enqueue(self, to: int, message: Message) -> None:
        """Append a message, on the event loop."""
        self._waiting[to].append(message)
        if to not in self._sending:
            self._sending.add(to)
            self._worker.loop.add_callback(self._drain, to)

    async def _drain(self, to: int) -> None:
        """Send all messages that wait for a part, those that come meanwhile too."""
        waiting = self._waiting[to]
        try:
            while waiting and self._box.ended is None:
                batch = list(waiting)
                await self._deliver(to, batch)
                for _ in batch:
                    waiting.popleft()
                with self._box.changed:
                    self._unsent -= len(batch)
                    self._box.changed.notify_all()
        except Exception as error:  # whatever it is, the part must not wait for ever
            address = self._seat.addresses[to]
            reason = f"part {to} on {address} cannot be reached ({type(error).__name__}: {error})"
            self._box.end(PeerLostError(reason))
        finally:
            self._sending.discard(to)

    async def _deliver(self, to: int, batch: Sequence[Message]) -> None:
        """Send messages until the part has begun and has them, or the run has ended."""
        pause, latest = FIRST_RETRY_SECONDS, time.monotonic() + MAX_START_SECONDS
        while self._box.ended is None and not await self._request(to, batch):
            if time.monotonic() > latest:
                address = self._seat.addresses[to]
                raise PeerLostError(f"it did not begin within {MAX_START_SECONDS:.0f} s: {address} is busy")
            await asyncio.sleep(pause)
            pause = min(2.0 * pause, MAX_RETRY_SECONDS)

    async def _request(self, to: int, batch: Sequence[Message]) -> bool:
        """Whether a part has taken the messages."""
        run, address = self._seat.run, self._seat.addresses[to]
        if address == self._worker.address:
            return self._plugin.deliver(run, to, self.number, batch)
        other: Any = self._worker.rpc(address)
        request = getattr(other, MESSAGES)
        return bool(await request(run=run, to=to, sender=self.number, messages=packed(batch)))


# The task of one part: it runs on a worker, from the opening of its channel to its result.


def run_part(seat: Seat, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
    """The result of ``function(channel, *arguments)`` for one part.

    Raises :class:`~equimesh_cluster.messages.PeerLostError` where the run has ended, or where the worker has
    ended since: Dask then runs the task on another one.
    """
    worker = get_worker()
    if worker.id != seat.identity:
        raise PeerLostError(f"the worker at {seat.addresses[seat.number]} ended, and with it part {seat.number}")
    plugin = plugin_of(worker)
    box = plugin.open(seat.run, seat.number, seat.key)
    try:
        channel = WorkerChannel(seat, worker, plugin, box)
        result = function(channel, *arguments)
        channel.flush()
        return result
    finally:
        plugin.close(seat.run, seat.number)


# Reports of parts to the driver while they run: events of Dask under one topic.

Listener = Callable[[int, Any], None]

_LISTENERS: WeakKeyDictionary[Client, dict[str, Listener]] = WeakKeyDictionary()
"""The listeners of the runs. A client has one handler of a topic, and may have several runs."""
_LOCK = threading.Lock()


@contextmanager
def listening(client: Client, run: str, listener: Listener) -> Iterator[None]:
    """Call ``listener(number, value)`` for every report of a part of ``run``, on the thread of the client's loop."""
    listeners = _listeners_of(client)
    listeners[run] = listener
    try:
        yield
    finally:
        del listeners[run]


def _listeners_of(client: Client) -> dict[str, Listener]:
    """The listeners of a client, by run. It subscribes once, for as long as it is there."""
    with _LOCK:
        if client not in _LISTENERS:
            listeners: dict[str, Listener] = {}
            _LISTENERS[client] = listeners
            client.subscribe_topic(TOPIC, lambda event: _hand_over(listeners, event))
        return _LISTENERS[client]


def _hand_over(listeners: dict[str, Listener], event: tuple[float, Any]) -> None:
    """Hand the report of a part to the listener of its run, if that is one of this client's."""
    report = event[1]
    listener = listeners.get(report["run"])
    if listener is not None:
        listener(report["number"], pickle.loads(report["value"]))
