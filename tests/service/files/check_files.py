"""The contract of the files port; each check gets prepared and empty files."""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import os
import pickle
import random
from pathlib import Path

import pytest

from equimesh_service.files.port import PIECE_BYTES, Files, ListedFile, StoredFile
from equimesh_service.store.blobs import BlobFiles

# Larger than one part of an upload, and one piece of a download.
MIN_POINTS_FOR_THREADS = random.Random(1).randbytes(20_000_001)


def keep(files: Files, content: bytes) -> StoredFile:
    """Write, seal and publish a file."""
    with files.unfinished(".bin") as path:
        path.write_bytes(content)
        file = files.seal(path)
        files.publish(path, file, lambda _: False)
    return file


def read(files: Files, sha256: str) -> bytes:
    """The bytes of a file, as a worker reads them."""
    with files.local(sha256) as path:
        return path.read_bytes()


def read_range(files: Files, sha256: str, start: int, end: int) -> list[bytes]:
    """Bytes of a file, as they are sent."""

    async def pieces() -> list[bytes]:
        return [piece async for piece in files.open_range(sha256, start, end)]

    return asyncio.run(pieces())


def unfinished(folder: Path) -> list[Path]:
    """The temporary files that are left."""
    return list((folder / "unfinished").iterdir())


def check_life(files: Files, folder: Path) -> None:
    """A file exists from its publication to its removal, complete, under its SHA-256."""
    content = b"a mesh"
    file = keep(files, content)
    assert file == StoredFile(hashlib.sha256(content).hexdigest(), len(content))
    assert read(files, file.sha256) == content
    assert b"".join(read_range(files, file.sha256, 2, 5)) == b"mes"
    [listed] = files.listing()
    assert listed == ListedFile(file.sha256, 6, listed.age)
    assert -2.0 < listed.age < 60.0
    assert keep(files, content) == file  # the same for another mesh
    assert files.holds(file)
    files.require(file.sha256)
    assert not files.holds(StoredFile(file.sha256, file.size + 1))
    files.remove(file.sha256)
    files.remove(file.sha256)
    assert list(files.listing()) == []
    assert not files.holds(file)
    with pytest.raises(FileNotFoundError):
        files.require(file.sha256)
    with pytest.raises(FileNotFoundError):
        read(files, file.sha256)
    with pytest.raises(FileNotFoundError):
        read_range(files, file.sha256, 0, 6)
    files.check()
    assert unfinished(folder) == []


def check_large(files: Files, folder: Path) -> None:
    """A large file is the same afterwards, and comes in pieces of a bounded size."""
    file = keep(files, MIN_POINTS_FOR_THREADS)
    assert read(files, file.sha256) == MIN_POINTS_FOR_THREADS
    pieces = read_range(files, file.sha256, 7, len(MIN_POINTS_FOR_THREADS) - 1)
    assert b"".join(pieces) == MIN_POINTS_FOR_THREADS[7:-1]
    assert max(map(len, pieces)) <= PIECE_BYTES
    assert unfinished(folder) == []


def check_undone(files: Files, folder: Path) -> None:
    """A sealed file that is not published can be swept, and is uploaded again when it is published after all."""
    with files.unfinished(".bin") as path:
        path.write_bytes(b"undone")
        file = files.seal(path)
    assert all(left.sha256 == file.sha256 for left in files.listing())
    files.remove(file.sha256)
    assert list(files.listing()) == []
    with files.unfinished(".bin") as path:
        path.write_bytes(b"undone")
        files.seal(path)
        files.remove(file.sha256)  # another mesh of the same content was deleted at this moment
        files.publish(path, file, lambda sha256: sha256 == file.sha256)
    assert read(files, file.sha256) == b"undone"
    with contextlib.suppress(RuntimeError), files.unfinished(".bin") as path:
        path.write_bytes(b"half")
        raise RuntimeError
    assert unfinished(folder) == []


def check_leftovers(files: Files, folder: Path) -> None:
    """What a crash left unfinished is cleared: at once when nobody else writes here, else when it is old."""
    old, new = folder / "unfinished" / "old", folder / "unfinished" / "new"
    for path in (old, new):
        path.write_bytes(b"half")
    os.utime(old, (0.0, 0.0))
    files.tidy()
    assert unfinished(folder) == [new]
    os.utime(new, (0.0, 0.0))
    files.prepare(alone=False)
    assert unfinished(folder) == []
    new.write_bytes(b"half")
    files.prepare(alone=True)
    assert unfinished(folder) == []
    assert list(files.listing()) == []


def check_names(files: Files, folder: Path) -> None:
    """Nothing but a SHA-256 names a file."""
    (folder / "secret").write_bytes(b"x")
    for name in ("../secret", "", "ab", "A" * 64, "0" * 63 + "/", f"{'0' * 64}\n"):
        with pytest.raises(ValueError, match="SHA-256"):
            read(files, name)
        with pytest.raises(ValueError, match="SHA-256"):
            read_range(files, name, 0, 1)
        with pytest.raises(ValueError, match="SHA-256"):
            files.remove(name)


def check_copies(files: Files, folder: Path) -> None:
    """A worker's copy of the record opens the same files, and tells no secret; a worker opens the rows itself."""
    if isinstance(files, BlobFiles):
        files = files.larger
    file = keep(files, b"shared")
    copy: Files = pickle.loads(pickle.dumps(files))
    assert (copy, hash(copy)) == (files, hash(files))
    assert read(copy, file.sha256) == b"shared"
    assert "test-secret" not in f"{files!r} {files}"
    assert folder.is_dir()


CHECKS = (check_life, check_large, check_undone, check_leftovers, check_names, check_copies)
