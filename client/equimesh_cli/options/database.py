"""Options for the database of a service, and messages for its errors."""

from __future__ import annotations

import argparse
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from equimesh_cli.exits import Exit, NotInstalled, Refused
from equimesh_cli.options.settings import merged_settings

if TYPE_CHECKING:
    from equimesh_service.settings import Settings


def add_database_options(parser: argparse.ArgumentParser) -> None:
    """Add --data-dir and --database-url, which name the database, and --json."""
    parser.add_argument("--data-dir", help="data folder of the service (EQUIMESH_DATA_DIR, else equimesh-data)")
    parser.add_argument("--database-url", help="its database, if not in that folder (EQUIMESH_DATABASE_URL)")
    parser.add_argument("--json", action="store_true", help="print JSON")


def database_settings(options: argparse.Namespace) -> Settings:
    """The settings that name the database; raises :class:`NotInstalled` without the service."""
    try:
        import equimesh_service.store.database  # noqa: F401
    except ImportError as error:
        raise NotInstalled("service", error) from error
    names = ("data_dir", "database_url")
    return merged_settings({name: value for name in names if (value := getattr(options, name)) is not None})


@contextmanager
def refusing_database_errors() -> Iterator[None]:
    """Raise :class:`Refused` for a database that does not answer."""
    from sqlalchemy.exc import SQLAlchemyError

    try:
        yield
    except (SQLAlchemyError, sqlite3.Error) as error:
        raise Refused(
            f"the database does not answer ({cause(error)}): check its address, and that it can be reached",
            Exit.UNREACHABLE,
        ) from None


def cause(error: Exception) -> str:
    """The kind of a database error. Its text is never shown: it may hold the address with the password."""
    return type(getattr(error, "orig", None) or error).__name__
