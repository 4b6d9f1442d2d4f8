"""Request bodies: read within the limits of size and time, and taken apart by their media type."""

from __future__ import annotations

import asyncio
import re
from collections import Counter
from collections.abc import AsyncIterator, Coroutine, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from email.message import Message
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Any, TypeAlias, TypeVar

from anyio import to_thread
from starlette.datastructures import FormData, Headers, UploadFile
from starlette.formparsers import MultiPartException, MultiPartParser
from starlette.requests import ClientDisconnect, Request

from equimesh_service.assembly.upload import Upload, is_light
from equimesh_service.problems.problem import Problem

JSON = "application/json"
MULTIPART = "multipart/form-data"
# The media type of a request in one npz.
NPZ = "application/x-npz"
MeshParts: TypeAlias = tuple[bytes, Upload | None, Upload | None]
"""A request for a mesh: the bytes of its spec, its samples, and the mesh that is its domain."""
Result = TypeVar("Result")
# A slower sender would hold a connection and memory for too long.
BODY_SECONDS = 300.0
# The most bytes of a JSON body that carries no samples.
MAX_PLAIN_BYTES = 1024 * 1024
# A body that is longer waits for its end on the disk: many bodies that never end then take no memory.
MEMORY_BYTES = 1024 * 1024
# Multipart bodies up to this size are parsed on the event loop, within milliseconds whatever they contain.
_INLINE_BYTES = 64 * 1024
# Longer ones are parsed in pieces of this size, so that no copy of the whole is made.
_PIECE_BYTES = 1024 * 1024


# The most bytes under way of the bodies of one key, from the first one to the end of the checks, in the largest bodies.
_BODIES_OF_KEY = 8
# The same for all keys, in those of one key.
_KEYS = 4


class BodyRoom:
    """Room for the bytes of bodies that are under way: each key has a part of it. For one event loop."""

    def __init__(self, folder: Path, max_body: int) -> None:
        self.folder = folder
        self._most_of_key = _BODIES_OF_KEY * max_body
        self._taken = Counter[str]()

    @contextmanager
    def place(self, key_id: str) -> Iterator[BodyPlace]:
        """The place of one request, which is free again after the ``with``."""
        place = BodyPlace(self, key_id)
        try:
            yield place
        finally:
            self._taken[key_id] -= place.size
            self._taken += Counter()  # without the keys that have nothing left

    def take(self, key_id: str, size: int) -> None:
        """Take room; raises a 429 problem where this key has none left, and a 503 problem where there is none."""
        if self._taken[key_id] + size > self._most_of_key:
            who = "This key has" if key_id else "Callers without a key have"
            detail = f"{who} {self._taken[key_id]} bytes of bodies under way: send more when these are answered."
            raise Problem("quota-exceeded", detail, headers=_LATER)
        if self._taken.total() + size > _KEYS * self._most_of_key:
            raise Problem("unavailable", "Too many bytes of bodies are under way.", headers=_LATER)
        self._taken[key_id] += size


@dataclass
class BodyPlace:
    """The place of the body of one request, and the bytes for which it has room."""

    room: BodyRoom
    key_id: str
    size: int = 0

    def reserve(self, size: int) -> None:
        """Have room for a body of this size; raises the problems of :meth:`BodyRoom.take`."""
        if size > self.size:
            self.room.take(self.key_id, size - self.size)
            self.size = size


_LATER = {"Retry-After": "5", "Connection": "close"}


@dataclass(frozen=True)
class Part:
    """One part of a multipart body."""

    data: bytes
    filename: str
    media_type: str


class _Body:
    """The bytes of a body that have come: at most :data:`MEMORY_BYTES` in memory, the others in an unnamed file."""

    def __init__(self, folder: Path) -> None:
        self.size = 0
        self._folder = folder
        self._memory = BytesIO()
        self._file: IO[bytes] | None = None

    async def write(self, chunk: bytes) -> None:
        """Add a piece."""
        self.size += self._memory.write(chunk)
        if self._memory.tell() > MEMORY_BYTES:
            await to_thread.run_sync(self._move)

    async def read(self) -> bytes:
        """All bytes."""
        return self._memory.getvalue() if self._file is None else await to_thread.run_sync(self._read_file)

    def close(self) -> None:
        """Remove the file."""
        if self._file is not None:
            self._file.close()

    def _move(self) -> None:
        if self._file is None:
            self._file = TemporaryFile(dir=self._folder)  # noqa: SIM115  # closed by :meth:`close`
        self._file.write(self._memory.getbuffer())
        self._memory = BytesIO()

    def _read_file(self) -> bytes:
        assert self._file is not None
        self._move()
        self._file.seek(0)
        return self._file.read()


