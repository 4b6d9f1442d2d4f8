"""`equimesh keys`: creates, lists, changes and revokes the API keys of a service."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from contextlib import closing, contextmanager
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

from equimesh_cli.options.service import add_database_options, database_settings, refusing_database_errors
from equimesh_cli.parser import CommandError, Exit, add_action, add_command

if TYPE_CHECKING:
    from equimesh_service.store.keys import KeyRow, KeyStore

SCOPES = ("read", "write", "admin")
_SHARE_HELP = "meshes that this key starts while a key of share 1 starts one, if both have meshes waiting"
EXAMPLES = """\
examples:
  equimesh keys create --name ada --scope write
  equimesh keys create --name prometheus --scope admin --data-dir /srv/meshes
  equimesh keys list
  equimesh keys change 3f1c0a9b7e52 --share 3
  equimesh keys revoke 3f1c0a9b7e52

The service need not be stopped. Once there is a key, every request needs one, in the header
`Authorization: Bearer em_...`. Revoking the last key does not open the service again.

needs the service: pip install 'equimesh[service]'

"""
EXITS = {
    Exit.INPUT: "bad usage, or there is no such key",
    Exit.UNREACHABLE: "the database does not answer",
}


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = add_command(
        commands,
        "keys",
        help="create, list, change and revoke API keys",
        description="API keys of a service, in its database.",
        examples=EXAMPLES,
        exits=EXITS,
    )
    actions = parser.add_subparsers(dest="action", metavar="{create,list,change,revoke}", required=True)
    create = add_action(actions, "create", help="create a key, and print its secret this once", exits=EXITS)
    create.add_argument("--name", required=True, help="owner or purpose of the key; shown in the list")
    create.add_argument(
        "--scope",
        action="append",
        choices=SCOPES,
        help="read: look at meshes and download them; write: also request meshes, upload samples, cancel and delete; "
        "admin: also those of all other keys, and metrics; may be repeated (write)",
    )
    create.add_argument("--share", type=int, default=1, help=f"{_SHARE_HELP} (1)")
    create.set_defaults(run=_create)
    listing = add_action(actions, "list", help="show all keys, without their secrets", exits=EXITS)
    listing.set_defaults(run=_list)
    change = add_action(actions, "change", help="change the share of a key; takes effect at once", exits=EXITS)
    change.add_argument("id", metavar="ID", help="as in the list")
    change.add_argument("--share", type=int, required=True, help=_SHARE_HELP)
    change.set_defaults(run=_change)
    revoke = add_action(actions, "revoke", help="revoke a key; takes effect within 2 seconds", exits=EXITS)
    revoke.add_argument("id", metavar="ID", help="as in the list; it is also the middle of the secret")
    revoke.set_defaults(run=_revoke)
    for action in (create, listing, change, revoke):
        add_database_options(action)


def _create(options: argparse.Namespace) -> int:
    if not (0 < len(options.name) <= 200 and options.name.isprintable()):
        raise CommandError("--name: 1 to 200 printable characters")
    with _open_keys(options, create=True) as keys, _refusing_values():
        row, secret = keys.create(options.name, options.scope or ["write"], options.share)
    if options.json:
        print(json.dumps({**_plain(row), "secret": secret}))
    else:
        print(secret)
        share = f", share {row.share}" if row.share != 1 else ""
        scopes = ", ".join(row.scopes)
        print(f"\nKey {row.id} ({row.name}), scopes {scopes}{share}. This is the only time that it is shown.")
    return Exit.DONE


def _list(options: argparse.Namespace) -> int:
    with _open_keys(options) as keys:
        rows = keys.list()
    if options.json:
        print(json.dumps([_plain(row) for row in rows]))
        return Exit.DONE
    if not rows:
        print("No key exists: requests need none.")
        return Exit.DONE
    print(f"{'id':<14}{'scopes':<14}{'share':<7}{'created':<22}{'revoked':<22}name")
    for row in rows:
        revoked = "" if row.revoked_at is None else _time(row.revoked_at)
        scopes, created = ",".join(row.scopes), _time(row.created_at)
        print(f"{row.id:<14}{scopes:<14}{row.share:<7}{created:<22}{revoked:<22}{row.name}")
    return Exit.DONE


def _change(options: argparse.Namespace) -> int:
    with _open_keys(options) as keys:
        row = _find(keys, options.id)
        with _refusing_values():
            changed = keys.change(options.id, options.share)
        if not changed:
            raise CommandError(f"the key {options.id} ({row.name}) is revoked")
    changes = {"id": row.id, "share": options.share}
    print(json.dumps(changes) if options.json else f"Key {row.id} ({row.name}) has share {options.share}.")
    return Exit.DONE


def _revoke(options: argparse.Namespace) -> int:
    with _open_keys(options) as keys:
        row = _find(keys, options.id)
        if not keys.revoke(options.id):
            raise CommandError(f"the key {options.id} ({row.name}) was revoked already")
    print(json.dumps({"id": row.id, "revoked": True}) if options.json else f"Key {row.id} ({row.name}) is revoked.")
    return Exit.DONE


def _find(keys: KeyStore, key_id: str) -> KeyRow:
    row = keys.get(key_id)
    if row is None:
        raise CommandError(f"no key has the id {key_id}; `equimesh keys list` shows all keys")
    return row


@contextmanager
def _refusing_values() -> Iterator[None]:
    """Turn a value that the store refuses into a refusal of the command."""
    try:
        yield
    except ValueError as error:
        raise CommandError(f"{error}") from None


@contextmanager
def _open_keys(options: argparse.Namespace, *, create: bool = False) -> Iterator[KeyStore]:
    """The keys in the database that the options name; a missing database is created only with ``create``."""
    settings = database_settings(options)
    from equimesh_service.files.folder import make_folder, withhold_files
    from equimesh_service.store.store import Store

    withhold_files()
    is_in_folder = not settings.database_url.get_secret_value()
    if is_in_folder and create:
        make_folder(settings.data_dir)
    elif is_in_folder and not (settings.data_dir / "equimesh.sqlite3").exists():
        raise CommandError(f"there is no database in {settings.data_dir}; name its folder with --data-dir")
    with refusing_database_errors(), closing(Store(settings.database)) as store:
        store.prepare()
        yield store.keys


def _plain(row: KeyRow) -> dict[str, Any]:
    revoked = None if row.revoked_at is None else _time(row.revoked_at)
    return {
        "id": row.id,
        "name": row.name,
        "scopes": list(row.scopes),
        "share": row.share,
        "created_at": _time(row.created_at),
        "revoked_at": revoked,
    }


def _time(seconds: float) -> str:
    return datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
