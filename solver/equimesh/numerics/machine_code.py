"""Where the machine code of loops is kept: an archive that comes with the package, and a folder of the user."""

import errno
import hashlib
import json
import logging
import mmap
import os
import stat
import struct
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from equimesh.numerics.processor import tag

fcntl: Any
try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

ARCHIVES = Path(__file__).with_name("archives")
"""The archives of this installation, one for each Python, Numba and level of processors."""
# Stamps of one loop in the folder of a user: those of other branches and environments, the newest ones.
_MOST_STAMPS = 8
# Seconds for which another process may compile one loop before this process does it, too; and between two looks.
_TURN_SECONDS, _LOOK_SECONDS = 300.0, 0.05
_ENTRY, _ARCHIVE = b"equimesh loop 1\n", b"equimesh loops 1"
_HEAD = struct.Struct("<16s32sQ")
_log = logging.getLogger(__name__)


class DamagedError(Exception):
    """What is kept is not what was kept."""


class Key(NamedTuple):
    """A loop with its module, its stamp, and the types that it is compiled for."""

    loop: str
    stamp: str
    types: str

    @property
    def stem(self) -> str:
        """What the entries of all types begin with."""
        return f"{self.loop}-{self.stamp[:16]}-"

    @property
    def name(self) -> str:
        """The name of the entry."""
        return self.stem + hashlib.sha256(self.types.encode()).hexdigest()[:16]


def sealed(content: bytes) -> bytes:
    """An entry with this content, which cannot be damaged unnoticed."""
    return _ENTRY + hashlib.sha256(content).digest() + content


def opened(entry: bytes) -> bytes:
    """The content of an entry; raises :class:`DamagedError`."""
    start = len(_ENTRY) + 32
    content = entry[start:]
    if entry[: len(_ENTRY)] != _ENTRY or hashlib.sha256(content).digest() != entry[len(_ENTRY) : start]:
        raise DamagedError
    return content


class Archive:
    """Entries in one file, which is only read; raises :class:`DamagedError` and :class:`OSError`."""

    def __init__(self, path: Path) -> None:
        with path.open("rb") as file:
            try:
                self._data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
                kind, digest, size = _HEAD.unpack_from(self._data)
            except (ValueError, struct.error) as error:  # it is empty, or shorter
                raise DamagedError from error
        head = self._data[_HEAD.size : _HEAD.size + size]
        if kind != _ARCHIVE or hashlib.sha256(head).digest() != digest:
            raise DamagedError
        described = json.loads(head)
        self._first, self._places = _HEAD.size + size, described["entries"]
        self.path, self.tag = path, str(described["tag"])

    def read(self, name: str) -> bytes | None:
        """An entry; None where there is none of this name."""
        if name not in self._places:
            return None
        at, size = self._places[name]
        return self._data[self._first + at : self._first + at + size]

    def stems(self) -> set[str]:
        """The beginnings of the names of all entries, which say loop and stamp."""
        return set(map(stem, self._places))

    def names(self) -> list[str]:
        """The names of all entries."""
        return [*self._places]


def write_archive(path: Path, entries: Iterable[tuple[str, bytes]]) -> int:
    """Write an archive for what runs here, and return how many entries it has."""
    places, contents, at = dict[str, tuple[int, int]](), list[bytes](), 0
    for name, entry in entries:
        places[name] = (at, len(entry))
        contents.append(entry)
        at += len(entry)
    head = json.dumps({"tag": tag(), "entries": places}).encode()
    data = _HEAD.pack(_ARCHIVE, hashlib.sha256(head).digest(), len(head)) + head + b"".join(contents)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)
    return len(places)


@cache
def find_archive() -> Archive | str:
    """The archive for what runs here, or the reason why none is used."""
    path = archive_path()
    try:
        archive = Archive(path)
    except FileNotFoundError:
        others = sorted(other.stem for other in ARCHIVES.glob("*.loops"))
        if not others:
            return "this installation came without an archive"
        return f"its archives are for {', '.join(others)}, and this is {tag()}"
    except (DamagedError, ValueError, KeyError):
        return _told(f"the archive {path} is damaged")
    except OSError as error:
        return _told(f"the archive {path} cannot be read: {error.strerror}")
    return archive if archive.tag == tag() else f"the archive {path} is for {archive.tag}, and this is {tag()}"


def archive_path() -> Path:
    """The place of the archive for what runs here, inside the package."""
    return ARCHIVES / f"{tag()}.loops"