async def read_body(request: Request, most: int, place: BodyPlace) -> bytes:
    """All bytes of the body; raises a 413 problem for more than ``most`` bytes, and a 408 problem for a slow sender.

    While it comes, a long body is in a file, which has no name and is gone with this process. The 413, and the problems
    of a ``place`` without room, come as soon as the length is known: from Content-Length, or at the first byte that is
    too many.
    """
    encoding = request.headers.get("content-encoding", "identity").strip().lower()
    if encoding not in ("", "identity"):
        raise Problem("unsupported-media-type", f"Content-Encoding {encoding!r}: send the body without an encoding.")
    length = request.headers.get("content-length", "")
    if length.isdigit() and int(length[:20]) > most:
        raise _too_large(most)
    place.reserve(int(length) if length.isdigit() else 0)
    body = _Body(place.room.folder)
    try:
        async with asyncio.timeout(BODY_SECONDS):
            async for chunk in request.stream():
                if body.size + len(chunk) > most:
                    raise _too_large(most)
                place.reserve(body.size + len(chunk))
                await body.write(chunk)
        return await body.read()
    except TimeoutError:
        detail = f"The body must arrive within {BODY_SECONDS:g} seconds; {body.size} bytes did."
        raise Problem("request-timeout", detail, headers={"Connection": "close"}) from None
    except ClientDisconnect:
        raise Problem("malformed-body", "The body is incomplete.") from None
    except OSError as error:
        raise Problem("storage-full", f"The body cannot be stored: {error.strerror}.") from error
    finally:
        body.close()


async def read_plain_json(request: Request, most: int, place: BodyPlace) -> bytes:
    """The bytes of a JSON body that carries no samples: at most ``most``, and at most :data:`MAX_PLAIN_BYTES`."""
    if media_type(request) != JSON:
        raise Problem("unsupported-media-type", f"Send {JSON}.")
    return await read_body(request, min(most, MAX_PLAIN_BYTES), place)


def media_type(request: Request) -> str:
    """The media type of the body, without parameters."""
    return media_type_of(request.headers.get("content-type", ""))


def media_type_of(content_type: str) -> str:
    """The media type in a header Content-Type, without parameters."""
    return content_type.partition(";")[0].strip().lower()


class _Parser(MultiPartParser):
    """A parser that keeps all parts in memory, where the body is already: it waits for nothing."""

    spool_max_size = 2**62


async def read_parts(request: Request, body: bytes, allowed: tuple[str, ...]) -> Mapping[str, Part]:
    """The :func:`parts_of` a body; those of a long one are found in a thread."""
    kind = request.headers.get("content-type", "")
    if len(body) <= _INLINE_BYTES:
        return parts_of(kind, body, allowed)
    return await to_thread.run_sync(parts_of, kind, body, allowed)  # it takes seconds for a long body of line ends


def parts_of(content_type: str, body: bytes, allowed: tuple[str, ...]) -> Mapping[str, Part]:
    """The parts of a multipart body, by their names; raises a 400 problem for names that are not ``allowed``."""
    plain = _plain_parts(content_type, body)
    return _by_names(_parsed_parts(content_type, body) if plain is None else plain, allowed)


# A multipart body as programs write it. Its head gives its boundary, that of each part a name.
_PLAIN = re.compile(r"multipart/form-data; boundary=([\w-]{1,70})", re.ASCII)
_HEAD = re.compile(
    rb'\r\nContent-Disposition: form-data; name="(\w{1,80})"(?:; filename="([\w.-]{1,255})")?'
    rb"(?:\r\nContent-Type: ([\w./+-]{1,127}))?\r\n\r\n",
    re.ASCII,
)
_MOST_PARTS = 8


def _plain_parts(content_type: str, body: bytes) -> list[tuple[str, Part]] | None:
    """The names and parts of the plainest body, which the parser takes ten times as long to read; None for others."""
    kind = _PLAIN.fullmatch(content_type)
    if kind is None:
        return None
    border = b"--" + kind[1].encode()
    if not body.startswith(border):
        return None
    parts, at, border = list[tuple[str, Part]](), len(border), b"\r\n" + border
    while (head := _HEAD.match(body, at)) is not None and len(parts) < _MOST_PARTS:
        end = body.find(border, head.end())
        data = body[head.end() : end]
        if end < 0 or (head[2] is None and not _is_utf8(data)):
            return None
        name, filename, media = (b"" if text is None else text for text in head.groups())
        media = media if filename else b""
        parts.append((name.decode(), Part(data, filename.decode(), media.decode().lower())))
        at = end + len(border)
        if len(body) - at <= 4 and body[at:] in (b"--", b"--\r\n"):
            return parts
    return None


def _is_utf8(data: bytes) -> bool:
    try:
        data.decode()
    except UnicodeDecodeError:
        return False
    return True


