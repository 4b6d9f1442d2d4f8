"""Files in a bucket of S3-compatible storage, through obstore (`pip install 'equimesh[s3]'`)."""

from __future__ import annotations

import errno
import hashlib
import secrets
from collections.abc import AsyncGenerator, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import SecretStr

from equimesh_service.errors import FilesError
from equimesh_service.files.port import PIECE_BYTES, SHA256, ListedFile, Removed, StoredFile, digest_of, key_of
from equimesh_service.files.unfinished import clear, temporary

if TYPE_CHECKING:
    from obstore.store import S3Config, S3Store

# Larger files are uploaded in parts of this size.
_PART_BYTES = 8 * 1024 * 1024
# Parts of one upload that are in memory at a time.
_MAX_PARTS_IN_MEMORY = 2
_PROBE = "probe"
_NONE = SecretStr("")
# The words of servers whose storage is full.
_FULL = ("StorageFull", "QuotaExceeded", "InsufficientCapacity", "507 Insufficient Storage")


@dataclass(frozen=True, kw_only=True)
class Bucket:
    """Where a bucket is, and the key to it; without one, obstore looks for the credentials that AWS gives."""

    name: str
    prefix: str = ""
    endpoint: str = ""
    region: str = "us-east-1"
    access_key: SecretStr = _NONE
    secret_key: SecretStr = _NONE

    def __str__(self) -> str:
        place = f" at {self.endpoint}" if self.endpoint else ""
        return f"s3://{self.name}{'/' if self.prefix else ''}{self.prefix}{place}"


