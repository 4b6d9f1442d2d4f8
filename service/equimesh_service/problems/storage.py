"""Faults of the storage: one table from errors of files and database to problems."""

import errno
import logging
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager

from sqlalchemy.exc import DBAPIError
from sqlalchemy.exc import TimeoutError as PoolTimeoutError

from equimesh_service.errors import FilesError
from equimesh_service.problems.problem import Problem

_log = logging.getLogger(__name__)
_FULL_ERRNOS = {errno.ENOSPC, errno.EDQUOT}
_UNUSABLE_ERRNOS = {errno.EROFS, errno.EACCES, errno.EPERM, errno.EIO, errno.ESTALE, errno.ENOTCONN, errno.ENXIO}
_SQLITE_UNUSABLE = {
    sqlite3.SQLITE_BUSY,
    sqlite3.SQLITE_READONLY,
    sqlite3.SQLITE_IOERR,
    sqlite3.SQLITE_CANTOPEN,
    sqlite3.SQLITE_CORRUPT,
    sqlite3.SQLITE_PROTOCOL,
}
# PostgreSQL: disk_full.
_POSTGRES_FULL = "53100"
# The server is away, not ready, takes no writes, or has ended one of two transactions that waited for each other.
_POSTGRES_UNUSABLE = ("08", "40", "53", "57", "58", "25006")
_RETRY = {"Retry-After": "5"}


def storage_problem(error: BaseException) -> Problem | None:
    """The problem for a full disk, or for files or a database that cannot be used now; None for other errors.

    The problem does not repeat the error: paths, addresses and statements belong into the log.
    """
    match error:
        case Problem(name="storage-full" | "unavailable"):
            return error
        case FilesError():
            return _unusable("The files of the service", error)
        case DBAPIError() | PoolTimeoutError() | sqlite3.Error():
            return _database_problem(error)
        # HDF5 gives no errno, only the words.
        case OSError() if error.errno in _FULL_ERRNOS or "No space left on device" in str(error):
            return _full(error)
        case OSError() if error.errno in _UNUSABLE_ERRNOS:
            return _unusable("The files of the service", error)
        case _:
            return None


@contextmanager
def storage_faults() -> Iterator[None]:
    """Turn faults of the storage into problems, which cross from a worker to the service."""
    try:
        yield
    except Exception as error:
        problem = storage_problem(error)
        if problem is None:
            raise
        raise problem from None


def _database_problem(error: Exception) -> Problem | None:
    if isinstance(error, PoolTimeoutError):
        return _unusable("The database", error)
    cause = getattr(error, "orig", None) or error
    code = getattr(cause, "sqlite_errorcode", None)
    state = getattr(cause, "sqlstate", None)
    if code is not None:
        kind = code & 0xFF  # the rest gives details
        if kind == sqlite3.SQLITE_FULL:
            return _full(error)
        return _unusable("The database", error) if kind in _SQLITE_UNUSABLE else None
    if state == _POSTGRES_FULL:
        return _full(error)
    lost = isinstance(error, DBAPIError) and error.connection_invalidated
    refused = type(cause).__name__ in ("OperationalError", "ConnectionTimeout") and state is None
    known = state is not None and state.startswith(_POSTGRES_UNUSABLE)
    return _unusable("The database", error) if lost or refused or known else None


def _full(error: Exception) -> Problem:
    _log.warning("the storage is full: %s", _first_line(error))
    return Problem("storage-full", "The storage of the service is full.")


def _unusable(what: str, error: Exception) -> Problem:
    _log.warning("%s cannot be used: %s", what.lower(), _first_line(error))
    return Problem("unavailable", f"{what} cannot be used now.", headers=_RETRY)


def _first_line(error: Exception) -> str:
    """The message of the error without the statement that SQLAlchemy adds, which holds input of clients."""
    cause = getattr(error, "orig", None) or error
    return f"{type(cause).__name__}: {str(cause).partition(chr(10))[0][:300]}"
