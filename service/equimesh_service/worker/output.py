"""The files of a mesh that a worker writes, before they are published."""

import contextvars
import json
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from equimesh_service.files.port import Files, Removed, StoredFile
from equimesh_service.store.rows import Artifact

# Larger files are read from the storage for the answer, piece by piece.
MAX_CONTENT_BYTES = 1024 * 1024


class Output:
    """Files that are written but not yet published; with ``in_threads`` each in a thread of its own."""

    def __init__(self, files: Files, stack: ExitStack, *, in_threads: bool) -> None:
        self._files = files
        self._stack = stack
        self._in_threads = in_threads
        self._names: list[str] = []
        self._sealed: list[tuple[Path, Callable[[], StoredFile]]] = []

    def json(self, name: str, value: Any) -> None:
        """Write a JSON document."""
        self.write(name, ".json", lambda path: path.write_text(json.dumps(value, allow_nan=False)))

    def write(self, name: str, suffix: str, write: Callable[[Path], object]) -> None:
        """Write a file by ``write``."""
        path = self._stack.enter_context(self._files.unfinished(suffix))

        def seal() -> StoredFile:
            write(path)
            return self._files.seal(path)

        self._names.append(name)
        self._sealed.append((path, self._begin(seal) if self._in_threads else _run_now(seal)))

    def _begin(self, seal: Callable[[], StoredFile]) -> Callable[[], StoredFile]:
        # The thread is joined before its file is removed, also on failure.
        thread = self._stack.enter_context(ThreadPoolExecutor(1))
        try:
            return thread.submit(contextvars.copy_context().run, seal).result
        except RuntimeError:  # there is no memory for a thread; there may be enough without one
            return _run_now(seal)

    def artifacts(self) -> list[Artifact]:
        """All files, once they are written."""
        files = [sealed() for _, sealed in self._sealed]
        return [Artifact(name, file.sha256, file.size) for name, file in zip(self._names, files, strict=True)]

    def small_content(self, name: str) -> bytes | None:
        """The bytes of a written file when they are few; None for a large file, and for one that was not written."""
        for written, (path, sealed) in zip(self._names, self._sealed, strict=True):
            if written == name and sealed().size <= MAX_CONTENT_BYTES:
                return path.read_bytes()
        return None

    def publish(self, removed: Removed) -> None:
        """Publish all files."""
        for path, sealed in self._sealed:
            self._files.publish(path, sealed(), removed)


def _run_now(seal: Callable[[], StoredFile]) -> Callable[[], StoredFile]:
    file = seal()
    return lambda: file
