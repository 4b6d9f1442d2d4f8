"""The only module that knows httpx: sends one request, once, and turns its failures into values."""

from __future__ import annotations

import ipaddress
from collections.abc import AsyncIterator, Iterator, Mapping
from contextlib import asynccontextmanager, contextmanager
from typing import Any

import httpx

from equimesh_client.errors import BadArgument
from equimesh_client.flows import Disconnected, Send
from equimesh_client.protocol import Call, Reply


class Dropped(Exception):
    """A stream that broke, or could not be opened."""


def base_url(url: str) -> str:
    """The URL without a slash at its end. Raises :class:`BadArgument` when it is no http(s) URL."""
    try:
        parsed = httpx.URL(url)
    except (httpx.InvalidURL, TypeError) as error:
        raise BadArgument(f"{url!r} is not a URL: {error}") from error
    if parsed.scheme not in ("http", "https") or not parsed.host:
        raise BadArgument(f"{url!r} is not the URL of a service; write e.g. http://127.0.0.1:8000")
    return url.rstrip("/")


def _options(url: str, headers: Mapping[str, str]) -> dict[str, Any]:
    """Arguments of the httpx clients. A proxy cannot reach this machine's own addresses: there, none is
    used.
    """
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


def _head(response: httpx.Response) -> dict[str, str]:
    return {name.lower(): value for name, value in response.headers.items()}


def _reason(error: Exception) -> str:
    if isinstance(error, httpx.TimeoutException):
        return f"no answer in time: {type(error).__name__}"
    words = str(error).strip()
    return words or type(error).__name__


class _Body:
    """Collects a body, into memory or the sink of a successful answer, as long as the deadline allows."""

    def __init__(self, step: Send, status: int) -> None:
        self._step = step
        self._sink = step.sink if status == 200 else None
        self._chunks: list[bytes] = []
        if self._sink is not None:
            self._sink.restart()

    def add(self, chunk: bytes) -> None:
        if self._sink is not None:
            self._sink.write(chunk)
        else:
            self._chunks.append(chunk)
        if self._step.deadline.left <= 0:
            raise Dropped("the answer did not arrive in time")

    def bytes(self) -> bytes:
        return b"".join(self._chunks)


class SyncTransport:
    """Blocking requests over one pool of connections."""

    def __init__(self, url: str, headers: Mapping[str, str]) -> None:
        self._client = httpx.Client(**_options(url, headers))

    def send(self, step: Send) -> Reply | Disconnected:
        """The answer, or why there is none."""
        try:
            response = self._client.send(_request(self._client, step.call, step.timeout), stream=True)
            try:
                body = _Body(step, response.status_code)
                for chunk in response.iter_bytes():
                    body.add(chunk)
                return Reply(status=response.status_code, headers=_head(response), body=body.bytes())
            finally:
                response.close()
        except (httpx.RequestError, Dropped) as error:
            return Disconnected(reason=_reason(error))

    @contextmanager
    def stream(self, call: Call, timeout: float) -> Iterator[tuple[Reply, Iterator[bytes]]]:
        """The head of an answer and its chunks; the body of a failure is in the reply. Raises
        :class:`Dropped`.
        """
        try:
            response = self._client.send(_request(self._client, call, timeout), stream=True)
            try:
                body = response.read() if response.status_code != 200 else b""
                yield (
                    Reply(status=response.status_code, headers=_head(response), body=body),
                    iter(()) if body else response.iter_bytes(),
                )
            finally:
                response.close()
        except httpx.RequestError as error:
            raise Dropped(_reason(error)) from error

    def close(self) -> None:
        """Close all connections."""
        self._client.close()


class AsyncTransport:
    """Requests for asyncio over one pool of connections."""

    def __init__(self, url: str, headers: Mapping[str, str]) -> None:
        self._client = httpx.AsyncClient(**_options(url, headers))

    async def send(self, step: Send) -> Reply | Disconnected:
        """The answer, or why there is none."""
        try:
            response = await self._client.send(_request(self._client, step.call, step.timeout), stream=True)
            try:
                body = _Body(step, response.status_code)
                async for chunk in response.aiter_bytes():
                    body.add(chunk)
                return Reply(status=response.status_code, headers=_head(response), body=body.bytes())
            finally:
                await response.aclose()
        except (httpx.RequestError, Dropped) as error:
            return Disconnected(reason=_reason(error))

    @asynccontextmanager
    async def stream(self, call: Call, timeout: float) -> AsyncIterator[tuple[Reply, AsyncIterator[bytes]]]:
        """The head of an answer and its chunks; the body of a failure is in the reply. Raises
        :class:`Dropped`.
        """
        try:
            response = await self._client.send(_request(self._client, call, timeout), stream=True)
            try:
                body = await response.aread() if response.status_code != 200 else b""
                yield (
                    Reply(status=response.status_code, headers=_head(response), body=body),
                    response.aiter_bytes(),
                )
            finally:
                await response.aclose()
        except httpx.RequestError as error:
            raise Dropped(_reason(error)) from error

    async def close(self) -> None:
        """Close all connections."""
        await self._client.aclose()
