"""The files port: where bytes are kept under their SHA-256, written once, never changed.

An implementation passes ``check_files`` of the service's tests. There are two: a folder
(:mod:`equimesh_service.files.folder`) and S3-compatible storage (:mod:`equimesh_service.files.s3`).
"""

import hashlib
import os
import re
from collections.abc import AsyncGenerator, Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

SHA256 = re.compile(r"[0-9a-f]{64}")


@dataclass(frozen=True)
class StoredFile:
    """A file of the store: the SHA-256 of its bytes, in hexadecimal, and their number."""

    sha256: str
    size: int


@dataclass(frozen=True)
class ListedFile:
    """A file that is there: its SHA-256, its size in bytes, and the seconds since it was written."""

    sha256: str
    size: int
    age: float


# Whether the content with this SHA-256 was removed lately, or may be at any moment; called inside a transaction.
Removed = Callable[[str], bool]
# Gives the files that a transaction names their names.
Publish = Callable[[Removed], None]


def publish_nothing(removed: Removed) -> None:
    """Publish nothing: the files have their names already."""


class Files(Protocol):
    """Files under the SHA-256 of their bytes; safe for many processes, and after a crash.

    A file is written to a local temporary file first (:meth:`unfinished`), then sealed, then published inside the
    transaction that names it. A half-written file is never visible. Every method raises :class:`OSError` when the
    storage fails, :class:`~equimesh_service.errors.FilesError` when it cannot be reached or used, and
    :class:`FileNotFoundError` for a missing file.
    """

    def prepare(self, *, alone: bool) -> None:
        """Make what is needed, see that files can be written and read, and clear what a crash left unfinished.

        ``alone`` says that no other service uses this folder: all that is unfinished is left over.
        """
        ...

    def tidy(self) -> None:
        """Clear what a killed worker left unfinished hours ago."""
        ...

    def unfinished(self, suffix: str) -> AbstractContextManager[Path]:
        """A local temporary file; whatever is left there at the end is removed."""
        ...

    def seal(self, path: Path) -> StoredFile:
        """Bring a finished file of :meth:`unfinished` to where it is safe; nothing refers to it yet.

        A file that is sealed and never published is left over, and stays in :meth:`listing` if it is there at all.
        """
        ...

    def publish(self, path: Path, file: StoredFile, removed: Removed) -> None:
        """Give a sealed file its name. Done inside the transaction that first refers to it, so that a
        removal of the same content for another mesh cannot come in between. Unless it was ``removed`` since it was
        sealed, this is fast: remote storage is not asked."""
        ...

    def local(self, sha256: str) -> AbstractContextManager[Path]:
        """The file as one that can be opened here, for the length of a ``with``; it must not be changed."""
        ...

    def open_range(self, sha256: str, start: int, end: int) -> AsyncGenerator[bytes, None]:
        """The bytes from ``start`` up to ``end``, which is left out, in pieces of :data:`PIECE_BYTES` at most."""
        ...

    def remove(self, sha256: str) -> None:
        """Remove a file that nothing refers to any more, if it is there."""
        ...

    def listing(self) -> Iterator[ListedFile]:
        """All files that are there, in no order."""
        ...

    def check(self) -> None:
        """Raise :class:`OSError` when files cannot be written and read now."""
        ...


# Bytes that a download keeps in memory at a time.
PIECE_BYTES = 1024 * 1024


def key_of(sha256: str) -> str:
    """The name of a file inside a folder or bucket; raises :class:`ValueError` for what is no SHA-256."""
    if not SHA256.fullmatch(sha256):
        raise ValueError(f"{sha256[:80]!r} is not a SHA-256 in hexadecimal")
    return f"{sha256[:2]}/{sha256}"


def digest_of(path: Path, *, sync: bool = False) -> StoredFile:
    """What a finished file is; with ``sync`` it is on disk then."""
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
        size = file.tell()
        if sync:
            os.fsync(file.fileno())
    return StoredFile(digest, size)
