"""The channel of a part that runs as a task on a worker of a cluster."""

from __future__ import annotations

import asyncio
import pickle
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from equimesh.numerics.channel import PeerLostError
from equimesh.numerics.types import Array
from equimesh_cluster.messages import MESSAGES, Box, Message, Messages, packed

if TYPE_CHECKING:
    from distributed import Worker

TOPIC = "equimesh"
"""The topic of Dask's events under which parts report."""
# Seconds until a message is sent again to a part that has not begun: first, and at most.
FIRST_RETRY_SECONDS = 0.005
MAX_RETRY_SECONDS = 0.5
# Seconds within which all parts begin: a worker may first have to end another task.
MAX_START_SECONDS = 600.0


@dataclass(frozen=True, kw_only=True)
class Seat:
    """A part of a run, and the workers of all its parts. ``identity`` is that of the process of this part."""

    run: str
    number: int
    addresses: tuple[str, ...]
    identity: str
    key: str

    @property
    def count(self) -> int:
        """How many parts there are."""
        return len(self.addresses)


class WorkerChannel:
    """A :class:`~equimesh.numerics.channel.Channel` between tasks on workers.

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

        Raises :class:`~equimesh.numerics.channel.PeerFailedError` where a part failed, and
        :class:`~equimesh.numerics.channel.PeerLostError` where a worker was lost or the client has gone.
        """
        return self._box.take(sender, tag)

    def report(self, value: object) -> None:
        """Hand a small value, such as a record of a step, to the observer of the run."""
        self._box.require_running()
        event = {"run": self._seat.run, "number": self.number, "value": pickle.dumps(value)}
        self._worker.log_event(TOPIC, event)

    def require_running(self) -> None:
        """Raise :class:`~equimesh.numerics.channel.PeerError` where the run has ended; for work without messages."""
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
