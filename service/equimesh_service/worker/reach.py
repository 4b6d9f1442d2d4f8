"""A check that a worker of a cluster reaches the database and the files of its service, not others of the same name."""

from __future__ import annotations

import uuid
from dataclasses import dataclass
from pathlib import Path

from sqlalchemy.exc import SQLAlchemyError

from equimesh_service.errors import CannotServeError
from equimesh_service.files.folder import FolderFiles
from equimesh_service.store.database import LATEST, current, sqlite_file
from equimesh_service.worker.job import Storage

# Its content is different on every machine, and after every start of it. Containers have that of their machine.
BOOT = Path("/proc/sys/kernel/random/boot_id")
# A file in the folder of the files that has different content in every such folder.
MARK = "identity"


@dataclass(frozen=True, kw_only=True)
class Reach:
    """The storage of a service, with marks by which a worker recognises it; picklable."""

    storage: Storage
    machine: str
    file: tuple[int, int] | None
    folder: str | None  # None for files that are in no folder

    @classmethod
    def of(cls, storage: Storage, *, mark: bool = True) -> Reach:
        """The storage as this process sees it; with ``mark`` its folder of files gets a mark."""
        file, files = sqlite_file(storage.database_url), storage.address.open()
        return cls(
            storage=storage,
            machine=_machine(),
            file=None if file is None else _number(file),
            folder=(_marked if mark else _mark)(files.folder) if isinstance(files, FolderFiles) else None,
        )

    @property
    def is_marked(self) -> bool:
        """Whether there is something to recognise: a service has used this storage with a cluster."""
        return self.folder != "" and (sqlite_file(self.storage.database_url) is None or self.file is not None)

    def describe_faults(self) -> str:
        """The storage that this process does not reach, in words; "" where it reaches all."""
        return "; ".join(filter(None, (self._database_fault(), self._files_fault())))

    def _database_fault(self) -> str:
        file = sqlite_file(self.storage.database_url)
        if file is not None:
            if self.machine != _machine():
                return "it runs on another machine than the service: SQLite needs one machine, PostgreSQL does not"
            if _number(file) != self.file:
                return f"it does not see the database of the service, {file}"
        try:
            revision = current(self.storage.database_url)
        except CannotServeError as error:
            return str(error)
        except SQLAlchemyError as error:  # its message may hold the address
            return f"it cannot reach the database of the service ({type(error).__name__})"
        return "" if revision == LATEST else "it reaches another database than the service, without its tables"

    def _files_fault(self) -> str:
        try:
            files = self.storage.address.open()
            if isinstance(files, FolderFiles) and self.folder != _mark(files.folder):
                return f"it does not see the folder of the service's files, {files.folder}"
            files.prepare(alone=False)
        except OSError as error:
            return f"it cannot use the files of the service: {error.strerror or error}"
        return ""


def _machine() -> str:
    try:
        return BOOT.read_text().strip()
    except OSError:
        return ""


def _number(file: Path) -> tuple[int, int] | None:
    try:
        found = file.stat()
    except OSError:
        return None
    return found.st_dev, found.st_ino


def _mark(folder: Path) -> str:
    try:
        return (folder / MARK).read_text()
    except OSError:
        return ""


def _marked(folder: Path) -> str:
    """The content of the mark of a folder, which is written if there is none."""
    try:
        with (folder / MARK).open("x") as file:
            file.write(uuid.uuid4().hex)
    except FileExistsError:
        pass
    return _mark(folder)
