"""Files in a folder that its own user alone may read, and the temporary files that they are first."""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from collections.abc import AsyncGenerator, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from io import FileIO
from pathlib import Path

from anyio import to_thread

from equimesh_service.files.port import PIECE_BYTES, SHA256, ListedFile, Removed, StoredFile, digest_of, key_of

# Permissions that no new file gives: all of the group's and of the others'.
_WITHHELD = 0o077
# Permissions of a new data folder: all of its owner's, none of the others'.
_FOLDER_MODE = 0o700


def withhold_files() -> None:
    """Let every file that this process and its workers make from now on be readable by their user only.

    For commands. A service in a thread of another program leaves the files of that program alone.
    """
    os.umask(os.umask(_WITHHELD) | _WITHHELD)


def make_folder(path: Path) -> None:
    """Make a folder that only its owner may enter, unless it exists; an existing one keeps its permissions."""
    path.mkdir(mode=_FOLDER_MODE, parents=True, exist_ok=True)


# Older files were left by a crash; younger ones another service may still be writing.
_LEFT_OVER_SECONDS = 6 * 3600.0


def clear(folder: Path, *, alone: bool) -> None:
    """Make the folder, and remove leftover files: all when ``alone``, otherwise those that are hours old."""
    folder.mkdir(parents=True, exist_ok=True)
    for left in folder.iterdir():
        try:
            old = alone or time.time() - left.stat().st_mtime > _LEFT_OVER_SECONDS
        except FileNotFoundError:
            continue  # another service has just removed it
        if old and left.is_dir():  # writers of several files work in a folder of their own
            shutil.rmtree(left, ignore_errors=True)
        elif old:
            left.unlink(missing_ok=True)


@contextmanager
def temporary(folder: Path, suffix: str) -> Iterator[Path]:
    """A new empty file, removed at the end if it is still there."""
    number, name = tempfile.mkstemp(suffix=suffix, dir=folder)
    os.close(number)
    path = Path(name)
    try:
        yield path
    finally:
        path.unlink(missing_ok=True)


@dataclass(frozen=True)
class FolderFiles:
    """A folder of files under their SHA-256; see :class:`~equimesh_service.files.port.Files`.

    A file is written under a temporary name, synced to disk, then renamed: under its name it is always complete.
    """

    folder: Path

    def prepare(self, *, alone: bool) -> None:
        """Make the folders, and remove unfinished files of a crash."""
        clear(self._unfinished, alone=alone)
        self.check()

    def tidy(self) -> None:
        """Remove files that a killed worker left unfinished hours ago."""
        clear(self._unfinished, alone=False)

    def path(self, sha256: str) -> Path:
        """The path of the file with this content, whether it exists or not."""
        return self.folder / key_of(sha256)

    def unfinished(self, suffix: str) -> AbstractContextManager[Path]:
        """A temporary file in the same file system, removed at the end if it is still there."""
        return temporary(self._unfinished, suffix)

    def seal(self, path: Path) -> StoredFile:
        """Sync a finished file to disk; it keeps its temporary name."""
        return digest_of(path, sync=True)

    def publish(self, path: Path, file: StoredFile, removed: Removed) -> None:  # noqa: ARG002
        """Rename a sealed file, and sync the folder."""
        target = self.path(file.sha256)
        target.parent.mkdir(exist_ok=True)
        os.replace(path, target)
        _sync_folder(target.parent)

    def holds(self, file: StoredFile) -> bool:
        """Whether the file is there, with all its bytes."""
        try:
            return self.path(file.sha256).stat().st_size == file.size
        except FileNotFoundError:
            return False

    def require(self, sha256: str) -> None:
        """Raise :class:`FileNotFoundError` where the file is not there any more."""
        self.path(sha256).stat()

    @contextmanager
    def local(self, sha256: str) -> Iterator[Path]:
        """The file itself."""
        self.require(sha256)
        yield self.path(sha256)

    async def open_range(self, sha256: str, start: int, end: int) -> AsyncGenerator[bytes, None]:
        """The bytes from ``start`` up to ``end``; the file stays open, so that it can be removed in the meantime."""
        path = self.path(sha256)
        with ExitStack() as stack:
            opened: list[FileIO] = []

            def read(size: int) -> bytes:
                if not opened:  # in this thread, since it may block; the stack closes it
                    opened.append(stack.enter_context(path.open("rb", buffering=0)))
                    opened[0].seek(start)
                return opened[0].read(size)

            while start < end:
                piece = await to_thread.run_sync(read, min(PIECE_BYTES, end - start))
                if not piece:
                    raise EOFError(f"{path.name} ends at {start}, before {end}")
                start += len(piece)
                yield piece

    def remove(self, sha256: str) -> None:
        """Remove a file that no row names any more."""
        self.path(sha256).unlink(missing_ok=True)

    def listing(self) -> Iterator[ListedFile]:
        """All files in the folder."""
        now = time.time()
        for shelf in self.folder.iterdir():
            if len(shelf.name) != 2 or not shelf.is_dir():
                continue
            for entry in os.scandir(shelf):
                if SHA256.fullmatch(entry.name):
                    try:
                        found = entry.stat()
                    except FileNotFoundError:
                        continue  # removed just now
                    yield ListedFile(entry.name, found.st_size, now - found.st_mtime)

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
