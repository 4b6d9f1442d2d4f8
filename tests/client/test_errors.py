"""Exceptions of the client, as words."""

from __future__ import annotations

from equimesh_client import InputProblem
from equimesh_client.errors import caret


def test_the_caret_knows_lines_tabs_and_the_end() -> None:
    assert caret("a\n\tb + c", line=2, column=4) == "    \tb + c\n    \t  ^"
    assert caret("ab", line=1, column=3) == "    ab\n      ^"
    for line, column in ((3, 1), (1, 0), (0, 1)):
        assert caret("ab", line=line, column=column) == ""
    assert str(InputProblem(pointer="", message="m")) == "m"
