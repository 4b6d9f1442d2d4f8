"""Small files as rows of the database, in front of a folder or a bucket for the larger ones."""

from __future__ import annotations

import logging
from collections.abc import AsyncGenerator, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, aclosing, contextmanager
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

from anyio import to_thread
from sqlalchemy import Row, bindparam, delete, select

from equimesh_service.files.port import Files, ListedFile, Removed, StoredFile, digest_of, key_of
from equimesh_service.store.database import Database, insert_new
from equimesh_service.store.prepared import Prepared
from equimesh_service.store.schema import blobs

_log = logging.getLogger(__name__)
# Files of up to so many bytes are rows.
MAX_ROW_BYTES = 1024 * 1024
# Rows that are listed by one query.
_LISTED_AT_ONCE = 1000
# Statements are built once, since building them takes longer than executing them.
_HERE = blobs.c.sha256 == bindparam("file")
_READ = select(blobs.c.content).where(_HERE)
_MEASURE = Prepared(select(blobs.c.size).where(_HERE))
_DELETE = Prepared(delete(blobs).where(_HERE))
_LIST = (
    select(blobs.c.sha256, blobs.c.size, blobs.c.created_at)
    .where(blobs.c.sha256 > bindparam("after"))
    .order_by(blobs.c.sha256)
    .limit(bindparam("most"))
)


def insert_blob(database: Database, sha256: str, content: bytes) -> None:
    """Insert the bytes of a small file, unless they are there; in the transaction that first names it."""
    with database.join() as connection:
        row = {"sha256": sha256, "size": len(content), "created_at": database.clock(), "content": content}
        insert_new(connection, blobs, row)


@dataclass(frozen=True)
class BlobFiles:
    """Files up to 1 MiB in rows, others in ``larger``; see :class:`~equimesh_service.files.port.Files`.

    A row is written and removed in the transaction that it is called in, so it needs no sync of its own: what names
    the file and the file itself are committed together. Files of earlier releases are read where they are. Small files
    that are ``not_stored`` yet, by their SHA-256, are read as if they were.
    """

    database: Database
    larger: Files
    not_stored: Mapping[str, bytes] = field(default_factory=dict)

    def prepare(self, *, alone: bool) -> None:
        """Make the storage of larger files ready."""
        self.larger.prepare(alone=alone)

    def tidy(self) -> None:
        """Remove files that a killed worker left unfinished hours ago."""
        self.larger.tidy()

    def unfinished(self, suffix: str) -> AbstractContextManager[Path]:
        """A local temporary file, removed at the end if it is still there."""
        return self.larger.unfinished(suffix)

    def seal(self, path: Path) -> StoredFile:
        """The digest of a small file, which is safe when it is published; a larger one is safe afterwards."""
        return digest_of(path) if path.stat().st_size <= MAX_ROW_BYTES else self.larger.seal(path)

    def publish(self, path: Path, file: StoredFile, removed: Removed) -> None:
        """Insert a small file; give a larger one its name."""
        if file.size <= MAX_ROW_BYTES:
            insert_blob(self.database, file.sha256, path.read_bytes())
        else:
            self.larger.publish(path, file, removed)

    def holds(self, file: StoredFile) -> bool:
        """Whether a published file is there, with all its bytes."""
        with self.database.read() as connection:
            size = _MEASURE.execute(connection, {"file": file.sha256}).scalar()
        return size == file.size if size is not None else self.larger.holds(file)

    def require(self, sha256: str) -> None:
        """Raise :class:`FileNotFoundError` where a file is not there any more."""
        if sha256 in self.not_stored:
            return
        with self.database.read() as connection:
            size = _MEASURE.execute(connection, {"file": sha256}).scalar()
        if size is None:
            self.larger.require(sha256)

    @contextmanager
    def local(self, sha256: str) -> Iterator[Path]:
        """A temporary copy of a small file; a larger one as its storage gives it."""
        content = self._read(sha256)
        if content is None:
            with self.larger.local(sha256) as path:
                yield path
            return
        with self.unfinished(".copy") as path:
            path.write_bytes(content)
            yield path

    @contextmanager
    def opened(self, sha256: str) -> Iterator[BinaryIO]:
        """The file, to be read from its begin: a small one from memory, without a temporary copy."""
        content = self._read(sha256)
        if content is not None:
            yield BytesIO(content)
            return
        with self.larger.local(sha256) as path, path.open("rb") as stream:
            yield stream

    async def open_range(self, sha256: str, start: int, end: int) -> AsyncGenerator[bytes, None]:
        """The bytes from ``start`` up to ``end``. A small file comes in one piece."""
        content = await to_thread.run_sync(self._read, sha256)
        if content is None:
            async with aclosing(self.larger.open_range(sha256, start, end)) as pieces:
                async for piece in pieces:
                    yield piece
        elif len(content) < end:
            raise EOFError(f"{sha256} ends at {len(content)}, before {end}")
        else:
            yield content[start:end]

    def remove(self, sha256: str) -> None:
        """Remove a file that no row names any more; a copy in the other storage is swept up later."""
        key_of(sha256)  # refuses what is no SHA-256
        with self.database.join() as connection:
            removed = _DELETE.execute(connection, {"file": sha256}).rowcount
        if not removed:
            self.larger.remove(sha256)

    def discard(self, sha256: str) -> None:
        """Remove a file that no row names any more; if that fails, the next sweep removes it."""
        try:
            self.remove(sha256)
        except OSError as error:
            _log.warning("file %s was not removed, the next sweep will try again: %s", sha256, type(error).__name__)

    def listing(self) -> Iterator[ListedFile]:
        """All files of both storages."""
        now, rows = self.database.clock(), self._rows_after("")
        while rows:
            for row in rows:
                yield ListedFile(row.sha256, row.size, now - row.created_at)
            rows = self._rows_after(rows[-1].sha256)
        yield from self.larger.listing()

    def check(self) -> None:
        """Raise :class:`OSError` when larger files cannot be written now."""
        self.larger.check()

    def _rows_after(self, last: str) -> Sequence[Row[Any, Any, Any]]:
        with self.database.read() as connection:
            return connection.execute(_LIST, {"after": last, "most": _LISTED_AT_ONCE}).all()

    def _read(self, sha256: str) -> bytes | None:
        key_of(sha256)  # refuses what is no SHA-256
        if sha256 in self.not_stored:
            return self.not_stored[sha256]
        with self.database.read() as connection:
            content = connection.execute(_READ, {"file": sha256}).scalar()
        return None if content is None else bytes(content)
