"""A line on standard error while loops are compiled, at a terminal or in a notebook; other programs see nothing.

The first use in an environment compiles loops, which takes a minute or more. ``EQUIMESH_QUIET=1`` shows nothing.
"""

from __future__ import annotations

import os
import shutil
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from equimesh.numerics.compiled import Compiled

SENTENCE = "Compiling the numerical loops, once in this environment"
# Seconds between two counts: a count takes about 10 ms.
_COUNT_SECONDS = 0.5


class Line:
    """The line, which is overwritten at each change and removed at the end.

    A ``plain`` line is also shown where standard error is neither a terminal nor a notebook, as in a log: the sentence
    once, and the count whenever another tenth of the loops is compiled, if all are needed.
    """

    def __init__(self, *, plain: bool = False) -> None:
        self._plain = plain
        self._tenths: int | None = None
        self._shown = ""

    def show(self, compiled: int, of: int, *, are_all_needed: bool = True) -> None:
        """Show how many loops are compiled, ``of`` how many; one solve needs some of them."""
        if sys.stderr is None or os.environ.get("EQUIMESH_QUIET", "0") not in ("", "0"):
            return
        if is_live():
            text = f"{SENTENCE}: {compiled} of {'' if are_all_needed else 'at most '}{of}"
            text = text[: shutil.get_terminal_size().columns - 1]
            self._write("\r" + text.ljust(len(self._shown)))
            self._shown = text
        elif self._plain:
            self._tell(compiled, of, 10 * compiled // max(of, 1) if are_all_needed else 0)

    def _tell(self, compiled: int, of: int, tenths: int) -> None:
        if self._tenths is None:
            self._write(f"{SENTENCE} ...\n")
        elif tenths > self._tenths:
            self._write(f"{SENTENCE}: {compiled} of {of}\n")
        self._tenths = max(self._tenths or 0, tenths)

    def clear(self) -> None:
        """Remove the line."""
        if self._shown:
            self._write("\r" + " " * len(self._shown) + "\r")
            self._shown = ""

    def _write(self, text: str) -> None:
        sys.stderr.write(text)
        sys.stderr.flush()


class _Listener:
    """Shows the current line while a loop of the project is compiled."""

    line: Line | None = Line()

    def __init__(self) -> None:
        self._depth = 0  # a loop is compiled while its caller is
        self._count: Compiled | None = None
        self._counted = float("-inf")

    def notify(self, found: Any) -> None:
        """Take an event of Numba: the start, or the end, of the compiling of a function."""
        from equimesh.numerics.compiled import is_loop

        if self.line is None or not is_loop(found.data["dispatcher"]):
            return
        if found.is_start:
            self._begin(self.line)
        elif found.is_end:
            self._end(self.line)

    def _begin(self, line: Line) -> None:
        from equimesh.numerics.compiled import count_compiled

        self._depth += 1
        if self._count is None or time.monotonic() - self._counted > _COUNT_SECONDS:
            self._count, self._counted = count_compiled(), time.monotonic()
        line.show(*self._count, are_all_needed=False)

    def _end(self, line: Line) -> None:
        self._depth -= 1
        if self._depth == 0:
            line.clear()


_listener = _Listener()


def watch() -> None:
    """Show a line from now on, whenever this process compiles a loop at a terminal or in a notebook."""
    from numba.core import event

    event.Listener.register(_Listener)
    event.register("numba:compile", _listener)  # type: ignore[no-untyped-call]


def silence() -> None:
    """Show nothing in this process, and in those that are forked from it."""
    _listener.line = None


@contextmanager
def announcing(line: Line | None) -> Iterator[None]:
    """Show this line, or nothing, inside."""
    before, _listener.line = _listener.line, line
    try:
        yield
    finally:
        _listener.line = before


def is_live() -> bool:
    """Whether standard error is a terminal, or the cell of a notebook, where a line can be overwritten."""
    stream = sys.stderr
    return type(stream).__module__.startswith("ipykernel") or stream.isatty()
