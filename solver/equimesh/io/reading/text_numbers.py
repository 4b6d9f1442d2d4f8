"""Many numbers from a text at once, with the line of the first word that is no number."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from equimesh.errors import InputError
from equimesh.numerics.types import Array, IntArray

# Bytes of a text that are searched at once for a bad word.
PIECE = 1 << 16

_GAP = re.compile(rb"\s")
T = TypeVar("T", np.int64, np.float64)


def integers(text: bytes, first_line: int, what: str) -> IntArray:
    """The integers of ``text``, which begins in line ``first_line`` of a file; ``what`` they are, for messages.

    Raises :class:`~equimesh.errors.InputError` with the line of the first word that is no integer.
    """
    return _numbers(text, np.int64, first_line, what)


def floats(text: bytes, first_line: int, what: str) -> Array:
    """The real numbers of a text, as by :func:`integers`, to the last bit."""
    return _numbers(text, np.float64, first_line, what)


def line_of(data: bytes, place: int) -> int:
    """The number of the line, from 1, in which byte ``place`` is."""
    return data.count(b"\n", 0, place) + 1


def _numbers(text: bytes, kind: type[T], first_line: int, what: str) -> npt.NDArray[T]:
    last = text.rsplit(None, 1)[-1:]
    if not last:
        return np.empty(0, kind)
    try:
        found = np.fromstring(text, kind, sep=" ")
        # Old versions of NumPy stop at a bad word; then the last number is not the last word.
        end = int(last[0]) if kind is np.int64 else float(last[0])
        whole = bool(len(found)) and (end == found[-1] or end != end)
    except (ValueError, DeprecationWarning):
        whole = False
    if not whole:
        line, word = _first_bad(text, kind)
        noun = "integer" if kind is np.int64 else "number"
        raise InputError(f"line {first_line + line}: {word[:30]!r} is no {noun}, among {what}", field="file")
    return found


def _first_bad(text: bytes, kind: type[T]) -> tuple[int, str]:
    """The line, from 0, and the first word that is no number of this kind."""
    before, left = 0, len(text)
    for lines in _pieces(text):
        left -= len(lines)
        if not left or not _is_good(lines, kind):
            for number, line in enumerate(lines.split(b"\n")):
                for word in line.split():
                    if not _is_number(word, kind):
                        return before + number, word[:PIECE].decode("latin-1")
        before += lines.count(b"\n")
    return 0, text[:30].decode("latin-1")


def _pieces(text: bytes) -> Iterator[bytes]:
    """The text in pieces of some length that end between words."""
    at = 0
    while at < len(text):
        gap = _GAP.search(text, min(at + PIECE, len(text)))
        end = gap.start() if gap else len(text)
        yield text[at:end]
        at = end


def _is_good(text: bytes, kind: type[T]) -> bool:
    """Whether NumPy reads every word of a piece."""
    if b"_" in text or not text.isascii():
        return False
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # old versions of NumPy only warn of a bad word
        try:
            np.fromstring(text, kind, sep=" ")
        except (ValueError, DeprecationWarning):
            return False
    return True


def _is_number(word: bytes, kind: type[T]) -> bool:
    if b"_" in word or not word.isascii():
        return False
    try:
        kind(int(word) if kind is np.int64 else float(word))
    except (ValueError, OverflowError):
        return False
    return True
