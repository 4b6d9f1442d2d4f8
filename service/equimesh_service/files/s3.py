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
from equimesh_service.files.folder import clear, temporary
from equimesh_service.files.port import PIECE_BYTES, SHA256, ListedFile, Removed, StoredFile, digest_of, key_of

if TYPE_CHECKING:
    from obstore.store import S3Config, S3Store

# The size of the parts of an upload; smaller files are uploaded at once.
_PART_BYTES = 8 * 1024 * 1024
# The most parts of one upload in memory.
_MAX_PARTS_IN_MEMORY = 2
_PROBE = "probe"
_NONE = SecretStr("")
# Words in the errors of servers whose storage is full.
_FULL = ("StorageFull", "QuotaExceeded", "InsufficientCapacity", "507 Insufficient Storage")


@dataclass(frozen=True, kw_only=True)
class Bucket:
    """The address of a bucket and its key; without a key, obstore finds the credentials of AWS."""

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

    ``folder`` is a local folder for temporary files. A file is uploaded when it is sealed: S3 shows an object only when
    it is complete and its checksum is right, and no row names it before it is published. An upload whose transaction is
    undone stays until it is swept.
    """

    bucket: Bucket
    folder: Path

    def prepare(self, *, alone: bool) -> None:
        """Check that objects can be written, listed, read and removed; remove unfinished files of a crash."""
        import obstore

        clear(self._unfinished, alone=alone)
        with self._translate_errors():
            # A wrong bucket and an empty one look alike, so an object is written and read back. Its name is random:
            # services that start together would remove each other's.
            name = f"{_PROBE}-{secrets.token_hex(8)}"
            obstore.put(self._store, name, b"ok")
            if bytes(obstore.get(self._store, name).bytes()) != b"ok":
                raise FilesError(f"{self.bucket} does not give back what was written to it")
            obstore.delete(self._store, name)
        self.check()

    def tidy(self) -> None:
        """Remove files that a killed worker left unfinished hours ago."""
        clear(self._unfinished, alone=False)

    def unfinished(self, suffix: str) -> AbstractContextManager[Path]:
        """A local temporary file, removed at the end if it is still there."""
        return temporary(self._unfinished, suffix)

    def seal(self, path: Path) -> StoredFile:
        """Upload a finished file under its SHA-256."""
        file = digest_of(path)
        self._upload(path, file)
        return file

    def publish(self, path: Path, file: StoredFile, removed: Removed) -> None:
        """Do nothing, as the file is uploaded; if the same content may have been removed, check, and upload again."""
        if removed(file.sha256) and not self.holds(file):
            self._upload(path, file)

    def holds(self, file: StoredFile) -> bool:
        """Whether the object is there, with all its bytes."""
        import obstore

        try:
            with self._translate_errors():
                size: int = obstore.head(self._store, key_of(file.sha256))["size"]
        except FileNotFoundError:
            return False
        return size == file.size

    def require(self, sha256: str) -> None:
        """Raise :class:`FileNotFoundError` where the object is not there any more."""
        import obstore

        with self._translate_errors():
            obstore.head(self._store, key_of(sha256))

    @contextmanager
    def local(self, sha256: str) -> Iterator[Path]:
        """A copy of the file, whose content is checked."""
        import obstore

        with self.unfinished(".copy") as path:
            digest = hashlib.sha256()
            with self._translate_errors(), path.open("wb") as copy:
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
        """The bytes from ``start`` up to ``end``.

        Each piece is a request of its own: with a slow reader none lasts long, and a lost one is repeated.
        """
        import obstore

        key = key_of(sha256)
        while start < end:
            with self._translate_errors():
                piece = bytes(
                    await obstore.get_range_async(self._store, key, start=start, end=min(start + PIECE_BYTES, end))
                )
            if not piece:
                raise EOFError(f"{sha256} ends at {start}, before {end}")
            start += len(piece)
            yield piece

    def remove(self, sha256: str) -> None:
        """Remove an object that no row names any more. Gives up soon, since a transaction waits."""
        import obstore

        with self._translate_errors():
            try:
                obstore.delete(_open_store(self.bucket, patient=False), key_of(sha256))
            except FileNotFoundError:
                return

    def listing(self) -> Iterator[ListedFile]:
        """All objects of the bucket."""
        import obstore

        now = datetime.now(UTC)
        with self._translate_errors():
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
        with self._translate_errors():
            next(iter(obstore.list(_open_store(self.bucket, patient=False), prefix=_PROBE, chunk_size=1)), None)

    def _upload(self, path: Path, file: StoredFile) -> None:
        import obstore

        with self._translate_errors():
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
        return _open_store(self.bucket)

    @property
    def _unfinished(self) -> Path:
        return self.folder / "unfinished"

    @contextmanager
    def _translate_errors(self) -> Iterator[None]:
        """Turn the errors of obstore into plain ones: its own messages quote requests, and answers of servers."""
        from obstore.exceptions import BaseError, PermissionDeniedError, UnauthenticatedError

        try:
            yield
        except FileNotFoundError as error:
            if "NoSuchBucket" in str(error):
                raise self._no_bucket() from None
            raise FileNotFoundError(errno.ENOENT, "there is no such object in the bucket") from None
        except (PermissionDeniedError, UnauthenticatedError):
            remedy = "see EQUIMESH_S3_ACCESS_KEY, EQUIMESH_S3_SECRET_KEY, EQUIMESH_S3_REGION and the key's rights"
            raise FilesError(f"{self.bucket} does not take the key: {remedy}") from None
        except BaseError as error:
            if "NoSuchBucket" in str(error):
                raise self._no_bucket() from None
            if any(word in str(error) for word in _FULL):
                raise OSError(errno.ENOSPC, "the S3 storage is full") from None
            raise FilesError(f"{self.bucket} does not answer as S3 storage does: see EQUIMESH_S3_ENDPOINT") from None

    def _no_bucket(self) -> FilesError:
        return FilesError(f"there is no bucket {self.bucket}: make it, or correct EQUIMESH_FILES_URL")


@lru_cache(maxsize=8)
def _open_store(bucket: Bucket, *, patient: bool = True) -> S3Store:
    """The client of a bucket, cached since it keeps its connections; without ``patient`` it gives up within 20 s."""
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
            "timeout": "60s" if patient else "10s",  # of one request, which carries at most a part of a file
        },
        retry_config={
            "max_retries": 3 if patient else 1,  # a kept connection may have been closed
            "retry_timeout": timedelta(seconds=10),
            "backoff": {"init_backoff": timedelta(milliseconds=50), "max_backoff": timedelta(seconds=2), "base": 2},
        },
    )
