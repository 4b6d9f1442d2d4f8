"""The database of a service, as options, and its errors."""

from __future__ import annotations

import sqlite3

import pytest
from sqlalchemy.exc import OperationalError

from equimesh_cli.options.service import add_database_options, database_settings, refusing_database_errors
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
