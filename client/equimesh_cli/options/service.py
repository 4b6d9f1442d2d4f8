"""Options of a service: its address, its database, its settings."""

from __future__ import annotations

import argparse
import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Literal, get_args, get_origin

from equimesh_cli.parser import CommandError, Exit, NotInstalled, Parser

if TYPE_CHECKING:
    from equimesh_service.settings import Settings


# Options for the address of a service.

DEFAULT_URL = "http://127.0.0.1:8000"


def add_url(parser: Any, *, default: str | None) -> None:
    """Add --url and --key, which EQUIMESH_URL and EQUIMESH_KEY also set."""
    shown_default = f" ({default})" if default else ""
    parser.add_argument(
        "--url",
        default=os.environ.get("EQUIMESH_URL") or default,
        help=f"address of the service; also EQUIMESH_URL{shown_default}",
    )
    parser.add_argument(
        "--key", help="API key; better in EQUIMESH_KEY, since other users of this machine can read options"
    )


# Options for the settings of a service.


def add_settings(parser: Parser) -> None:
    """Add an option for every setting of the service."""
    try:
        from equimesh_service.settings import Settings, groups
    except ImportError as error:
        parser.lacks = str(NotInstalled("service", error))
        return
    for title, names in groups().items():
        group = parser.add_argument_group(title)
        for name in names:
            field = Settings.model_fields[name]
            default = field.get_default(call_default_factory=True)
            shown = str(default).lower() if isinstance(default, bool) else default
            argument = group.add_argument(
                "--" + name.replace("_", "-"),
                dest=f"setting_{name}",
                metavar=name.upper(),
                help=f"{field.description} ({shown})".replace("%", "%%").replace(" ()", ""),
            )
            argument.words = _words_of(field.annotation)  # type: ignore[attr-defined]


def _words_of(annotation: Any) -> tuple[str, ...]:
    """The words that a setting may have, for the completion in a shell; none where it may have any value."""
    if annotation is bool:
        return "true", "false"
    return get_args(annotation) if get_origin(annotation) is Literal else ()


def explicit_settings(options: argparse.Namespace) -> dict[str, str]:
    """The settings that were given as options, by name."""
    return {
        name.removeprefix("setting_"): value
        for name, value in vars(options).items()
        if name.startswith("setting_") and value is not None
    }


def merged_settings(explicit: dict[str, str]) -> Settings:
    """The ``explicit`` settings, the others from the environment; raises :class:`CommandError` for invalid values."""
    from pydantic import ValidationError

    from equimesh_service.settings import Settings

    try:
        return Settings(**explicit)  # type: ignore[arg-type]
    except ValidationError as error:
        raise CommandError("\n".join(map(_complaint, error.errors()))) from None


def start_error(settings: Settings, error: OSError) -> str:
    """The message for an error of the system when a service starts: its folder or its address cannot be used."""
    cause = error.strerror or str(error)
    if error.filename is not None or error.errno == errno.ENOSPC:
        place = "" if error.filename is None else f"{error.filename}: "
        return f"cannot use the data folder {settings.data_dir} ({place}{cause}); choose one with --data-dir"
    if error.errno == errno.EADDRINUSE:
        return f"port {settings.port} of {settings.host} is in use: choose another with --port, 0 takes a free one"
    return f"cannot serve on {settings.host} port {settings.port}: {cause}"


def _complaint(entry: Any) -> str:
    from equimesh_service.problems.problem import sentence_of

    said = sentence_of(entry) or str(entry["msg"]).removeprefix("Value error, ")
    if not entry["loc"]:  # of several settings together
        return said
    name = "_".join(str(part) for part in entry["loc"])
    flag, variable = "--" + name.replace("_", "-"), f"EQUIMESH_{name.upper()}"
    return f"{flag} (or {variable}) = {entry['input']}: {said}"


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
    """Raise :class:`CommandError` for a database that does not answer."""
    import sqlite3

    from sqlalchemy.exc import SQLAlchemyError

    try:
        yield
    except (SQLAlchemyError, sqlite3.Error) as error:
        raise CommandError(
            f"the database does not answer ({cause(error)}): check its address, and that it can be reached",
            Exit.UNREACHABLE,
        ) from None


def cause(error: Exception) -> str:
    """The kind of a database error. Its text is never shown: it may hold the address with the password."""
    return type(getattr(error, "orig", None) or error).__name__
