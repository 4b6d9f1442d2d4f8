"""`equimesh config`: the settings of a service, and the source of each."""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from itertools import groupby
from typing import TYPE_CHECKING, Any

from equimesh_cli.options.service import add_settings, explicit_settings, merged_settings
from equimesh_cli.parser import Exit, NotInstalled, add_command

if TYPE_CHECKING:
    from equimesh_service.settings import Settings

HIDDEN = "***"
EXAMPLES = """\
examples:
  equimesh config
  EQUIMESH_PORT=9000 equimesh config --workers 4
  equimesh config --env > equimesh.env

It takes the options of `equimesh serve`. Secrets are not shown.

needs the service: pip install 'equimesh[service]'

"""
EXITS = {
    Exit.INPUT: "bad usage or a bad setting: a service would not start, either",
}


@dataclass(frozen=True, kw_only=True)
class SettingRow:
    """A setting without its secrets. ``source`` is "default", "environment" or "option"."""

    group: str
    name: str
    variable: str
    value: str | int | float | bool
    source: str
    hidden: bool


def add_parser(commands: Any, *, full: bool) -> None:
    """Add the command; with ``full`` its options, too."""
    parser = add_command(
        commands,
        "config",
        help="show the settings of a service",
        description="Print the settings that a service started here and now would have, and where each comes from.",
        examples=EXAMPLES,
        exits=EXITS,
        usage="equimesh config [OPTIONS]",
    )
    form = parser.add_mutually_exclusive_group()
    form.add_argument("--json", action="store_true", help="print JSON")
    form.add_argument("--env", action="store_true", help="print lines for a file of variables, defaults commented out")
    parser.set_defaults(run=run)
    if full:
        add_settings(parser)


def run(options: argparse.Namespace) -> int:
    """Print all settings, and a message for each unknown variable."""
    try:
        from equimesh_service.settings import describe_unknown, find_unknown
    except ImportError as error:
        raise NotInstalled("service", error) from error
    explicit = explicit_settings(options)
    rows = list_settings(merged_settings(explicit), explicit)
    foreign = find_unknown(os.environ)
    if options.json:
        print(json.dumps({"settings": [asdict(row) for row in rows], "unknown": foreign}, indent=2))
    elif options.env:
        print("\n\n".join(f"# {title}\n" + "\n".join(map(_line, below)) for title, below in _by_group(rows)))
    else:
        print("\n\n".join(f"{title}\n" + "\n".join(map(_row, below)) for title, below in _by_group(rows)))
    for name, nearest in foreign.items():
        print(f"equimesh: {describe_unknown(name, nearest)}", file=sys.stderr)
    return Exit.DONE


def list_settings(settings: Settings, options: dict[str, str]) -> list[SettingRow]:
    """All settings in their order, without secrets; ``options`` are those that were given as options."""
    from equimesh_service.settings import groups, variable

    environment = {name.upper() for name in os.environ}
    rows = []
    for group, name in ((title, name) for title, names in groups().items() for name in names):
        value, hidden = _without_secret(name, getattr(settings, name))
        source = "option" if name in options else "environment" if variable(name) in environment else "default"
        row = SettingRow(group=group, name=name, variable=variable(name), value=value, source=source, hidden=hidden)
        rows.append(row)
    return rows


def _by_group(rows: list[SettingRow]) -> Iterator[tuple[str, list[SettingRow]]]:
    """The settings under the titles of their groups."""
    for title, below in groupby(rows, key=lambda row: row.group):
        yield title, list(below)


def _row(row: SettingRow) -> str:
    """A line for people."""
    return f"  {row.name:<26}{row.source:<13}{_words(row.value)}".rstrip()


def _without_secret(name: str, value: Any) -> tuple[str | int | float | bool, bool]:
    """A value without its secrets, and whether something is hidden."""
    from pydantic import SecretStr

    if isinstance(value, SecretStr):
        secret = value.get_secret_value()
        shown = _database(secret) if name == "database_url" else HIDDEN if secret else ""
        return shown, shown != secret
    if isinstance(value, bool | int | float):
        return value, False
    text = str(value)
    shown = _address(text) if "://" in text else text
    return shown, shown != text


def _database(url: str) -> str:
    """The address of a database without its password, which may be in two places."""
    if not url:
        return ""
    from sqlalchemy.engine import make_url
    from sqlalchemy.exc import ArgumentError

    try:
        address = make_url(url)
    except (ArgumentError, ValueError):
        return HIDDEN
    if address.query.get("password"):
        address = address.update_query_dict({"password": HIDDEN})
    return address.render_as_string(hide_password=True)


def _address(url: str) -> str:
    """An address without its possible secrets: the text before an @, and the values of a query."""
    before, mark, query = re.sub(r"//[^/?#]*@", f"//{HIDDEN}@", url).partition("?")
    return before + mark + re.sub(r"=[^&#]*", f"={HIDDEN}", query)


def _words(value: str | int | float | bool) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.12g}" if isinstance(value, float) else str(value)


def _line(row: SettingRow) -> str:
    """A line for an env file of compose, systemd and shells; values with secrets are commented out."""
    line = f"{row.variable}={_quote(_words(row.value))}"
    if row.hidden:
        return f"# {line}  has a secret, which is not shown"
    return f"# {line}" if row.source == "default" else line


def _quote(text: str) -> str:
    if re.fullmatch(r"[\w./:,@%+=-]*", text, re.ASCII):
        return text
    if "'" not in text:
        return f"'{text}'"
    return '"' + re.sub(r'(["\\$`])', r"\\\1", text) + '"'
