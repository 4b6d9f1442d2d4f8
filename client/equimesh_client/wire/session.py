"""The two sessions that execute flows, blocking and for asyncio. All decisions are in the flows."""

import asyncio
import time
from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from typing import Any, TypeAlias, TypeVar

from equimesh_client.wire import flows, protocol
from equimesh_client.wire.deadline import Deadline, Settings
from equimesh_client.wire.flows import Disconnected, Flow, Outcome, Pause, Report, Send
from equimesh_client.wire.protocol import Call, Reply
from equimesh_client.wire.stream import Event, StreamPosition
from equimesh_client.wire.transport import AsyncTransport, Dropped, SyncTransport

T = TypeVar("T")
Reporter: TypeAlias = Callable[[Mapping[str, Any]], None]


class Session:
    """Settings and connections of a blocking client."""

    def __init__(self, settings: Settings, headers: Mapping[str, str]) -> None:
        self.settings = settings
        self._transport = SyncTransport(settings.url, headers)

    def run(self, flow: Flow[T], report: Reporter | None = None) -> T:
        """Drive a flow to its result."""
        outcome: Outcome = None
        while True:
            try:
                step = flow.send(outcome)
            except StopIteration as stop:
                result: T = stop.value
                return result
            outcome = None
            match step:
                case Send():
                    outcome = self._transport.send(step)
                case Pause(seconds=seconds):
                    time.sleep(seconds)
                case Report(record=record):
                    if report is not None:
                        report(record)

    def fetch(self, call: Call, deadline: float | None = None) -> dict[str, Any]:
        """The JSON object of the answer to a call, within ``deadline`` seconds."""
        return self.run(flows.fetch(call, self.settings, self.settings.deadline(deadline)))

    def delete(self, call: Call, deadline: float | None = None) -> None:
        """Delete a resource within ``deadline`` seconds."""
        self.run(flows.delete(call, self.settings, self.settings.deadline(deadline)))

    def follow(self, mesh_id: str, position: StreamPosition, deadline: Deadline) -> Iterator[Event]:
        """The events of a mesh, over any number of connections."""
        while not position.done:
            opened = deadline.clock()
            call = protocol.events(mesh_id, position)
            ending: Reply | Disconnected = Disconnected(reason="closed by the service")
            try:
                silence = flows.silence_seconds(self.settings, deadline)
                with self._transport.stream(call, silence, deadline) as (head, chunks):
                    if flows.is_stream(head, call, position):
                        position.connected()
                        for chunk in chunks:
                            yield from position.feed(chunk)
                            if position.done or deadline.left <= 0:
                                break
                    else:
                        ending = head
            except Dropped as error:
                ending = Disconnected(reason=str(error))
            if not position.done:
                lived = deadline.clock() - opened
                time.sleep(flows.reconnect_pause(position, call, self.settings, deadline, ending=ending, lived=lived))

    def close(self) -> None:
        """Close all connections."""
        self._transport.close()


class AsyncSession:
    """Settings and connections of a client for asyncio."""

    def __init__(self, settings: Settings, headers: Mapping[str, str]) -> None:
        self.settings = settings
        self._transport = AsyncTransport(settings.url, headers)

    async def run(self, flow: Flow[T], report: Reporter | None = None) -> T:
        """Drive a flow to its result."""
        outcome: Outcome = None
        while True:
            try:
                step = flow.send(outcome)
            except StopIteration as stop:
                result: T = stop.value
                return result
            outcome = None
            match step:
                case Send():
                    outcome = await self._transport.send(step)
                case Pause(seconds=seconds):
                    await asyncio.sleep(seconds)
                case Report(record=record):
                    if report is not None:
                        report(record)

    async def fetch(self, call: Call, deadline: float | None = None) -> dict[str, Any]:
        """The JSON object of the answer to a call, within ``deadline`` seconds."""
        return await self.run(flows.fetch(call, self.settings, self.settings.deadline(deadline)))

    async def delete(self, call: Call, deadline: float | None = None) -> None:
        """Delete a resource within ``deadline`` seconds."""
        await self.run(flows.delete(call, self.settings, self.settings.deadline(deadline)))

    async def follow(self, mesh_id: str, position: StreamPosition, deadline: Deadline) -> AsyncIterator[Event]:
        """The events of a mesh, over any number of connections."""
        while not position.done:
            opened = deadline.clock()
            call = protocol.events(mesh_id, position)
            ending: Reply | Disconnected = Disconnected(reason="closed by the service")
            try:
                silence = flows.silence_seconds(self.settings, deadline)
                async with self._transport.stream(call, silence, deadline) as (head, chunks):
                    if flows.is_stream(head, call, position):
                        position.connected()
                        async for chunk in chunks:
                            for event in position.feed(chunk):
                                yield event
                            if position.done or deadline.left <= 0:
                                break
                    else:
                        ending = head
            except Dropped as error:
                ending = Disconnected(reason=str(error))
            if not position.done:
                lived = deadline.clock() - opened
                pause = flows.reconnect_pause(position, call, self.settings, deadline, ending=ending, lived=lived)
                await asyncio.sleep(pause)

    async def close(self) -> None:
        """Close all connections."""
        await self._transport.close()
