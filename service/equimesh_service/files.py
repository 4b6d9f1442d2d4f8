"""Files on disk: written once, named by their content, never changed."""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class StoredFile:
    """A file of the store: the SHA-256 of its bytes, in hexadecimal, and their number."""

    sha256: str
    size: int


@dataclass(frozen=True)
class FileStore:
    """A folder of files under their SHA-256; safe for many processes, and after a crash.

    A file appears under its name only when it is whole and on disk: it is written under a temporary name,
    synced, then renamed.
    """

    folder: Path

    def prepare(self) -> None:
        """Make the folders, and clear what a crash left unfinished."""
        self._unfinished.mkdir(parents=True, exist_ok=True)
        for left in self._unfinished.iterdir():
            if left.is_file():
                left.unlink(missing_ok=True)

    def path(self, sha256: str) -> Path:
        """Where the file with this content is, or would be."""
        return self.folder / sha256[:2] / sha256

    def seal(self, path: Path) -> StoredFile:
        """Bring a finished file of :meth:`unfinished` to disk; it still has its temporary name."""
        with path.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
            size = file.tell()
            os.fsync(file.fileno())
        return StoredFile(digest, size)

    def publish(self, path: Path, file: StoredFile) -> None:
        """Give a sealed file its name. Done inside the transaction that first refers to it, so that nobody
        who removes the same content for another mesh can remove it in between."""
        target = self.path(file.sha256)
        target.parent.mkdir(exist_ok=True)
        os.replace(path, target)
        _sync_folder(target.parent)

    @contextmanager
    def unfinished(self, suffix: str) -> Iterator[Path]:
        """A temporary name in the same file system; whatever is left there at the end is removed."""
        number, name = tempfile.mkstemp(suffix=suffix, dir=self._unfinished)
        os.close(number)
        path = Path(name)
        try:
            yield path
        finally:
            path.unlink(missing_ok=True)

    def remove(self, sha256: str) -> None:
        """Remove a file that nothing refers to any more."""
        self.path(sha256).unlink(missing_ok=True)

    def check(self) -> None:
        """Raise :class:`OSError` when files cannot be written."""
        with self.unfinished(".probe") as path:
            path.write_bytes(b"ok")

    @property
    def _unfinished(self) -> Path:
        return self.folder / "unfinished"


def _sync_folder(folder: Path) -> None:
    if os.name == "nt":  # pragma: no cover - folders cannot be opened there
        return
    number = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(number)
    finally:
        os.close(number)
