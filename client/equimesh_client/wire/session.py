"""The session that executes flows, for both clients. All decisions are in the flows; the transport differs."""

from collections.abc import AsyncIterator, Callable, Mapping
from typing import Any, TypeAlias, TypeVar

from equimesh_client.wire import flows, protocol
from equimesh_client.wire.deadline import Deadline, Settings
from equimesh_client.wire.flows import Disconnected, Flow, Outcome, Pause, Report, Send
from equimesh_client.wire.protocol import Call, Reply
from equimesh_client.wire.stream import Event, StreamPosition
from equimesh_client.wire.transport import Dropped, Transport

T = TypeVar("T")
Reporter: TypeAlias = Callable[[Mapping[str, Any]], None]


class Session:
    """Settings and connections of a client."""

    def __init__(self, settings: Settings, transport: Transport) -> None:
        self.settings = settings
        self._transport = transport

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
                    await self._transport.sleep(seconds)
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
                await self._transport.sleep(pause)

    async def close(self) -> None:
        """Close all connections."""
        await self._transport.close()
