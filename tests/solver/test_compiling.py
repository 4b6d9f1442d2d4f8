"""The line about compiling: at a terminal and in a notebook alone, and gone when the loops are compiled."""

from __future__ import annotations

import io
import sys
from typing import Any

import numba
import pytest

from equimesh import compiling
from equimesh.numerics import compiled


class Terminal(io.StringIO):
    """Standard error of a terminal."""

    def isatty(self) -> bool:
        return True


class Cell(io.StringIO):
    """Standard error of the cell of a notebook."""


Cell.__module__ = "ipykernel.iostream"


@pytest.fixture
def loop(monkeypatch: pytest.MonkeyPatch) -> Any:
    """A loop that is one of the project's, and calls another one."""
    inner = numba.njit(lambda x: x + 1)
    outer = numba.njit(lambda x: inner(x))
    monkeypatch.setattr(compiled, "_loops", [inner, outer])
    monkeypatch.setattr(compiling._listener, "_counted", float("-inf"))
    monkeypatch.setattr(compiling._listener, "line", compiling.Line())
    monkeypatch.delenv("EQUIMESH_QUIET", raising=False)
    return outer


@pytest.mark.parametrize("stream", [Terminal, Cell])
def test_a_person_sees_how_many_loops_are_compiled(loop: Any, stream: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", stream())
    loop(1)
    first, *_, last = sys.stderr.getvalue().split("\r")[1:]
    assert first == "Compiling the numerical loops, once in this environment: 0 of at most 2"
    assert last == "", "the line is removed"
    shown = sys.stderr.getvalue()
    loop(2)
    assert sys.stderr.getvalue() == shown, "nothing is compiled"
    assert compiled.count_compiled() == (2, 2)


def test_other_programs_see_nothing(loop: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    loop(1)
    assert sys.stderr.getvalue() == ""


@pytest.mark.parametrize("quiet", ["variable", "silence", "announcing"])
def test_it_can_be_switched_off(loop: Any, quiet: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", Terminal())
    if quiet == "variable":
        monkeypatch.setenv("EQUIMESH_QUIET", "1")
        loop(1)
    elif quiet == "silence":
        compiling.silence()
        loop(1)
    else:
        with compiling.announcing(None):
            loop(1)
    assert sys.stderr.getvalue() == ""


@pytest.mark.usefixtures("loop")
def test_loops_of_other_packages_are_none_of_ours(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", Terminal())
    numba.njit(lambda x: x - 1)(1)
    assert sys.stderr.getvalue() == ""


def test_a_line_is_no_longer_than_the_terminal_is_wide(loop: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", Terminal())
    monkeypatch.setenv("COLUMNS", "30")
    loop(1)
    assert max(map(len, sys.stderr.getvalue().split("\r"))) == 29


def test_a_log_has_a_line_for_each_tenth_of_the_loops(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    monkeypatch.delenv("EQUIMESH_QUIET", raising=False)
    line = compiling.Line(plain=True)
    for done in (0, 1, 2, 3, 4, 4, 19, 20):
        line.show(done, 20)
    sentence = compiling.SENTENCE
    assert sys.stderr.getvalue().splitlines() == [
        f"{sentence} ...",
        f"{sentence}: 2 of 20",
        f"{sentence}: 4 of 20",
        f"{sentence}: 19 of 20",
        f"{sentence}: 20 of 20",
    ]


def test_a_log_of_one_solve_has_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    monkeypatch.delenv("EQUIMESH_QUIET", raising=False)
    line = compiling.Line(plain=True)
    for done in (0, 10, 20):
        line.show(done, 20, are_all_needed=False)
    assert sys.stderr.getvalue() == f"{compiling.SENTENCE} ...\n"
