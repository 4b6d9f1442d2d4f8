"""Errors of the command's words."""

from __future__ import annotations

import pytest

from equimesh_cli import main
from equimesh_cli.command import GROUPS, build_parser
from equimesh_cli.parser import Parser


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("serve --prt 3", "unrecognized arguments: --prt 3; see equimesh serve --help"),
        ("keys list x", "unrecognized arguments: x; see equimesh keys list --help"),
    ],
)
def test_the_command_that_knows_its_options_refuses_others(
    words: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as caught:
        main(words.split())
    assert (caught.value.code, capsys.readouterr().err) == (2, f"equimesh: {said}\n")


def test_the_help_lists_every_command_once_under_its_group() -> None:
    said = build_parser().format_help()
    for title, names in GROUPS.items():
        section = said.split(f"\n{title}:\n")[1].split("\n\n")[0]
        assert [line.split()[0] for line in section.splitlines()] == list(names)
    below = next(action for action in build_parser()._actions if action.dest == "command")
    assert sorted(name for names in GROUPS.values() for name in names) == sorted(below.choices or ())


def test_paragraphs_are_filled_and_lists_are_not(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    parser = Parser(prog="p", description=20 * "word ", epilog="examples:\n  " + 80 * "x" + "\n\n" + 20 * "more ")
    said = parser.format_help().splitlines()
    assert "  " + 80 * "x" in said
    assert sum(line.startswith("word") for line in said) == 2
    assert sum(line.startswith("more") for line in said) == 2
