"""Downloads that continue where they broke off, in memory or in a part next to the final file."""

from __future__ import annotations

import glob
import hashlib
import io
import os
import re
import secrets
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

from equimesh_client.errors import BadArgument, DownloadDamaged
from equimesh_client.wire.protocol import Reply, continues, resumable, sha256_of


def write_atomically(path: str | Path, data: bytes) -> Path:
    """Write ``data`` to ``path`` under a temporary name and rename it; returns the path.

    Raises :class:`BadArgument` when the file cannot be written.
    """
    path = Path(path)
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(6)}.part")
    if path.is_dir():
        raise BadArgument(f"cannot write {path}: it is a folder")
    try:
        temporary.write_bytes(data)
        os.replace(temporary, path)
    except OSError as error:
        raise BadArgument(f"cannot write {path}: {error.strerror or error}") from error
    finally:
        temporary.unlink(missing_ok=True)
    return path


PARTS = ("mesh", "facets")
# The files of an OpenFOAM mesh, below the folder of a case; the one that the others are numbered by comes last.
FOAM_FILES = tuple(f"constant/polyMesh/{name}" for name in ("boundary", "neighbour", "owner", "faces", "points"))


def unpack_foam(data: bytes, case: str | Path) -> Path:
    """Write the files of a zipped OpenFOAM mesh into ``constant/polyMesh`` of a case, and return its folder.

    Other files of the case stay. Raises :class:`DownloadDamaged` when the zip does not hold these files.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            contents = {name: archive.read(name) for name in FOAM_FILES}
    except (zipfile.BadZipFile, KeyError) as error:
        raise DownloadDamaged(f"the OpenFOAM archive cannot be read: {error}") from error
    for name, content in contents.items():
        path = Path(case) / name
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, content)
    return Path(case)


def unpack_xdmf(data: bytes, path: str | Path) -> Path:
    """Write the four files of a zipped XDMF mesh and return ``path``, the one to open.

    ``m.xdmf`` comes with ``m.h5``, ``m_facets.xdmf`` and ``m_facets.h5``. Data is written before the files that refer
    to it. Raises :class:`DownloadDamaged` when the zip does not hold these files.
    """
    path = Path(path)
    names = {"mesh": path.stem, "facets": f"{path.stem}_facets"}
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            heavy = {part: archive.read(f"{part}.h5") for part in PARTS}
            light = {part: archive.read(f"{part}.xdmf").decode() for part in PARTS}
    except (zipfile.BadZipFile, KeyError, UnicodeDecodeError) as error:
        raise DownloadDamaged(f"the XDMF archive cannot be read: {error}") from error
    for part in PARTS:
        write_atomically(path.with_name(f"{names[part]}.h5"), heavy[part])
    for part in reversed(PARTS):
        text = light[part].replace(f"{part}.h5:", f"{names[part]}.h5:")
        write_atomically(path.with_name(f"{names[part]}.xdmf"), text.encode())
    return path


def unpacking(path: str | Path, format: str | None = None) -> Callable[[bytes, str | Path], Path] | None:
    """The function that writes the files of a zip to ``path``; ``None`` where what the service sends is the file."""
    if format is None and Path(path).suffix.lower() == ".xdmf":
        return unpack_xdmf
    return unpack_foam if format in (None, "foam") and Path(path).is_dir() else None


if sys.platform != "win32":
    import fcntl


class Download:
    """The bytes of a file that have arrived, over any number of connections; kept in memory.

    ``sha256`` is that of the whole file, from its ETag; None while it is not known. ``received`` counts bytes.
    """

    def __init__(self) -> None:
        self.sha256: str | None = None
        self.received = 0
        self._resumable = False
        self._digest = hashlib.sha256()
        self._chunks: list[bytes] = []

    @property
    def headers(self) -> dict[str, str]:
        """Request headers for the rest of an unchanged file; empty when all of it is needed."""
        if not (self._resumable and self.received):
            return {}
        return {"Range": f"bytes={self.received}-", "If-Range": f'"{self.sha256}"'}

    @property
    def whole(self) -> bool:
        """Whether every byte has arrived, by the checksum."""
        return self.sha256 == self._digest.hexdigest()

    def begin(self, reply: Reply) -> bool:
        """Prepare for the body of a 200 or 206.

        False for a part that does not continue the bytes that have arrived; these are then discarded.
        """
        if reply.status == 206 and continues(reply, self.sha256, self.received):
            return True
        self.restart(reply)
        return reply.status == 200

    def restart(self, reply: Reply | None = None) -> None:
        """Discard all bytes; ``reply`` is the answer whose body replaces them."""
        self._resumable = reply is not None and reply.status == 200 and resumable(reply)
        self.sha256 = None if reply is None else sha256_of(reply.headers)
        self.received = 0
        self._digest = hashlib.sha256()
        self._empty()

    def write(self, chunk: bytes) -> None:
        """Append bytes."""
        self._append(chunk)
        self._digest.update(chunk)
        self.received += len(chunk)

    def check(self) -> None:
        """Raises :class:`DownloadDamaged` when the bytes do not have the announced checksum."""
        if self.sha256 is not None and not self.whole:
            raise DownloadDamaged("the bytes received do not have the checksum that the service announced")

    def body(self) -> bytes:
        """All bytes that have arrived."""
        return b"".join(self._chunks)

    def _empty(self) -> None:
        self._chunks = []

    def _append(self, chunk: bytes) -> None:
        self._chunks.append(chunk)


class PartFile(Download):
    """A download into ``.NAME.SHA256.part`` next to the file NAME, which it becomes by :meth:`commit`.

    The name of the part identifies the content of the whole file. The next download to the same name can therefore
    continue with the part of an interrupted one. A lock keeps two programs from writing the same part: the second
    program writes its own part and removes it at the end.
    A context manager. Raises :class:`BadArgument` when the folder cannot be written.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        super().__init__()
        if self.path.is_dir():
            raise BadArgument(f"cannot write {self.path}: it is a folder")
        self._keep = True
        self._part, self._file = self._adopt() or self._create()

    def restart(self, reply: Reply | None = None) -> None:
        """Discard all bytes; ``reply`` is the answer whose body replaces them."""
        super().restart(reply)
        name = self._name(self.sha256) if self._resumable and self.sha256 else None
        if name == self._part:
            return
        taken = None if name is None else _open_locked(name, "x+b")
        if name is None or taken is None:
            if self._is_named:
                self._drop()
                self._part, self._file = self._create()
            return
        self._drop()
        self._part, self._file = name, taken

    def commit(self) -> Path:
        """Give the file its name."""
        self._file.flush()
        if sys.platform == "win32":  # which does not rename open files
            self._file.close()
        os.replace(self._part, self.path)
        self._file.close()  # not before: this releases the lock of the part
        return self.path

    def discard(self) -> None:
        """Remove the part at the end: no later download continues with it."""
        self._keep = False

    def __enter__(self) -> PartFile:
        return self

    def __exit__(self, *_: object) -> None:
        if self._file.closed:
            return
        if self._keep and self._is_named and self._resumable and self.received:
            self._file.close()
        else:
            self._drop()

    def _empty(self) -> None:
        self._file.seek(0)
        self._file.truncate()

    def _append(self, chunk: bytes) -> None:
        self._file.write(chunk)

    @property
    def _is_named(self) -> bool:
        return _SHA256.search(self._part.name) is not None

    def _name(self, sha256: str) -> Path:
        return self.path.with_name(f".{self.path.name}.{sha256}.part")

    def _create(self) -> tuple[Path, BinaryIO]:
        part = self.path.with_name(f".{self.path.name}.{secrets.token_hex(6)}.part")
        try:
            return part, part.open("x+b")
        except OSError as error:
            raise BadArgument(f"cannot write {self.path}: {error.strerror or error}") from error

    def _adopt(self) -> tuple[Path, BinaryIO] | None:
        """The newest part of an earlier download, already read; older ones are removed."""
        found = None
        pattern = f".{glob.escape(self.path.name)}.*.part"
        for part in sorted(self.path.parent.glob(pattern), key=_age):
            named = _SHA256.search(part.name)
            # the rest of the name is that of the file: "a" leaves the parts of "a.b" alone
            if named is None or part != self._name(named[1]):
                continue
            file = _open_locked(part, "r+b")
            if file is None:
                continue
            if found is not None:
                part.unlink(missing_ok=True)
                file.close()
                continue
            while chunk := file.read(2**20):
                self._digest.update(chunk)
                self.received += len(chunk)
            self.sha256, self._resumable = named[1], True
            found = part, file
        return found

    def _drop(self) -> None:
        if sys.platform == "win32":  # which does not remove open files
            self._file.close()
        self._part.unlink(missing_ok=True)
        self._file.close()


_SHA256 = re.compile(r"\.([0-9a-f]{64})\.part$")


def _age(part: Path) -> float:
    try:
        return -part.stat().st_mtime
    except OSError:
        return 0.0


def _open_locked(part: Path, mode: str) -> BinaryIO | None:
    """The part, open and locked; None when another program uses it or locks are not available."""
    if sys.platform == "win32":  # without such locks every download begins anew
        return None
    try:
        file: BinaryIO = part.open(mode)  # type: ignore[assignment]
    except OSError:
        return None
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        # another program may have renamed or removed it since it was opened
        if os.path.samestat(os.fstat(file.fileno()), part.stat()):
            return file
    except BlockingIOError:
        pass
    except OSError:  # no locks in this file system, or no such part any more
        if mode == "x+b":
            part.unlink(missing_ok=True)
    file.close()
    return None
