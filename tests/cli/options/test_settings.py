"""The settings of a service, as options."""

from __future__ import annotations

import errno

import pytest

from equimesh_cli.options.service import add_settings, explicit_settings, merged_settings, start_error
from equimesh_cli.parser import CommandError, Parser

pytestmark = pytest.mark.usefixtures("no_variables")


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
    with pytest.raises(CommandError, match=r"--port \(or EQUIMESH_PORT\) = many: "):
        merged_settings({"port": "many"})


def test_an_error_of_the_system_says_what_to_change() -> None:
    settings = merged_settings({"port": "80"})
    for error, words in (
        (OSError(errno.EADDRINUSE, "Address already in use"), "choose another with --port"),
        (OSError(errno.EACCES, "Permission denied", "x/db"), "choose one with --data-dir"),
        (OSError(errno.EACCES, "Permission denied"), "cannot serve on 127.0.0.1 port 80: Permission denied"),
    ):
        assert words in start_error(settings, error)
