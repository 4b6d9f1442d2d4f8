"""Files over HTTP, whole or in ranges, with the headers for caches and resumed downloads (RFC 9110)."""

from __future__ import annotations

import logging
import re
import secrets
from collections.abc import AsyncGenerator, Mapping
from contextlib import aclosing
from dataclasses import dataclass
from itertools import pairwise

from starlette.requests import Request
from starlette.responses import Response, StreamingResponse
from starlette.types import Receive, Scope, Send

from equimesh_service.files.port import Files, StoredFile
from equimesh_service.problems.problem import Problem

_SPAN = r"\s*(?:\d+-\d*|-\d+)\s*"
_RANGES = re.compile(rf"bytes=({_SPAN}(?:,{_SPAN})*)", re.ASCII | re.IGNORECASE)
_MAX_DIGITS = 18  # of a position in a file; more are past its end
# The most ranges of one answer. A request for more, or for ranges that overlap, gets the whole file.
_MAX_RANGES = 16


@dataclass(frozen=True)
class Span:
    """The bytes of a file from ``start`` up to ``end``, without the byte at ``end``."""

    start: int
    end: int

    def content_range(self, size: int) -> str:
        """The value of Content-Range."""
        return f"bytes {self.start}-{self.end - 1}/{size}"


def parse_ranges(header: str | None, size: int) -> tuple[Span, ...]:
    """The parts of a file of ``size`` bytes that a Range header requests; () for the whole file.

    An invalid header is ignored; raises a 416 problem when all ranges are past the end.
    """
    match = _RANGES.fullmatch((header or "").strip())
    if match is None:
        return ()
    written = [span.strip() for span in match[1].split(",")]
    if any(_is_backward(span) for span in written):
        return ()
    there = [found for span in written if (found := _within(span, size))]
    if not there:
        extent = {"Content-Range": f"bytes */{size}"}
        raise Problem("range-not-satisfiable", f"The file has {size} bytes.", headers=extent)
    in_order = sorted(there, key=lambda span: span.start)
    overlap = any(before.end > after.start for before, after in pairwise(in_order))
    return () if overlap or len(there) > _MAX_RANGES else tuple(there)


def _is_backward(span: str) -> bool:
    first, _, last = span.partition("-")
    return bool(first and last) and _number(first) > _number(last)


def _within(span: str, size: int) -> Span | None:
    first, _, last = span.partition("-")
    start = _number(first) if first else max(0, size - _number(last))
    end = min(size, _number(last) + 1) if first and last else size
    return Span(start, end) if start < end else None


def _number(digits: str) -> int:
    return int(digits) if len(digits) <= _MAX_DIGITS else 10**_MAX_DIGITS


_log = logging.getLogger(__name__)


async def send_file(
    request: Request,
    files: Files,
    file: StoredFile,
    media_type: str,
    *,
    filename: str | None = None,
    headers: Mapping[str, str] | None = None,
    status: int = 200,
    content: bytes | None = None,
) -> Response:
    """The answer with a file, or the requested parts of it; the bytes of an ETag never change.

    ``content`` are the bytes of the file, where they are at hand; with it the file is sent whole.
    Ranges and conditions of the request are used only with ``status`` 200. Raises a 404 problem when the file is gone,
    and 412 and 416 problems for conditions and ranges.
    """
    etag = f'"{file.sha256}"'
    shared = {**(headers or {}), "ETag": etag, "Cache-Control": "private, no-cache", "Vary": "Accept"}
    spans: tuple[Span, ...] = ()
    if status == 200 and content is None:
        if not _matches(request.headers.get("if-match", "*"), etag, weakly=False):
            raise Problem("precondition-failed", f"The file has the ETag {etag}.", headers={"ETag": etag})
        if _matches(request.headers.get("if-none-match", ""), etag, weakly=True):
            return Response(status_code=304, headers=shared)
        if request.headers.get("if-range", etag).strip() == etag and request.method == "GET":
            spans = parse_ranges(request.headers.get("range"), file.size)
    shared["Accept-Ranges"] = "bytes"
    if filename is not None:
        shared["Content-Disposition"] = f'attachment; filename="{filename}"'
    response = _FileResponse(files, file, spans, media_type, status, shared)
    if content is not None:
        response.use(content)
    else:
        await response.open(needs_bytes=request.method != "HEAD")
    return response


