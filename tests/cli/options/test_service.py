"""The database of a service, as options, and its errors."""

from __future__ import annotations

import errno
import sqlite3

import pytest
from sqlalchemy.exc import OperationalError

from equimesh_cli.options.service import (
    add_database_options,
    add_settings,
    database_settings,
    explicit_settings,
    merged_settings,
    refusing_database_errors,
    start_error,
)
from equimesh_cli.parser import CommandError, Exit, Parser

pytestmark = pytest.mark.usefixtures("no_variables")


def test_the_options_name_the_database() -> None:
    parser = Parser()
    add_database_options(parser)
    settings = database_settings(parser.parse_args(["--data-dir", "here"]))
    assert (str(settings.data_dir), settings.workers) == ("here", database_settings(parser.parse_args([])).workers)


@pytest.mark.parametrize(
    ("error", "kind"),
    [
        (sqlite3.DatabaseError("postgresql://ada:secret@h/n"), "DatabaseError"),
        (OperationalError("select", {}, ConnectionRefusedError("ada:secret@h")), "ConnectionRefusedError"),
    ],
)
def test_an_error_is_refused_without_its_text(error: Exception, kind: str) -> None:
    with pytest.raises(CommandError) as caught, refusing_database_errors():
        raise error
    assert caught.value.code is Exit.UNREACHABLE
    assert f"does not answer ({kind})" in str(caught.value)
    assert "secret" not in str(caught.value)


def test_an_option_wins_over_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    parser = Parser(prog="equimesh serve")
    add_settings(parser)
    explicit = explicit_settings(parser.parse_args(["--port", "9000"]))
    assert explicit == {"port": "9000"}
    monkeypatch.setenv("EQUIMESH_PORT", "8001")
    monkeypatch.setenv("EQUIMESH_WORKERS", "3")
    settings = merged_settings(explicit)
    assert (settings.port, settings.workers) == (9000, 3)


def test_a_bad_value_names_option_and_variable() -> None:
    with pytest.raises(CommandError, match=r"--port \(or EQUIMESH_PORT\) = many: this must be a whole number$"):
        merged_settings({"port": "many"})


def test_an_error_of_the_system_says_what_to_change() -> None:
    settings = merged_settings({"port": "80"})
    for error, words in (
        (OSError(errno.EADDRINUSE, "Address already in use"), "choose another with --port"),
        (OSError(errno.EACCES, "Permission denied", "x/db"), "choose one with --data-dir"),
        (OSError(errno.ENOSPC, "No space left"), "cannot use the data folder equimesh-data (No space left); choose"),
        (OSError(errno.EACCES, "Permission denied"), "cannot serve on 127.0.0.1 port 80: Permission denied"),
    ):
        assert words in start_error(settings, error)
