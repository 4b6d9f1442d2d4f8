"""The files port: storage of bytes under their SHA-256, written once, never changed.

An implementation passes ``check_files`` of the service's tests. There are three: a folder
(:mod:`equimesh_service.files.folder`), S3-compatible storage (:mod:`equimesh_service.files.s3`), and in front of one
of these rows of the database for small files (:mod:`equimesh_service.store.blobs`).
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
    """A file in the storage: its SHA-256, its size in bytes, and the seconds since it was written."""

    sha256: str
    size: int
    age: float


# Whether the content with this SHA-256 was removed recently, or may be at any moment; called inside a transaction.
Removed = Callable[[str], bool]
# Publishes the files that a transaction names.
Publish = Callable[[Removed], None]


def publish_nothing(removed: Removed) -> None:
    """Publish nothing: the files are already published."""


class Files(Protocol):
    """Files under the SHA-256 of their bytes; safe for many processes, and after a crash.

    A file is written to a local temporary file first (:meth:`unfinished`), then sealed, then published inside the
    transaction that names it. A half-written file is never visible. Every method raises :class:`OSError` when the
    storage fails, :class:`~equimesh_service.errors.FilesError` when it cannot be reached or used, and
    :class:`FileNotFoundError` for a missing file.
    """

    def prepare(self, *, alone: bool) -> None:
        """Make the storage ready, check that files can be written and read, and remove unfinished files of a crash.

        ``alone`` says that no other service uses this folder: then all unfinished files are removed.
        """
        ...

    def tidy(self) -> None:
        """Remove files that a killed worker left unfinished hours ago."""
        ...

    def unfinished(self, suffix: str) -> AbstractContextManager[Path]:
        """A local temporary file, removed at the end if it is still there."""
        ...

    def seal(self, path: Path) -> StoredFile:
        """Move a finished file of :meth:`unfinished` to safe storage; no row names it yet.

        A sealed file that is never published may stay in :meth:`listing` until it is swept.
        """
        ...

    def publish(self, path: Path, file: StoredFile, removed: Removed) -> None:
        """Give a sealed file its name.

        Called inside the transaction that first names the file, so that no removal of the same content comes between.
        Fast, without a request to remote storage, unless the content was ``removed`` after the file was sealed.
        """
        ...

    def holds(self, file: StoredFile) -> bool:
        """Whether a published file is there, with all its bytes; its content is not read."""
        ...

    def require(self, sha256: str) -> None:
        """Raise :class:`FileNotFoundError` where a file is not there any more; its content is not read."""
        ...

    def local(self, sha256: str) -> AbstractContextManager[Path]:
        """A local path of the file, for the length of a ``with``; the file must not be changed."""
        ...

    def open_range(self, sha256: str, start: int, end: int) -> AsyncGenerator[bytes, None]:
        """The bytes from ``start`` up to ``end``, which is left out, in pieces of :data:`PIECE_BYTES` at most."""
        ...

    def remove(self, sha256: str) -> None:
        """Remove a file that no row names any more, if it is there."""
        ...

    def listing(self) -> Iterator[ListedFile]:
        """All files of the storage, in no order."""
        ...

    def check(self) -> None:
        """Raise :class:`OSError` when files cannot be written and read now."""
        ...


# The most bytes of a download in memory.
PIECE_BYTES = 1024 * 1024


def key_of(sha256: str) -> str:
    """The name of a file inside a folder or bucket; raises :class:`ValueError` for a text that is no SHA-256."""
    if not SHA256.fullmatch(sha256):
        raise ValueError(f"{sha256[:80]!r} is not a SHA-256 in hexadecimal")
    return f"{sha256[:2]}/{sha256}"


def digest_of(path: Path, *, sync: bool = False) -> StoredFile:
    """The SHA-256 and the size of a finished file; with ``sync`` the file is on disk afterwards."""
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
        size = file.tell()
        if sync:
            os.fsync(file.fileno())
    return StoredFile(digest, size)
