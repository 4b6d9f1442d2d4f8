"""The messages of parts: a plugin of a worker that takes them on the worker's own port.

A box holds what has come for one part. It is there while the task of that part runs, and no longer. A message for a
part that has not begun is sent again by its sender a little later, so nothing is kept for parts that never begin.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from distributed import WorkerPlugin
from distributed.protocol.serialize import to_serialize

from equimesh.numerics.channel import PeerError, PeerFailedError, PeerLostError
from equimesh.numerics.types import Array

if TYPE_CHECKING:
    from distributed import Worker

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

        Raises :class:`~equimesh.numerics.channel.PeerError` where the run has ended.
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
        """Raise the :class:`~equimesh.numerics.channel.PeerError` with which the run has ended, if it has."""
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
    """The plugin of a worker. Raises :class:`~equimesh.numerics.channel.PeerLostError` where there is none."""
    plugin = worker.plugins.get(PLUGIN)
    if not isinstance(plugin, Messages):
        raise PeerLostError(f"the worker {worker.address} was started again during the run")
    return plugin


def packed(messages: Sequence[Message]) -> list[list[Any]]:
    """Messages for the wire: arrays travel as frames, without being pickled."""
    return [[tag, [to_serialize(array) for array in arrays]] for tag, arrays in messages]
