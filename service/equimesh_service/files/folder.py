"""Files in a folder."""

import os
import time
from collections.abc import AsyncGenerator, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from io import FileIO
from pathlib import Path

from anyio import to_thread

from equimesh_service.files.port import PIECE_BYTES, SHA256, ListedFile, Removed, StoredFile, digest_of, key_of
from equimesh_service.files.unfinished import clear, temporary


@dataclass(frozen=True)
class FolderFiles:
    """A folder of files under their SHA-256; see :class:`~equimesh_service.files.port.Files`.

    A file appears under its name only when it is whole and on disk: it is written under a temporary name,
    synced, then renamed.
    """

    folder: Path

    def prepare(self, *, alone: bool) -> None:
        """Make the folders, and clear what a crash left unfinished."""
        clear(self._unfinished, alone=alone)
        self.check()

    def tidy(self) -> None:
        """Clear what a killed worker left unfinished hours ago."""
        clear(self._unfinished, alone=False)

    def path(self, sha256: str) -> Path:
        """Where the file with this content is, or would be."""
        return self.folder / key_of(sha256)

    def unfinished(self, suffix: str) -> AbstractContextManager[Path]:
        """A temporary name in the same file system; whatever is left there at the end is removed."""
        return temporary(self._unfinished, suffix)

    def seal(self, path: Path) -> StoredFile:
        """Bring a finished file to disk; it still has its temporary name."""
        return digest_of(path, sync=True)

    def publish(self, path: Path, file: StoredFile, removed: Removed) -> None:  # noqa: ARG002
        """Rename a sealed file, on disk, too: whatever was there before, it is there now."""
        target = self.path(file.sha256)
        target.parent.mkdir(exist_ok=True)
        os.replace(path, target)
        _sync_folder(target.parent)

    @contextmanager
    def local(self, sha256: str) -> Iterator[Path]:
        """The file itself."""
        path = self.path(sha256)
        path.stat()
        yield path

    async def open_range(self, sha256: str, start: int, end: int) -> AsyncGenerator[bytes, None]:
        """The bytes from ``start`` up to ``end``; the file is open meanwhile, and so stays whole when removed."""
        path = self.path(sha256)
        with ExitStack() as stack:
            opened: list[FileIO] = []

            def read(size: int) -> bytes:
                if not opened:  # here, where it may take its time; the stack closes it whatever happens
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
        """Remove a file that nothing refers to any more."""
        self.path(sha256).unlink(missing_ok=True)

    def listing(self) -> Iterator[ListedFile]:
        """All files that are there."""
        now = time.time()
        for shelf in self.folder.iterdir():
            if len(shelf.name) != 2 or not shelf.is_dir():
                continue
            for entry in os.scandir(shelf):
                if SHA256.fullmatch(entry.name):
                    try:
                        found = entry.stat()
                    except FileNotFoundError:
                        continue  # removed at this moment
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
