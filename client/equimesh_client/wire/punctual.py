"""Connections that keep a deadline, for the blocking client: timeouts of httpx start again with every byte."""

import ssl
import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any

import httpcore

from equimesh_client.wire.deadline import Deadline

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
