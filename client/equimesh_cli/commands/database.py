"""`equimesh database`: the revision of a service's database, its upgrade, a copy of it."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from equimesh_cli.exits import EPILOG, Exit, NotInstalled, Refused
from equimesh_cli.options.settings import chosen

if TYPE_CHECKING:
    from equimesh_service.settings import Settings

Found = TypeVar("Found")
EXAMPLES = """\
examples:
  equimesh database current --data-dir /var/lib/equimesh
  equimesh database upgrade
  equimesh database backup backup/equimesh.sqlite3

A service upgrades its database when it starts; `upgrade` does it before that.

needs the service: pip install 'equimesh[service]'

"""


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "database",
        help="show, upgrade or copy the database of a service",
        description="The revision of a service's database, its upgrade to this release, and a copy of it.",
        epilog=EXAMPLES + EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    current = actions.add_parser("current", help="show its revision, and that of this release", allow_abbrev=False)
    current.set_defaults(run=_current)
    upgrade = actions.add_parser("upgrade", help="make its tables, or bring them up to date", allow_abbrev=False)
    upgrade.set_defaults(run=_upgrade)
    backup = actions.add_parser("backup", help="copy it to a new file while it is in use (SQLite)", allow_abbrev=False)
    backup.add_argument("file", metavar="FILE", type=Path, help="the copy, which must not be there yet")
    backup.set_defaults(run=_backup)
    for action in (current, upgrade, backup):
        action.add_argument("--data-dir", help="data folder of the service (EQUIMESH_DATA_DIR, else equimesh-data)")
        action.add_argument("--database-url", help="its database, if not in that folder (EQUIMESH_DATABASE_URL)")
        action.add_argument("--json", action="store_true", help="print JSON")


def _current(options: argparse.Namespace) -> int:
    def look(settings: Settings) -> tuple[str | None, str]:
        from equimesh_service.store.database import sqlite_file
        from equimesh_service.store.migration import LATEST, current

        file = sqlite_file(settings.database)
        return (None if file is not None and not file.exists() else current(settings.database)), LATEST

    found, latest = _answered(options, look)
    if options.json:
        print(json.dumps({"current": found, "latest": latest}))
    elif found is None:
        print(f"there are no tables yet; this release makes those of revision {latest}")
    else:
        print(found if found == latest else f"{found}; this release brings it up to {latest}")
    return Exit.DONE


def _upgrade(options: argparse.Namespace) -> int:
    def change(settings: Settings) -> str:
        from equimesh_service.store.database import sqlite_file
        from equimesh_service.store.migration import upgrade

        file = sqlite_file(settings.database)
        if file is not None:
            file.parent.mkdir(parents=True, exist_ok=True)
        return upgrade(settings.database)

    revision = _answered(options, change)
    print(json.dumps({"current": revision}) if options.json else f"the database is of revision {revision}")
    return Exit.DONE


def _backup(options: argparse.Namespace) -> int:
    def copy(settings: Settings) -> int:
        from equimesh_service.store.inspection import back_up

        try:
            return back_up(settings.database, options.file)
        except FileExistsError:
            raise Refused(f"{options.file} is there already: choose another name, or remove it first") from None

    size = _answered(options, copy)
    said = {"file": str(options.file), "bytes": size}
    print(json.dumps(said) if options.json else f"wrote {options.file}, {size} bytes; copy the files after it")
    return Exit.DONE


def _answered(options: argparse.Namespace, action: Callable[[Settings], Found]) -> Found:
    """What an action says of the database that the options name; raises :class:`Refused`."""
    try:
        from sqlalchemy.exc import SQLAlchemyError

    except ImportError as error:
        raise NotInstalled("service", error) from error
    import sqlite3

    asked = {name: value for name in ("data_dir", "database_url") if (value := getattr(options, name)) is not None}
    settings = chosen(asked)
    try:
        return action(settings)
    except (SQLAlchemyError, sqlite3.Error) as error:
        # The text of the error may name the address with its password.
        cause = type(getattr(error, "orig", None) or error).__name__
        raise Refused(
            f"the database does not answer ({cause}): see that its address is right, and that it can be reached",
            Exit.UNREACHABLE,
        ) from None
