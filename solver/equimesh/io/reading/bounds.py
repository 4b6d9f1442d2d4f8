"""What a file may hold and unpack to: refusals in bounded words, numbers of a text, members of a zip."""

from __future__ import annotations

import io
import logging
import re
import struct
import warnings
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Final, TypeVar

import numpy as np
import numpy.typing as npt

from equimesh.errors import InputError, SamplesError
from equimesh.numerics.types import Array, IntArray

# Whatever a reader of a file raises becomes an error that says so, in words of bounded length.

# Characters of a message, at most: it may repeat parts of the file.
MAX_MESSAGE: Final = 500
# What readers raise for broken files. Anything else is a defect of a reader, and is logged as well.
EXPECTED: Final = (ArithmeticError, EOFError, LookupError, MemoryError, OSError, RuntimeError, TypeError, ValueError)

# The most bytes that a file unpacks to, in all: so many times its own, within these bounds.
MAX_EXPANSION, MIN_EXPANDED, MAX_EXPANDED = 100, 1 << 20, 1 << 31

_log = logging.getLogger(__name__)


def most_unpacked(size: int) -> int:
    """The most bytes that a file of ``size`` bytes may unpack to."""
    return min(max(MAX_EXPANSION * size, MIN_EXPANDED), MAX_EXPANDED)


def bad_file(message: str) -> InputError:
    """The error of a file that is not read."""
    return InputError(message, field="file")


@contextmanager
def refusing(name: str) -> Iterator[None]:
    """Raise every fault inside as :class:`~equimesh.errors.InputError`; ``name`` is that of the format."""
    try:
        yield
    except InputError as error:
        if len(error.message) <= MAX_MESSAGE and error.message.isprintable():
            raise
        raise type(error)(_shown(error.message, MAX_MESSAGE), field=_shown(error.field, MAX_MESSAGE)) from error
    except Exception as error:
        if not isinstance(error, EXPECTED):
            _log.exception("the reader of %s failed", name)
        words = "it needs more memory than there is" if isinstance(error, MemoryError) else _shown(str(error), 200)
        raise bad_file(f"the {name} file cannot be read: {words}") from error


def _shown(text: str, most: int) -> str:
    """The start of a text, in characters that every answer can hold."""
    cut = text if len(text) <= most else f"{text[: most - 4]} ..."
    return "".join(letter if letter.isprintable() else ascii(letter)[1:-1] for letter in cut)


# Many numbers from a text at once, with the line of the first word that is no number.

# Bytes of a text that are searched at once for a bad word.
PIECE = 1 << 16

_GAP = re.compile(rb"\s")
T = TypeVar("T", np.int64, np.float64)


def integers(text: bytes, first_line: int, what: str) -> IntArray:
    """The integers of ``text``, which begins in line ``first_line`` of a file; ``what`` they are, for messages.

    Raises :class:`~equimesh.errors.InputError` with the line of the first word that is no integer.
    """
    return _numbers(text, np.int64, first_line, what)


def floats(text: bytes, first_line: int, what: str) -> Array:
    """The real numbers of a text, as by :func:`integers`, to the last bit."""
    return _numbers(text, np.float64, first_line, what)


def line_of(data: bytes, place: int) -> int:
    """The number of the line, from 1, in which byte ``place`` is."""
    return data.count(b"\n", 0, place) + 1


def _numbers(text: bytes, kind: type[T], first_line: int, what: str) -> npt.NDArray[T]:
    last = text.rsplit(None, 1)[-1:]
    if not last:
        return np.empty(0, kind)
    try:
        found = np.fromstring(text, kind, sep=" ")
        # Old versions of NumPy stop at a bad word; then the last number is not the last word.
        end = int(last[0]) if kind is np.int64 else float(last[0])
        whole = bool(len(found)) and (end == found[-1] or end != end)
    except (ValueError, DeprecationWarning):
        whole = False
    if not whole:
        line, word = _first_bad(text, kind)
        noun = "integer" if kind is np.int64 else "number"
        raise bad_file(f"line {first_line + line}: {word[:30]!r} is no {noun}, among {what}")
    return found


def _first_bad(text: bytes, kind: type[T]) -> tuple[int, str]:
    """The line, from 0, and the first word that is no number of this kind."""
    before, left = 0, len(text)
    for lines in _pieces(text):
        left -= len(lines)
        if not left or not _is_good(lines, kind):
            for number, line in enumerate(lines.split(b"\n")):
                for word in line.split():
                    if not _is_number(word, kind):
                        return before + number, word[:PIECE].decode("latin-1")
        before += lines.count(b"\n")
    return 0, text[:30].decode("latin-1")


def _pieces(text: bytes) -> Iterator[bytes]:
    """The text in pieces of some length that end between words."""
    at = 0
    while at < len(text):
        gap = _GAP.search(text, min(at + PIECE, len(text)))
        end = gap.start() if gap else len(text)
        yield text[at:end]
        at = end


def _is_good(text: bytes, kind: type[T]) -> bool:
    """Whether NumPy reads every word of a piece."""
    if b"_" in text or not text.isascii():
        return False
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # old versions of NumPy only warn of a bad word
        try:
            np.fromstring(text, kind, sep=" ")
        except (ValueError, DeprecationWarning):
            return False
    return True


def _is_number(word: bytes, kind: type[T]) -> bool:
    if b"_" in word or not word.isascii():
        return False
    try:
        kind(int(word) if kind is np.int64 else float(word))
    except (ValueError, OverflowError):
        return False
    return True


