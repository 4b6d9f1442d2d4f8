"""The members of a zip file that a caller sends: only those that are requested, and no more than is allowed."""

import io
import struct
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Final

from equimesh.errors import SamplesError

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


@dataclass
class Members:
    """The names in a zip file, in its order, and the bytes of those that are read: at most ``budget`` in all."""

    archive: zipfile.ZipFile
    kind: str
    budget: int
    names: list[str] = field(init=False)

    def __post_init__(self) -> None:
        self.names = self.archive.namelist()

    def size(self, name: str) -> int:
        """The bytes of a member when it is unpacked, as the zip file states them."""
        return self.archive.getinfo(name).file_size

    def read(self, name: str) -> bytes:
        """The bytes of a member, which are never written to a file."""
        member = self.archive.getinfo(name)
        if member.compress_type not in _METHODS:
            raise SamplesError(f"{name[:80]!r} in the {self.kind} file is packed in an unusual way: use deflate")
        if member.file_size > self.budget:
            raise SamplesError(f"the {self.kind} file unpacks to more than the bytes allowed")
        self.budget -= member.file_size
        with self.archive.open(member) as stream:
            found = stream.read(member.file_size + 1)
        if len(found) != member.file_size:
            raise SamplesError(f"{name[:80]!r} in the {self.kind} file does not have its stated length")
        return found


@contextmanager
def open_zip(data: bytes, kind: str, max_bytes: int, remedy: str, max_members: int = MAX_MEMBERS) -> Iterator[Members]:
    """The members of the zip file ``data``; ``kind`` is its name in messages, ``remedy`` the advice to write one.

    Raises :class:`~equimesh.errors.SamplesError` for every fault of it, also where it is used.
    """
    if data.count(_ENTRY) > max_members:  # before they are listed, which takes long
        raise SamplesError(f"the {kind} file has more than {max_members} members")
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            yield Members(archive, kind, max_bytes)
    except SamplesError:
        raise
    except _BROKEN as error:
        raise SamplesError(f"the {kind} file cannot be unpacked: {str(error)[:200]}; {remedy}") from error
