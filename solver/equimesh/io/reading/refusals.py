"""Whatever a reader of a file raises becomes an error that says so, in words of bounded length."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from equimesh.errors import InputError

# Characters of a message, at most: it may repeat parts of the file.
MAX_MESSAGE: Final = 500
# What readers raise for broken files. Anything else is a defect of a reader, and is logged as well.
EXPECTED: Final = (ArithmeticError, EOFError, LookupError, MemoryError, OSError, RuntimeError, TypeError, ValueError)

# The most bytes that a file unpacks to, in all: so many times its own, within these bounds.
MAX_EXPANSION, MIN_EXPANDED, MAX_EXPANDED = 100, 1 << 20, 1 << 31

_log = logging.getLogger(__name__)


def most_unpacked(size: int) -> int:
    """The most bytes that a file of ``size`` bytes may unpack to."""
    return min(max(MAX_EXPANSION * size, MIN_EXPANDED), MAX_EXPANDED)


@contextmanager
def refusing(name: str) -> Iterator[None]:
    """Raise every fault inside as :class:`~equimesh.errors.InputError`; ``name`` is that of the format."""
    try:
        yield
    except InputError as error:
        if len(error.message) <= MAX_MESSAGE and error.message.isprintable():
            raise
        raise type(error)(_shown(error.message, MAX_MESSAGE), field=_shown(error.field, MAX_MESSAGE)) from error
    except Exception as error:
        if not isinstance(error, EXPECTED):
            _log.exception("the reader of %s failed", name)
        words = "it needs more memory than there is" if isinstance(error, MemoryError) else _shown(str(error), 200)
        raise InputError(f"the {name} file cannot be read: {words}", field="file") from error


def _shown(text: str, most: int) -> str:
    """The begin of a text, in characters that every answer can hold."""
    cut = text if len(text) <= most else f"{text[: most - 4]} ..."
    return "".join(letter if letter.isprintable() else ascii(letter)[1:-1] for letter in cut)