MAX_MEMBERS: Final = 1000
_ENTRY: Final = b"PK\x01\x02"  # begins the entry of each member in the list at the end
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_BROKEN = (
    zipfile.BadZipFile,
    zlib.error,
    struct.error,
    EOFError,
    OSError,
    ValueError,
    LookupError,
    OverflowError,
    NotImplementedError,
    RuntimeError,
)


_CENTRAL: Final = struct.Struct("<4s6H3L5H2L")
_LOCAL: Final = struct.Struct("<4s5H3L2H")
_END: Final = struct.Struct("<4s4H2LH")
_UTF_8, _VERSION = 0x800, 45  # the flag of names in UTF-8; a later version of the format may mean something else


@dataclass(frozen=True)
class _Stored:
    """The plainest zip file, as :func:`numpy.savez` writes it: begin, size and checksum of each member by its name."""

    data: bytes
    places: dict[str, tuple[int, int, int]]

    @classmethod
    def of(cls, data: bytes) -> _Stored | None:
        """The members of a file without anything that :mod:`zipfile` would have to look at; ``None`` for others."""
        listed = len(data) - _END.size
        if listed < 0:
            return None
        mark, *disks, here, count, size, at, comment = _END.unpack_from(data, listed)
        if mark != b"PK\x05\x06" or any(disks) or comment or here != count or at + size != listed:
            return None
        places, free = dict[str, tuple[int, int, int]](), 0
        for _ in range(count):
            found = _entry(data, at, listed, free)
            if found is None or found[0] in places:
                return None
            name, place, at = found
            places[name], free = place, place[0] + place[1]
        return cls(data, places) if at == listed and free <= listed - size else None

    def read(self, name: str) -> bytes:
        """The bytes of a member; raises :class:`zipfile.BadZipFile` where they are not those that were written."""
        begin, size, check = self.places[name]
        found = self.data[begin : begin + size]
        if zlib.crc32(found) != check:
            raise zipfile.BadZipFile(f"Bad CRC-32 for file {name!r}")
        return found


def _entry(data: bytes, at: int, end: int, free: int) -> tuple[str, tuple[int, int, int], int] | None:
    """The name and the place of the member that is listed at byte ``at``, and where the next one is listed.

    ``None`` unless it is stored as it is, with a plain name, and begins at byte ``free`` or later.
    """
    if at + _CENTRAL.size > end:
        return None
    entry = _CENTRAL.unpack_from(data, at)
    mark, _, version, flags, method, _, _, check, packed, size, length, extra, comment, _, _, _, start = entry
    listed = at + _CENTRAL.size + length
    text = data[at + _CENTRAL.size : listed]
    unusual = method or extra or comment or flags & ~_UTF_8 or version > _VERSION or packed != size
    if mark != _ENTRY or unusual or not text.isascii() or b"\0" in text or not free <= start <= end - _LOCAL.size:
        return None
    mark, _, local_flags, _, _, _, _, _, _, length, extra = _LOCAL.unpack_from(data, start)
    name, begin = start + _LOCAL.size, start + _LOCAL.size + length + extra
    if mark != b"PK\x03\x04" or local_flags != flags or data[name : name + length] != text or begin + size > end:
        return None
    return text.decode("ascii"), (begin, size, check), listed


@dataclass
class Members:
    """The names in a zip file, in its order, and the bytes of those that are read: at most ``budget`` in all."""

    archive: zipfile.ZipFile | _Stored
    kind: str
    budget: int
    names: list[str] = field(init=False)

    def __post_init__(self) -> None:
        self.names = list(self.archive.places) if isinstance(self.archive, _Stored) else self.archive.namelist()

    def size(self, name: str) -> int:
        """The bytes of a member when it is unpacked, as the zip file states them."""
        if isinstance(self.archive, _Stored):
            return self.archive.places[name][1]
        return self.archive.getinfo(name).file_size

    def read(self, name: str) -> bytes:
        """The bytes of a member, which are never written to a file."""
        if self._is_unusual(name):
            raise SamplesError(f"{name[:80]!r} in the {self.kind} file is packed in an unusual way: use deflate")
        if self.size(name) > self.budget:
            raise SamplesError(f"the {self.kind} file unpacks to more than the bytes allowed")
        self.budget -= self.size(name)
        if isinstance(self.archive, _Stored):
            return self.archive.read(name)
        member = self.archive.getinfo(name)
        with self.archive.open(member) as stream:
            found = stream.read(member.file_size + 1)
        if len(found) != member.file_size:
            raise SamplesError(f"{name[:80]!r} in the {self.kind} file does not have its stated length")
        return found

    def _is_unusual(self, name: str) -> bool:
        return isinstance(self.archive, zipfile.ZipFile) and self.archive.getinfo(name).compress_type not in _METHODS


@contextmanager
def open_zip(data: bytes, kind: str, max_bytes: int, remedy: str, max_members: int = MAX_MEMBERS) -> Iterator[Members]:
    """The members of the zip file ``data``; ``kind`` is its name in messages, ``remedy`` the advice to write one.

    Raises :class:`~equimesh.errors.SamplesError` for every fault of it, also where it is used.
    """
    if data.count(_ENTRY) > max_members:  # before they are listed, which takes long
        raise SamplesError(f"the {kind} file has more than {max_members} members")
    try:
        stored = _Stored.of(data)
        if stored is not None:
            yield Members(stored, kind, max_bytes)
            return
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            yield Members(archive, kind, max_bytes)
    except SamplesError:
        raise
    except _BROKEN as error:
        raise SamplesError(f"the {kind} file cannot be unpacked: {str(error)[:200]}; {remedy}") from error
