"""Errors of the command's words."""

from __future__ import annotations

import pytest

from equimesh_cli import main


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("", "the following arguments are required: COMMAND; see equimesh --help"),
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
