"""The transports of both clients, which alone know httpx, and the session that executes flows on one of them.

A timeout of httpx starts again with every byte. A request is kept within its deadline by `asyncio.timeout` here, and
for the blocking client by connections of its own (:class:`Punctual`).
"""

from __future__ import annotations

import asyncio
import ipaddress
import ssl
import threading
import time
from collections.abc import AsyncIterator, Callable, Iterable, Iterator, Mapping
from contextlib import AbstractAsyncContextManager, asynccontextmanager, contextmanager
from typing import Any, Protocol, TypeAlias, TypeVar

import httpcore
import httpx

from equimesh_client.errors import BadArgument
from equimesh_client.wire import flows, protocol
from equimesh_client.wire.flows import FailedConnection, Flow, Outcome, Pause, Report, Send
from equimesh_client.wire.protocol import Call, Reply
from equimesh_client.wire.settings import Deadline, Settings
from equimesh_client.wire.stream import Event, StreamPosition

WRITE_BYTES = 65_536
"""Size of one write. A larger one could last beyond the deadline with a slow reader."""


class Punctual:
    """The deadline of the current request of each thread."""

    def __init__(self) -> None:
        self._of_thread = threading.local()

    @contextmanager
    def until(self, deadline: Deadline) -> Iterator[None]:
        """Reads and writes inside end with the deadline."""
        self._of_thread.deadline = deadline
        try:
            yield
        finally:
            self._of_thread.deadline = None

    def left(self, timeout: float | None) -> float | None:
        """Seconds for the next read or write; raises ``httpcore.ReadTimeout`` after the deadline."""
        deadline: Deadline | None = getattr(self._of_thread, "deadline", None)
        if deadline is None:
            return timeout
        left = deadline.left
        if left <= 0:
            raise httpcore.ReadTimeout("the deadline has passed")
        return left if timeout is None else min(timeout, left)

    def over(self, backend: httpcore.NetworkBackend) -> httpcore.NetworkBackend:
        """The backend, with connections that keep the deadline."""
        return _Backend(backend, self)


class _Backend(httpcore.NetworkBackend):
    def __init__(self, backend: httpcore.NetworkBackend, punctual: Punctual) -> None:
        self._backend = backend
        self._punctual = punctual

    def connect_tcp(
        self,
        host: str,
        port: int,
        timeout: float | None = None,
        local_address: str | None = None,
        socket_options: Iterable[Any] | None = None,
    ) -> httpcore.NetworkStream:
        limit = self._punctual.left(timeout)
        return _Stream(self._backend.connect_tcp(host, port, limit, local_address, socket_options), self._punctual)

    def connect_unix_socket(
        self, path: str, timeout: float | None = None, socket_options: Iterable[Any] | None = None
    ) -> httpcore.NetworkStream:
        limit = self._punctual.left(timeout)
        return _Stream(self._backend.connect_unix_socket(path, limit, socket_options), self._punctual)

    def sleep(self, seconds: float) -> None:
        self._backend.sleep(seconds)


class _Stream(httpcore.NetworkStream):
    def __init__(self, stream: httpcore.NetworkStream, punctual: Punctual) -> None:
        self._stream = stream
        self._punctual = punctual

    def read(self, max_bytes: int, timeout: float | None = None) -> bytes:
        return self._stream.read(max_bytes, self._punctual.left(timeout))

    def write(self, buffer: bytes, timeout: float | None = None) -> None:
        for start in range(0, len(buffer), WRITE_BYTES):
            self._stream.write(buffer[start : start + WRITE_BYTES], self._punctual.left(timeout))

    def close(self) -> None:
        self._stream.close()

    def start_tls(
        self, ssl_context: ssl.SSLContext, server_hostname: str | None = None, timeout: float | None = None
    ) -> httpcore.NetworkStream:
        limit = self._punctual.left(timeout)
        return _Stream(self._stream.start_tls(ssl_context, server_hostname, limit), self._punctual)

    def get_extra_info(self, info: str) -> Any:
        return self._stream.get_extra_info(info)


LATE = "the answer did not arrive in time"


class BrokenStream(Exception):
    """A stream that broke, or could not be opened."""


