"""Server-Sent Events: parsing, and the position in a stream that is resumed after a dropped connection."""

import json
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True, kw_only=True)
class Event:
    """An event of a mesh: number ``id``, ``kind`` (``status``, ``progress`` or ``done``) and ``data``."""

    id: int
    kind: str
    data: dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class RawEvent:
    """One block of the wire format, fields not yet interpreted."""

    id: str | None
    kind: str
    data: str


class EventParser:
    """Splits the bytes of ``text/event-stream`` into events, in pieces of any size.

    By the HTML standard lines end in CR, LF or CRLF, comments start with a colon, and an event ends at an empty line.
    An unfinished event at the end of the stream is dropped.
    """

    def __init__(self) -> None:
        self._rest = b""
        self._started = False
        self._id: str | None = None
        self._kind = ""
        self._data: list[str] = []
        self.retry: float | None = None

    def feed(self, chunk: bytes) -> list[RawEvent]:
        """The events that ``chunk`` completes."""
        buffer = self._rest + chunk
        if not self._started:
            if len(buffer) < 3 and b"\xef\xbb\xbf".startswith(buffer):
                self._rest = buffer
                return []
            buffer = buffer.removeprefix(b"\xef\xbb\xbf")
            self._started = True
        # A CR at the very end may be half of a CRLF: keep it for the next chunk.
        held = b"\r" if buffer.endswith(b"\r") else b""
        buffer = buffer[: len(buffer) - len(held)].replace(b"\r\n", b"\n").replace(b"\r", b"\n")
        *lines, last = buffer.split(b"\n")
        self._rest = last + held
        found = []
        for line in lines:
            event = self._line(line.decode("utf-8", errors="replace"))
            if event is not None:
                found.append(event)
        return found

    def _line(self, line: str) -> RawEvent | None:
        if not line:
            event = RawEvent(id=self._id, kind=self._kind or "message", data="\n".join(self._data))
            complete = bool(self._data)
            self._id, self._kind, self._data = None, "", []
            return event if complete else None
        name, _, value = line.partition(":")
        value = value.removeprefix(" ")
        if name == "event":
            self._kind = value
        elif name == "data":
            self._data.append(value)
        elif name == "id" and "\0" not in value:
            self._id = value
        elif name == "retry" and value.isascii() and value.isdigit():
            self.retry = int(value) / 1000.0
        return None


@dataclass
class StreamPosition:
    """The position in a stream of events, over any number of connections.

    ``last`` is the number of the last returned event, 0 before the first. After a connection that ends or drops the
    next one requests the events after ``last``. An event that arrives twice is returned once.
    """

    last: int = 0
    done: bool = False
    failures: int = 0
    _parser: EventParser = field(default_factory=EventParser)

    def connected(self) -> None:
        """Discard the unfinished event of an earlier connection."""
        self._parser = EventParser()

    def feed(self, chunk: bytes) -> list[Event]:
        """The new events that ``chunk`` completes. After ``done`` there are none."""
        new = []
        for raw in self._parser.feed(chunk):
            event = interpret(raw)
            if self.done or event is None or event.id <= self.last:
                continue
            self.last = event.id
            self.failures = 0
            self.done = event.kind == "done"
            new.append(event)
        return new

    @property
    def headers(self) -> dict[str, str]:
        """Request headers that resume the stream."""
        return {"Last-Event-ID": str(self.last)} if self.last else {}

    @property
    def retry(self) -> float:
        """Seconds that the service requests before a new connection."""
        return self._parser.retry or 0.0


def interpret(raw: RawEvent) -> Event | None:
    """The event of one block; None for a message without a number (a keep-alive)."""
    if raw.id is None or not (raw.id.isascii() and raw.id.isdigit()):
        return None
    try:
        data = json.loads(raw.data)
    except ValueError:
        data = raw.data
    return Event(id=int(raw.id), kind=raw.kind, data=data if isinstance(data, dict) else {"value": data})
