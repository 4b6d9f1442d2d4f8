"""Files that appear whole or not at all."""

from __future__ import annotations

import hashlib
import os
import secrets
from pathlib import Path
from types import TracebackType
from typing import BinaryIO

from equimesh_client.errors import BadArgument, DownloadDamaged


class PendingFile:
    """A file under a temporary name beside ``path``; renamed to it by :meth:`commit`, removed otherwise.

    A context manager. Raises :class:`BadArgument` when the folder cannot be written.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._digest = hashlib.sha256()
        self._temporary = self.path.with_name(f".{self.path.name}.{secrets.token_hex(6)}.part")
        if self.path.is_dir():
            raise BadArgument(f"cannot write {self.path}: it is a folder")
        try:
            self._file: BinaryIO = self._temporary.open("xb")
        except OSError as error:
            raise BadArgument(f"cannot write {self.path}: {error.strerror or error}") from error

    def restart(self) -> None:
        """Throw away what was written: a download begins again."""
        self._file.seek(0)
        self._file.truncate()
        self._digest = hashlib.sha256()

    def write(self, chunk: bytes) -> None:
        """Append bytes."""
        self._file.write(chunk)
        self._digest.update(chunk)

    def commit(self, sha256: str | None) -> Path:
        """Give the file its name. Raises :class:`DownloadDamaged` when its sha256 is another than
        ``sha256``.
        """
        if sha256 is not None and sha256 != self._digest.hexdigest():
            raise DownloadDamaged(
                f"{self.path} was not written: the bytes received do not have the checksum that the service announced"
            )
        self._file.close()
        os.replace(self._temporary, self.path)
        return self.path

    def __enter__(self) -> PendingFile:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()
        self._temporary.unlink(missing_ok=True)


def write_atomically(path: str | Path, data: bytes) -> Path:
    """Write ``data`` to ``path`` under a temporary name and rename it; returns the path."""
    with PendingFile(path) as file:
        file.write(data)
        return file.commit(None)
