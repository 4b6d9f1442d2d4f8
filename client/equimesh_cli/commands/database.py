"""`equimesh database`: the revision of a service's database, its upgrade, a copy of it."""

import argparse
import json
from pathlib import Path
from typing import Any

from equimesh_cli.options.service import add_database_options, database_settings, refusing_database_errors
from equimesh_cli.parser import CommandError, Exit, add_action, add_command

EXAMPLES = """\
examples:
  equimesh database current --data-dir /var/lib/equimesh
  equimesh database upgrade
  equimesh database backup backup/equimesh.sqlite3

A service upgrades its database when it starts; `upgrade` does it before that.

needs the service: pip install 'equimesh[service]'

"""
EXITS = {
    Exit.INPUT: "bad usage, a database of another release, or a copy that exists already",
    Exit.UNREACHABLE: "the database does not answer",
}


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = add_command(
        commands,
        "database",
        help="show, upgrade or copy the database of a service",
        description="The revision of a service's database, its upgrade to this release, and a copy of it.",
        examples=EXAMPLES,
        exits=EXITS,
    )
    actions = parser.add_subparsers(dest="action", metavar="{current,upgrade,backup}", required=True)
    current = add_action(actions, "current", help="show its revision, and that of this release", exits=EXITS)
    current.set_defaults(run=_current)
    upgrade = add_action(actions, "upgrade", help="create its tables, or upgrade them to this release", exits=EXITS)
    upgrade.set_defaults(run=_upgrade)
    backup = add_action(actions, "backup", help="copy it to a new file while it is in use (SQLite)", exits=EXITS)
    backup.add_argument("file", metavar="FILE", type=Path, help="the copy, which must not exist yet")
    backup.set_defaults(run=_backup)
    for action in (current, upgrade, backup):
        add_database_options(action)


def _current(options: argparse.Namespace) -> int:
    settings = database_settings(options)
    from equimesh_service.store.database import LATEST, current, sqlite_file

    file = sqlite_file(settings.database)
    with refusing_database_errors():
        found = None if file is not None and not file.exists() else current(settings.database)
    if options.json:
        print(json.dumps({"current": found, "latest": LATEST}))
    elif found is None:
        print(f"no tables yet; this release creates those of revision {LATEST}")
    else:
        print(found if found == LATEST else f"{found}; this release upgrades it to {LATEST}")
    return Exit.DONE


def _upgrade(options: argparse.Namespace) -> int:
    settings = database_settings(options)
    from equimesh_service.files.folder import make_folder, withhold_files
    from equimesh_service.store.database import sqlite_file, upgrade

    withhold_files()
    file = sqlite_file(settings.database)
    if file is not None:
        make_folder(file.parent)
    with refusing_database_errors():
        revision = upgrade(settings.database)
    print(json.dumps({"current": revision}) if options.json else f"the database has revision {revision}")
    return Exit.DONE


def _backup(options: argparse.Namespace) -> int:
    settings = database_settings(options)
    from equimesh_service.files.folder import withhold_files
    from equimesh_service.store.database import back_up

    withhold_files()
    try:
        with refusing_database_errors():
            size = back_up(settings.database, options.file)
    except FileExistsError:
        raise CommandError(f"{options.file} exists already: choose another name, or remove it first") from None
    report = {"file": str(options.file), "bytes": size}
    print(json.dumps(report) if options.json else f"wrote {options.file}, {size} bytes; copy the files after it")
    return Exit.DONE