class Folder:
    """Entries as files of one folder, which belongs to this user, and which nobody else can write."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def read(self, name: str) -> bytes | None:
        """An entry; None where there is none of this name, or where another user could have written it."""
        try:
            with open(self.path / name, "rb", opener=_without_links) as file:
                status = os.fstat(file.fileno())
                if not stat.S_ISREG(status.st_mode) or not _is_own(status):
                    _told(f"{self.path / name} can be written by others, and is not used")
                    return None
                return file.read()
        except OSError:
            return None

    def write(self, name: str, entry: bytes) -> None:
        """Keep an entry, in place of one of the same name; does nothing where the folder cannot be written."""
        try:
            handle, temporary = tempfile.mkstemp(dir=self.path, prefix=".")  # it is written as 0600
            try:
                with open(handle, "wb") as file:
                    file.write(entry)
                os.replace(temporary, self.path / name)
            except BaseException:
                os.unlink(temporary)
                raise
        except OSError as error:
            _told(f"compiled loops are not kept in {self.path}: {error.strerror}")
            return
        self._forget_old(name)

    def stems(self) -> set[str]:
        """The beginnings of the names of all entries, which say loop and stamp."""
        return set(map(stem, self.names()))

    def names(self) -> list[str]:
        """The names of all entries."""
        with suppress(OSError):
            return [name for name in os.listdir(self.path) if not name.startswith(".")]
        return []

    @contextmanager
    def turn(self, name: str) -> Iterator[None]:
        """Wait while another process makes this entry; the system ends the turn of a process that is killed.

        Without locks, as on some network file systems, each process makes it for itself.
        """
        path, handle = self.path / f".{name}.lock", None
        with suppress(OSError):
            handle = _locked(path)
        try:
            yield
        finally:
            if handle is not None:
                _held.discard(handle)
                with suppress(OSError):
                    os.unlink(path)
                os.close(handle)

    def _forget_old(self, name: str) -> None:
        """Remove the entries of this loop with the oldest stamps, if there are many."""
        loop, newest = name.rsplit("-", 2)[0] + "-", dict[str, float]()
        mine = [other for other in self.names() if other.startswith(loop)]
        for other in mine:
            with suppress(OSError):
                made = os.stat(self.path / other).st_mtime
                newest[stem(other)] = max(made, newest.get(stem(other), made))
        old = set(sorted(newest, key=newest.__getitem__, reverse=True)[_MOST_STAMPS:])
        for other in mine:
            if stem(other) in old:
                with suppress(OSError):
                    os.unlink(self.path / other)


@cache
def find_folder() -> Folder | str:
    """The folder of this user for what runs here, which is made where it is missing; or why there is none."""
    try:
        path = cache_path() / tag()
        _make(path.parent)
        _make(path)
        statuses = [os.stat(folder) for folder in (path.parent, path)]
    except (OSError, RuntimeError) as error:  # there is no home folder
        return f"there is no folder for them: {error}"
    if not all(map(_is_own, statuses)):
        return _told(f"{path} does not belong to this user alone, and is not used")
    return Folder(path)


def cache_path() -> Path:
    """The folder for compiled loops: ``EQUIMESH_CACHE_DIR``, or ``equimesh`` in the folder of this user for caches."""
    if own := os.environ.get("EQUIMESH_CACHE_DIR"):
        return Path(own).expanduser().absolute()
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local") / "equimesh"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "equimesh"
    given = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(given) if os.path.isabs(given) else Path.home() / ".cache") / "equimesh"


_held = set[int]()  # the locks of this process


def _forget_turns() -> None:
    """Close the locks of the parent, whose turns would otherwise last as long as its children."""
    for handle in _held:
        with suppress(OSError):
            os.close(handle)
    _held.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_turns)


def _locked(path: Path) -> int | None:
    """The lock of a file, as its handle; None where another process holds it for too long."""
    if fcntl is None:
        return None
    until = time.monotonic() + _TURN_SECONDS
    while time.monotonic() < until:
        handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
        _held.add(handle)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.fstat(handle).st_ino == os.stat(path).st_ino:
                return handle
        except FileNotFoundError:  # the holder before has removed it
            pass
        except OSError as error:
            if error.errno not in (errno.EWOULDBLOCK, errno.EAGAIN):
                _close(handle)
                raise
            time.sleep(_LOOK_SECONDS)
        except BaseException:
            _close(handle)
            raise
        _close(handle)
    _log.warning("another process has not finished %s; this one compiles the loop, too", path)
    return None


def _close(handle: int) -> None:
    _held.discard(handle)
    os.close(handle)


def _make(path: Path) -> None:
    if not path.is_dir():
        path.parent.mkdir(parents=True, exist_ok=True)
        with suppress(FileExistsError):
            path.mkdir(mode=0o700)


def _is_own(status: os.stat_result) -> bool:
    """Whether this user alone can have written it."""
    return not hasattr(os, "geteuid") or (status.st_uid == os.geteuid() and not status.st_mode & 0o022)


def _without_links(path: str, flags: int) -> int:
    return os.open(path, flags | getattr(os, "O_NOFOLLOW", 0))


def stem(name: str) -> str:
    """The beginning of the name of an entry, which says loop and stamp."""
    return name.rpartition("-")[0] + "-"


@cache  # each fault once
def _told(fault: str) -> str:
    _log.warning(fault)
    return fault