def base_url(url: str) -> str:
    """The URL without a slash or ``/v1`` at its end; a path before that is kept.

    Raises :class:`BadArgument` when it is no http(s) URL, or that of a page or a mesh of the service.
    """
    try:
        parsed = httpx.URL(url)
    except (httpx.InvalidURL, TypeError) as error:
        raise BadArgument(f"{url!r} is not a URL, such as http://127.0.0.1:8000: {error}") from error
    if parsed.scheme not in ("http", "https") or not parsed.host:
        raise BadArgument(f"{url!r} is not the URL of a service, such as http://127.0.0.1:8000")
    path = parsed.raw_path.rstrip(b"/").removesuffix(b"/v1").rstrip(b"/")  # as it was given: %2F is no slash
    if b"/v1/" in path + b"/" or "?" in url or "#" in url:
        start = url.partition("#")[0].partition("?")[0].partition("/v1/")[0].rstrip("/")
        raise BadArgument(f"{url!r} is the URL of a part of a service: give that of the service, such as {start}")
    return str(parsed.copy_with(raw_path=path or b"/")).rstrip("/")


def _options(url: str, headers: Mapping[str, str]) -> dict[str, Any]:
    """Arguments of the httpx clients; without a proxy for addresses of this machine, which no proxy reaches."""
    host = httpx.URL(url).host
    try:
        local = ipaddress.ip_address(host).is_loopback
    except ValueError:
        local = host == "localhost"
    return {"base_url": url, "headers": dict(headers), "trust_env": not local, "follow_redirects": False}


def _request(client: httpx.Client | httpx.AsyncClient, call: Call, timeout: float) -> httpx.Request:
    return client.build_request(
        call.method,
        call.path,
        params=dict(call.query) or None,
        headers=dict(call.headers),
        content=call.body,
        timeout=httpx.Timeout(timeout),
    )


def _head(response: httpx.Response, body: bytes = b"") -> Reply:
    headers = {name.lower(): value for name, value in response.headers.items()}
    return Reply(status=response.status_code, headers=headers, body=body)


def _reason(error: Exception) -> str:
    if isinstance(error, httpx.TimeoutException):
        return f"no answer in time: {type(error).__name__}"
    words = str(error).strip()
    return words or type(error).__name__


class _Body:
    """Collects a body, in memory or in the sink of a successful answer, until the deadline."""

    def __init__(self, step: Send, head: Reply) -> None:
        self._step = step
        self._head = head
        self._sink = step.sink if head.status in (200, 206) else None
        self._chunks: list[bytes] = []
        if self._sink is not None and not self._sink.begin(head):
            raise BrokenStream("the part of the file that arrived is not the requested one")

    def add(self, chunk: bytes) -> None:
        if self._sink is not None:
            self._sink.write(chunk)
        else:
            self._chunks.append(chunk)
        if self._step.deadline.left <= 0:
            raise BrokenStream(LATE)

    def reply(self) -> Reply:
        return Reply(status=self._head.status, headers=self._head.headers, body=b"".join(self._chunks))


class Transport(Protocol):
    """The input and output of a client. The methods of a blocking one never suspend."""

    def __init__(self, url: str, headers: Mapping[str, str]) -> None: ...

    async def send(self, step: Send) -> Reply | FailedConnection:
        """The answer, or the reason why there is none."""

    def stream(
        self, call: Call, timeout: float, deadline: Deadline
    ) -> AbstractAsyncContextManager[tuple[Reply, AsyncIterator[bytes]]]:
        """The head of an answer (with the body of a failure) and its chunks; raises :class:`BrokenStream`."""

    async def sleep(self, seconds: float) -> None:
        """Sleep."""

    async def close(self) -> None:
        """Close all connections."""


