"""`equimesh config`: the settings in force, and where each comes from."""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from equimesh_cli.exits import Exit, NotInstalled
from equimesh_cli.options.settings import add_settings, explicit_settings, merged_settings
from equimesh_cli.parser import add_command

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


@dataclass(frozen=True, kw_only=True)
class Shown:
    """A setting as it may be shown. ``source`` is "default", "environment" or "option"."""

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
    )
    form = parser.add_mutually_exclusive_group()
    form.add_argument("--json", action="store_true", help="print JSON")
    form.add_argument("--env", action="store_true", help="print lines for a file of variables, defaults commented out")
    parser.set_defaults(run=run)
    if full:
        add_settings(parser)


def run(options: argparse.Namespace) -> int:
    """Print all settings; complain of variables that are none."""
    try:
        from equimesh_service.settings import describe_unknown, find_unknown
    except ImportError as error:
        raise NotInstalled("service", error) from error
    options_given = explicit_settings(options)
    rows = shown(merged_settings(options_given), options_given)
    foreign = find_unknown(os.environ)
    if options.json:
        print(json.dumps({"settings": [asdict(row) for row in rows], "unknown": foreign}, indent=2))
    elif options.env:
        print("\n".join(map(_line, rows)))
    else:
        for row in rows:
            print(f"{row.name:<26}{row.source:<13}{_words(row.value)}")
    for name, nearest in foreign.items():
        print(f"equimesh: {describe_unknown(name, nearest)}", file=sys.stderr)
    return Exit.DONE


def shown(settings: Settings, options: dict[str, str]) -> list[Shown]:
    """All settings, in their order, without their secrets; ``options`` are those that were given as such."""
    from equimesh_service.settings import variable

    environment = {name.upper() for name in os.environ}
    rows = []
    for name in type(settings).model_fields:
        value, hidden = _without_secret(name, getattr(settings, name))
        source = "option" if name in options else "environment" if variable(name) in environment else "default"
        rows.append(Shown(name=name, variable=variable(name), value=value, source=source, hidden=hidden))
    return rows


def _without_secret(name: str, value: Any) -> tuple[str | int | float | bool, bool]:
    """A value as it may be shown, and whether something of it is hidden."""
    from pydantic import SecretStr

    if isinstance(value, SecretStr):
        secret = value.get_secret_value()
        told = _database(secret) if name == "database_url" else HIDDEN if secret else ""
        return told, told != secret
    if isinstance(value, bool | int | float):
        return value, False
    text = str(value)
    told = _address(text) if "://" in text else text
    return told, told != text


def _database(url: str) -> str:
    """The address of a database without its password, wherever that stands."""
    from sqlalchemy.engine import make_url
    from sqlalchemy.exc import ArgumentError

    if not url:
        return ""
    try:
        address = make_url(url)
    except (ArgumentError, ValueError):
        return HIDDEN
    if address.query.get("password"):
        address = address.update_query_dict({"password": HIDDEN})
    return address.render_as_string(hide_password=True)


def _address(url: str) -> str:
    """An address without what may be secret in it: what stands before an @, and the values of a query."""
    before, mark, query = re.sub(r"//[^/?#]*@", f"//{HIDDEN}@", url).partition("?")
    return before + mark + re.sub(r"=[^&#]*", f"={HIDDEN}", query)


def _words(value: str | int | float | bool) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.12g}" if isinstance(value, float) else str(value)


def _line(row: Shown) -> str:
    """A line for an env file, as compose, systemd and shells read it; what has a secret is for its owner to fill in."""
    line = f"{row.variable}={_quoted(_words(row.value))}"
    if row.hidden:
        return f"# {line}  has a secret, which is not shown"
    return f"# {line}" if row.source == "default" else line


def _quoted(text: str) -> str:
    if re.fullmatch(r"[\w./:,@%+=-]*", text, re.ASCII):
        return text
    if "'" not in text:
        return f"'{text}'"
    return '"' + re.sub(r'(["\\$`])', r"\\\1", text) + '"'