def _matches(header: str, etag: str, *, weakly: bool) -> bool:
    """Whether a list of entity tags names this one; with ``weakly``, also as a weak tag."""
    named = {name.strip() for name in header.split(",")}
    return "*" in named or etag in named or (weakly and f"W/{etag}" in named)


class _FileResponse(StreamingResponse):
    """An answer that reads its file piece by piece: a slow client keeps one piece in memory."""

    def __init__(
        self,
        files: Files,
        file: StoredFile,
        spans: tuple[Span, ...],
        media_type: str,
        status: int,
        headers: Mapping[str, str],
    ) -> None:
        self._parts: list[tuple[bytes, Span]] = [(b"", span) for span in spans] or [(b"", Span(0, file.size))]
        self._end = b""
        more = dict(headers)
        if len(spans) == 1:
            more["Content-Range"] = spans[0].content_range(file.size)
        elif spans:
            media_type = self._separate(spans, media_type, file.size)
        length = sum(len(head) + span.end - span.start for head, span in self._parts) + len(self._end)
        more["Content-Length"] = str(length)
        super().__init__(_nothing(), 206 if spans else status, more, media_type)
        self._files, self._file = files, file

    def _separate(self, spans: tuple[Span, ...], media_type: str, size: int) -> str:
        """Put heads before the parts; returns the media type of the whole."""
        boundary = secrets.token_hex(12)
        self._parts = [
            (
                f"\r\n--{boundary}\r\nContent-Type: {media_type}\r\n"
                f"Content-Range: {span.content_range(size)}\r\n\r\n".encode("latin-1"),
                span,
            )
            for span in spans
        ]
        self._end = f"\r\n--{boundary}--\r\n".encode()
        return f"multipart/byteranges; boundary={boundary}"

    def use(self, content: bytes) -> None:
        """Send these bytes, and read no file."""
        self._pieces, self._first = _nothing(), content

    async def open(self, *, needs_bytes: bool) -> None:
        """Read the first piece, while a problem can still be the answer."""
        self._pieces = self._read() if needs_bytes else _nothing()
        try:
            self._first = await anext(self._pieces, b"")
        except FileNotFoundError:
            raise Problem("not-found", "The file was deleted.") from None

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send all bytes. When the storage fails, the connection breaks, so that half a file does not look complete."""
        async with aclosing(self._pieces):
            if scope["method"] == "HEAD" or len(self._first) == int(self.headers["content-length"]):
                await send({"type": "http.response.start", "status": self.status_code, "headers": self.raw_headers})
                await send({"type": "http.response.body", "body": self._first, "more_body": False})
            else:
                await super().__call__(scope, receive, send)

    async def stream_response(self, send: Send) -> None:
        """Send piece by piece; the base class ends this when the client leaves."""
        await send({"type": "http.response.start", "status": self.status_code, "headers": self.raw_headers})
        piece = self._first
        while piece:
            await send({"type": "http.response.body", "body": piece, "more_body": True})
            try:
                piece = await anext(self._pieces, b"")
            except (OSError, EOFError) as error:
                _log.warning("a download of %s was cut off: %s", self._file.sha256, error)
                return
        await send({"type": "http.response.body", "body": b"", "more_body": False})

    async def _read(self) -> AsyncGenerator[bytes, None]:
        for head, span in self._parts:
            if head:
                yield head
            async with aclosing(self._files.open_range(self._file.sha256, span.start, span.end)) as pieces:
                async for piece in pieces:
                    yield piece
        if self._end:
            yield self._end


async def _nothing() -> AsyncGenerator[bytes, None]:
    none: tuple[bytes, ...] = ()
    for piece in none:
        yield piece