def _parsed_parts(content_type: str, body: bytes) -> list[tuple[str, Part]]:
    """The names and parts of any multipart body."""

    async def stream() -> AsyncIterator[bytes]:
        for start in range(0, len(body), _PIECE_BYTES):
            yield body[start : start + _PIECE_BYTES]

    headers, most = Headers({"content-type": content_type}), _MOST_PARTS
    parser = _Parser(headers, stream(), max_files=most, max_fields=most, max_part_size=len(body) + 1)  # type: ignore[arg-type]
    try:
        form = _finish(parser.parse())
    except (MultiPartException, KeyError, LookupError, UnicodeError) as error:
        raise Problem("malformed-body", f"The multipart body cannot be read: {str(error).rstrip('.')}.") from None
    try:
        return _finish(_read_form(form))
    finally:
        _finish(form.close())


def _finish(coroutine: Coroutine[Any, Any, Result]) -> Result:
    """The result of a coroutine that waits for nothing."""
    try:
        coroutine.send(None)
    except StopIteration as stop:
        result: Result = stop.value
        return result
    raise RuntimeError("a part of a body was not in memory")


async def _read_form(form: FormData) -> list[tuple[str, Part]]:
    parts = list[tuple[str, Part]]()
    for name, value in form.multi_items():
        if isinstance(value, UploadFile):
            kind = media_type_of(Headers(raw=value.headers.raw).get("content-type", ""))
            parts.append((name, Part(await value.read(), value.filename or "", kind)))
        else:
            parts.append((name, Part(value.encode("utf-8", "surrogatepass"), "", "")))
    return parts


def _by_names(found: list[tuple[str, Part]], allowed: tuple[str, ...]) -> Mapping[str, Part]:
    parts: dict[str, Part] = {}
    for name, part in found:
        if name not in allowed:
            raise Problem("malformed-body", f"A part {name[:80]!r} is not known; known are {', '.join(allowed)}.")
        if name in parts:
            raise Problem("malformed-body", f"The part {name!r} comes twice.")
        parts[name] = part
    return parts


def check_kind(content_type: str) -> None:
    """Raise a 415 problem for a media type in which no request for a mesh comes."""
    kind = media_type_of(content_type)
    if kind not in (JSON, MULTIPART, NPZ):
        shown = repr(kind[:80]) if kind else "no Content-Type"
        raise Problem("unsupported-media-type", f"Send {JSON}, {MULTIPART} or {NPZ}, not {shown}.")


def is_quick(content_type: str, data: bytes) -> bool:
    """Whether a body is taken apart within milliseconds, whatever it contains."""
    kind = media_type_of(content_type)
    return kind == JSON or (len(data) <= _INLINE_BYTES and (kind != NPZ or is_light(data, "request.npz")))


def take_apart(content_type: str, data: bytes) -> MeshParts:
    """The parts of a request for a mesh; raises 400, 415 and 422 problems."""
    check_kind(content_type)
    kind = media_type_of(content_type)
    if kind == NPZ:
        from equimesh_service.assembly.bodies import unpack  # which needs the solver

        return *unpack(data), None
    if kind == JSON:
        return data, None, None
    parts = parts_of(content_type, data, ("spec", "samples", "mesh"))
    if "spec" not in parts:
        raise Problem("malformed-body", 'The multipart body needs a part "spec".')
    samples, mesh = (upload_of(parts[name]) if name in parts else None for name in ("samples", "mesh"))
    return parts["spec"].data, samples, mesh


_SUFFIXES = {
    NPZ: ".npz",
    "application/x-npy": ".npy",
    "text/csv": ".csv",
    "text/plain": ".txt",
    JSON: ".json",
    "application/vnd.vtk.vtu+xml": ".vtu",
    "application/vnd.vtk": ".vtk",
    "application/zip": ".zip",  # a mesh of several files
}


def upload_of(part: Part) -> Upload:
    """A part as an uploaded file; without a filename, its media type gives the format."""
    filename = part.filename or "samples" + _SUFFIXES.get(part.media_type, "")
    return Upload(part.data, filename)


async def read_upload(request: Request, most: int, filename: str | None, place: BodyPlace) -> Upload:
    """Samples sent as a multipart part ``samples``, or as the body itself."""
    body = await read_body(request, most, place)
    kind = media_type(request)
    if kind == MULTIPART:
        parts = await read_parts(request, body, ("samples",))
        if "samples" not in parts:
            raise Problem("malformed-body", 'The multipart body needs a part "samples".')
        return upload_of(parts["samples"])
    name = filename or _disposition_filename(request)
    if name is None and kind not in _SUFFIXES:
        raise Problem(
            "unsupported-media-type",
            f"Send multipart with a part 'samples', or the file itself as one of {', '.join(_SUFFIXES)}, "
            "or give its name as ?filename=.",
        )
    return Upload(body, name or f"samples{_SUFFIXES[kind]}")


def _disposition_filename(request: Request) -> str | None:
    message = Message()
    message["Content-Disposition"] = request.headers.get("content-disposition", "")
    return message.get_filename()


def _too_large(most: int) -> Problem:
    return Problem("body-too-large", f"The body may have at most {most} bytes.")