@dataclass(frozen=True)
class S3Files:
    """A bucket of files under their SHA-256; see :class:`~equimesh_service.files.port.Files`.

    ``folder`` is a local one for temporary files. Sealing uploads: S3 shows an object only when all of it has come
    and its checksum is right, and nothing refers to it before it is published. An upload whose transaction is
    undone stays, unnamed, until it is swept.
    """

    bucket: Bucket
    folder: Path

    def prepare(self, *, alone: bool) -> None:
        """See that objects can be written, listed, read and removed; clear what a crash left unfinished."""
        import obstore

        clear(self._unfinished, alone=alone)
        with self._asking():
            # A file would be missing for a wrong bucket and an empty one alike, so a real one goes there and back.
            # Its name is no other's: services that start together would take it away from each other.
            name = f"{_PROBE}-{secrets.token_hex(8)}"
            obstore.put(self._store, name, b"ok")
            if bytes(obstore.get(self._store, name).bytes()) != b"ok":
                raise FilesError(f"{self.bucket} does not give back what was written to it")
            obstore.delete(self._store, name)
        self.check()

    def tidy(self) -> None:
        """Clear what a killed worker left unfinished hours ago."""
        clear(self._unfinished, alone=False)

    def unfinished(self, suffix: str) -> AbstractContextManager[Path]:
        """A local temporary file; whatever is left there at the end is removed."""
        return temporary(self._unfinished, suffix)

    def seal(self, path: Path) -> StoredFile:
        """Upload a finished file under the name that its content gives it."""
        file = digest_of(path)
        self._upload(path, file)
        return file

    def publish(self, path: Path, file: StoredFile, removed: Removed) -> None:
        """Do nothing, since the file is there; if somebody removed the same content, see whether, and upload again."""
        import obstore

        if not removed(file.sha256):
            return
        try:
            with self._asking():
                there = obstore.head(self._store, key_of(file.sha256))["size"]
        except FileNotFoundError:
            there = -1
        if there != file.size:
            self._upload(path, file)

    @contextmanager
    def local(self, sha256: str) -> Iterator[Path]:
        """A copy of the file, whose content is checked."""
        import obstore

        with self.unfinished(".copy") as path:
            digest = hashlib.sha256()
            with self._asking(), path.open("wb") as copy:
                key = key_of(sha256)
                size = obstore.head(self._store, key)["size"]
                for start in range(0, size, _PART_BYTES):
                    piece = obstore.get_range(self._store, key, start=start, end=min(start + _PART_BYTES, size))
                    digest.update(piece)
                    copy.write(piece)
            if digest.hexdigest() != sha256:
                raise FilesError(f"the object {key_of(sha256)} of {self.bucket} is damaged")
            yield path

    async def open_range(self, sha256: str, start: int, end: int) -> AsyncGenerator[bytes, None]:
        """The bytes from ``start`` up to ``end``. Each piece is a request of its own: however slow the reader is,
        none lasts long, and one that is lost is requested again."""
        import obstore

        key = key_of(sha256)
        while start < end:
            with self._asking():
                piece = bytes(
                    await obstore.get_range_async(self._store, key, start=start, end=min(start + PIECE_BYTES, end))
                )
            if not piece:
                raise EOFError(f"{sha256} ends at {start}, before {end}")
            start += len(piece)
            yield piece

    def remove(self, sha256: str) -> None:
        """Remove an object that nothing refers to any more, soon or not at all: a transaction waits."""
        import obstore

        with self._asking():
            try:
                obstore.delete(_opened(self.bucket, patient=False), key_of(sha256))
            except FileNotFoundError:
                return

    def listing(self) -> Iterator[ListedFile]:
        """All objects that are there."""
        import obstore

        now = datetime.now(UTC)
        with self._asking():
            for page in obstore.list(self._store):
                for found in page:
                    name = found["path"].rpartition("/")[2]
                    if SHA256.fullmatch(name):
                        yield ListedFile(name, found["size"], (now - found["last_modified"]).total_seconds())

    def check(self) -> None:
        """Raise :class:`OSError` when the bucket does not answer, or no temporary file can be written."""
        import obstore

        with self.unfinished(".probe") as path:
            path.write_bytes(b"ok")
        with self._asking():
            next(iter(obstore.list(_opened(self.bucket, patient=False), prefix=_PROBE, chunk_size=1)), None)

    def _upload(self, path: Path, file: StoredFile) -> None:
        import obstore

        with self._asking():
            obstore.put(
                self._store,
                key_of(file.sha256),
                path,
                use_multipart=file.size > _PART_BYTES,
                chunk_size=_PART_BYTES,
                max_concurrency=_MAX_PARTS_IN_MEMORY,
            )

    @property
    def _store(self) -> S3Store:
        return _opened(self.bucket)

    @property
    def _unfinished(self) -> Path:
        return self.folder / "unfinished"

    @contextmanager
    def _asking(self) -> Iterator[None]:
        """Say in a sentence what obstore raises: its own messages quote requests, and answers of servers."""
        from obstore.exceptions import BaseError, PermissionDeniedError, UnauthenticatedError

        try:
            yield
        except FileNotFoundError as error:
            if "NoSuchBucket" in str(error):
                raise FilesError(f"there is no bucket {self.bucket}: make it, or correct EQUIMESH_FILES_URL") from None
            raise FileNotFoundError(errno.ENOENT, "there is no such object in the bucket") from None
        except (PermissionDeniedError, UnauthenticatedError):
            remedy = "see EQUIMESH_S3_ACCESS_KEY, EQUIMESH_S3_SECRET_KEY, EQUIMESH_S3_REGION and the key's rights"
            raise FilesError(f"{self.bucket} does not take the key: {remedy}") from None
        except BaseError as error:
            said = str(error)
            if "NoSuchBucket" in said:
                raise FilesError(f"there is no bucket {self.bucket}: make it, or correct EQUIMESH_FILES_URL") from None
            if any(word in said for word in _FULL):
                raise OSError(errno.ENOSPC, "the S3 storage is full") from None
            raise FilesError(f"{self.bucket} does not answer as S3 storage does: see EQUIMESH_S3_ENDPOINT") from None


@lru_cache(maxsize=8)
def _opened(bucket: Bucket, *, patient: bool = True) -> S3Store:
    """The client of a bucket, once in each process: it keeps its connections. One that is not ``patient`` gives up
    within 20 s."""
    from obstore.store import S3Store

    config: S3Config = {
        "region": bucket.region,
        "checksum_algorithm": "SHA256",  # of every upload, checked where it arrives
    }
    if bucket.endpoint:
        config["endpoint"] = bucket.endpoint
    if bucket.access_key:
        config["access_key_id"] = bucket.access_key.get_secret_value()
        config["secret_access_key"] = bucket.secret_key.get_secret_value()
    return S3Store(
        bucket.name,
        prefix=bucket.prefix or None,
        config=config,
        client_options={
            "allow_http": bucket.endpoint.startswith("http://"),
            "connect_timeout": "5s",
            "timeout": "60s" if patient else "10s",  # of one request, which carries a part of a file at most
        },
        retry_config={
            "max_retries": 3 if patient else 1,  # a kept connection may have been closed
            "retry_timeout": timedelta(seconds=10),
            "backoff": {"init_backoff": timedelta(milliseconds=50), "max_backoff": timedelta(seconds=2), "base": 2},
        },
    )