class BlockingTransport:
    """Blocking requests over one pool of connections."""

    def __init__(self, url: str, headers: Mapping[str, str]) -> None:
        self._client = httpx.Client(**_options(url, headers))
        self._punctual = Punctual()
        # httpx has no option for it: each of its transports, also that of a proxy, has a pool of httpcore.
        for transport in (self._client._transport, *self._client._mounts.values()):
            if isinstance(transport, httpx.HTTPTransport):
                transport._pool._network_backend = self._punctual.over(transport._pool._network_backend)

    async def send(self, step: Send) -> Reply | FailedConnection:
        """The answer, or the reason why there is none."""
        try:
            with self._punctual.until(step.deadline):
                response = self._client.send(_request(self._client, step.call, step.timeout), stream=True)
                try:
                    body = _Body(step, _head(response))
                    for chunk in response.iter_bytes():
                        body.add(chunk)
                    return body.reply()
                finally:
                    response.close()
        except (httpx.RequestError, BrokenStream) as error:
            return FailedConnection(reason=_reason(error))

    @asynccontextmanager
    async def stream(
        self, call: Call, timeout: float, deadline: Deadline
    ) -> AsyncIterator[tuple[Reply, AsyncIterator[bytes]]]:
        """The head of an answer (with the body of a failure) and its chunks; raises :class:`BrokenStream`."""
        try:
            with self._punctual.until(deadline):
                response = self._client.send(_request(self._client, call, timeout), stream=True)
            try:
                with self._punctual.until(deadline):
                    body = response.read() if response.status_code != 200 else b""
                yield _head(response, body), self._chunks(response, deadline)
            finally:
                response.close()
        except httpx.RequestError as error:
            raise BrokenStream(_reason(error)) from error

    async def _chunks(self, response: httpx.Response, deadline: Deadline) -> AsyncIterator[bytes]:
        chunks = response.iter_bytes()
        while True:
            # not around the yield: between two chunks the same thread may send other requests
            with self._punctual.until(deadline):
                chunk = next(chunks, None)
            if chunk is None:
                return
            yield chunk

    async def sleep(self, seconds: float) -> None:
        """Sleep."""
        time.sleep(seconds)

    async def close(self) -> None:
        """Close all connections."""
        self._client.close()


class AsyncTransport:
    """Requests for asyncio over one pool of connections."""

    def __init__(self, url: str, headers: Mapping[str, str]) -> None:
        self._client = httpx.AsyncClient(**_options(url, headers))

    async def send(self, step: Send) -> Reply | FailedConnection:
        """The answer, or the reason why there is none."""
        try:
            async with asyncio.timeout(step.deadline.left):
                response = await self._client.send(_request(self._client, step.call, step.timeout), stream=True)
                try:
                    body = _Body(step, _head(response))
                    async for chunk in response.aiter_bytes():
                        body.add(chunk)
                    return body.reply()
                finally:
                    await response.aclose()
        except TimeoutError:
            return FailedConnection(reason=LATE)
        except (httpx.RequestError, BrokenStream) as error:
            return FailedConnection(reason=_reason(error))

    @asynccontextmanager
    async def stream(
        self, call: Call, timeout: float, deadline: Deadline
    ) -> AsyncIterator[tuple[Reply, AsyncIterator[bytes]]]:
        """The head of an answer (with the body of a failure) and its chunks; raises :class:`BrokenStream`."""
        try:
            async with asyncio.timeout(deadline.left):
                response = await self._client.send(_request(self._client, call, timeout), stream=True)
            try:
                async with asyncio.timeout(deadline.left):
                    body = await response.aread() if response.status_code != 200 else b""
                yield _head(response, body), self._chunks(response, deadline)
            finally:
                await response.aclose()
        except TimeoutError:
            raise BrokenStream(LATE) from None
        except httpx.RequestError as error:
            raise BrokenStream(_reason(error)) from error

    @staticmethod
    async def _chunks(response: httpx.Response, deadline: Deadline) -> AsyncIterator[bytes]:
        chunks = response.aiter_bytes()
        while True:
            async with asyncio.timeout(deadline.left):
                chunk = await anext(chunks, None)
            if chunk is None:
                return
            yield chunk

    async def sleep(self, seconds: float) -> None:
        """Sleep."""
        await asyncio.sleep(seconds)

    async def close(self) -> None:
        """Close all connections."""
        await self._client.aclose()


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
            ending: Reply | FailedConnection = FailedConnection(reason="closed by the service")
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
            except BrokenStream as error:
                ending = FailedConnection(reason=str(error))
            if not position.done:
                lived = deadline.clock() - opened
                pause = flows.reconnect_pause(position, call, self.settings, deadline, ending=ending, lived=lived)
                await self._transport.sleep(pause)

    async def close(self) -> None:
        """Close all connections."""
        await self._transport.close()
