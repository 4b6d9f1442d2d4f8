"""Strict reading of JSON, without duplicate keys and lone surrogates, and bounds that are checked before."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from equimesh_service.problems.problem import Problem, problem_at

# Bounds of a JSON text, checked in one pass over its bytes before anything is built of it.
#
# A text of many bytes may hold many numbers, and little else: specs have few keys and short texts. The pass stops at
# the first bound that is exceeded.

# The most objects and lists inside one another; a spec has 8.
MAX_DEPTH = 32
# The most keys of one object; a spec has at most 64, the parameters of an expression, besides the names of blocks.
MAX_KEYS_OF_OBJECT = 128
# The most keys of an object of lists: the vertices of a description of blocks by their names.
MAX_LISTS_OF_OBJECT = 1024
# The most keys of all objects together: 1024 vertices, and as many edges and blocks with two to four keys each.
MAX_KEYS = 8192
# The most texts, keys included: the same, with the names of the vertices of every edge and block.
MAX_TEXTS = 20_000
# The most bytes of one text: an expression of 4096 characters, each of them escaped.
MAX_TEXT_BYTES = 32 * 1024
# The most bytes of all texts: 30 functions and curves of such expressions.
MAX_TEXTS_BYTES = 1024 * 1024
# The most characters of a key.
MAX_NAME = 256
# The most digits in a row; more than 400 make a number infinite.
MAX_DIGITS = 10_000
# The most values of a body that are not samples: the points of four curves, and everything else.
MAX_PLAIN_VALUES = 200_000

# Shorter pieces are read faster without arrays.
_SHORT_BYTES = 512
# The bytes that are looked at in one go, so that other threads run in between.
_WINDOW_BYTES = 256 * 1024
_SIGNS = re.compile(rb"[\[\]{},:]|[0-9]{%d}" % (MAX_DIGITS + 1))
_COMMA, _COLON = ord(","), ord(":")


def _steps() -> npt.NDArray[np.int8]:
    """By byte: how it changes the depth."""
    table = np.zeros(256, dtype=np.int8)
    table[[ord("["), ord("{")]] = 1
    table[[ord("]"), ord("}")]] = -1
    return table


_STEPS = _steps()


@dataclass
class _Count:
    """What was found so far."""

    most_values: int
    depth: int = 0
    values: int = 1
    keys: int = 0
    digits: int = 0

    def read(self, data: bytes, start: int, end: int) -> None:
        """Count what stands between two texts."""
        if end - start <= _SHORT_BYTES:
            self._read_short(data, start, end)
        else:
            for begin in range(start, end, _WINDOW_BYTES):
                self._read_window(data, begin, min(end, begin + _WINDOW_BYTES))
                self._check()
        self._check()

    def _check(self) -> None:
        if self.values > self.most_values:
            raise Problem("body-too-large", f"The body has more than {self.most_values} values.")
        if self.keys > MAX_KEYS:
            raise Problem("malformed-body", f"The body has more than {MAX_KEYS} keys: no request has so many.")

    def _read_short(self, data: bytes, start: int, end: int) -> None:
        for found in _SIGNS.finditer(data, start, end):
            sign = found[0]
            if sign == b",":
                self.values += 1
            elif sign == b":":
                self.keys += 1
            elif sign in b"[{":
                self.depth += 1
                self.values += 1
                _check_depth(self.depth)
            elif sign in b"]}":
                self.depth -= 1
            else:
                _refuse_digits()

    def _read_window(self, data: bytes, start: int, end: int) -> None:
        window = np.frombuffer(data, np.uint8, end - start, start)
        steps = _STEPS[window]
        depths = np.cumsum(steps, dtype=np.int32)
        _check_depth(self.depth + max(0, int(depths.max())))
        self.depth += int(depths[-1])
        self.values += int(np.count_nonzero(window == _COMMA)) + int(np.count_nonzero(steps == 1))
        self.keys += int(np.count_nonzero(window == _COLON))
        self._count_digits(window)

    def _count_digits(self, window: npt.NDArray[np.uint8]) -> None:
        """Find the longest row of digits, which may have begun in the window before."""
        others = np.flatnonzero((window < ord("0")) | (window > ord("9")))
        if not others.size:
            self.digits += window.size
            longest = self.digits
        else:
            inside = int(np.diff(others).max()) - 1 if others.size > 1 else 0
            longest = max(self.digits + int(others[0]), inside)
            self.digits = window.size - 1 - int(others[-1])
        if max(longest, self.digits) > MAX_DIGITS:
            _refuse_digits()


def check_bounds(data: bytes, most_values: int) -> None:
    """Raise a 413 problem for more than ``most_values`` values, and a 400 problem for every other bound.

    Bytes that are not JSON pass as far as they keep the bounds.
    """
    count, place, texts, size = _Count(most_values), 0, 0, 0
    while True:
        quote = data.find(b'"', place)
        count.digits = 0
        count.read(data, place, len(data) if quote < 0 else quote)
        if quote < 0:
            return
        texts += 1
        if texts > MAX_TEXTS:
            raise Problem("malformed-body", f"The body has more than {MAX_TEXTS} texts: no request has so many.")
        place = _end_of_text(data, quote + 1)
        size += place - quote
        if size > MAX_TEXTS_BYTES:
            raise Problem("malformed-body", f"The texts of the body have more than {MAX_TEXTS_BYTES} bytes.")


def _end_of_text(data: bytes, start: int) -> int:
    """The place after the closing quote of a text."""
    limit = start + MAX_TEXT_BYTES + 1
    place = start
    while (quote := data.find(b'"', place, limit)) >= 0:
        slashes = quote
        while slashes > start and data[slashes - 1] == 0x5C:
            slashes -= 1
        if (quote - slashes) % 2 == 0:
            return quote + 1
        place = quote + 1
    if limit < len(data):
        raise Problem("malformed-body", f"A text has more than {MAX_TEXT_BYTES} bytes: no request has so long a text.")
    return len(data)  # the text does not end


def _check_depth(depth: int) -> None:
    if depth > MAX_DEPTH:
        raise Problem("malformed-body", f"The JSON is nested too deeply: more than {MAX_DEPTH} objects and lists.")


def _refuse_digits() -> None:
    raise Problem("malformed-body", f"A number has more than {MAX_DIGITS} digits.")


_SURROGATE_ESCAPE = re.compile(rb"\\u[dD][89a-fA-F]")


def parse(data: bytes, most_values: int = MAX_PLAIN_VALUES) -> Any:
    """The value of a JSON text.

    NaN and infinities are read: the models refuse them, with a pointer. Raises a 400
    :class:`~equimesh_service.problems.problem.Problem` for anything that is not JSON in UTF-8, for a key that occurs
    twice in an object, and for every bound of :mod:`equimesh_service.spec.document`; a 413 problem for more than
    ``most_values`` values. The bounds are checked first: nothing is built of a text that exceeds them.
    """
    check_bounds(data, most_values)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise Problem("malformed-body", f"The body is not UTF-8: bad byte at offset {error.start}.") from None
    try:
        value = json.loads(text, object_pairs_hook=_object, parse_int=_integer)
    except json.JSONDecodeError as error:
        where = f"line {error.lineno}, column {error.colno}"
        raise Problem("malformed-body", f"The body is not JSON: {error.msg} at {where}.") from None
    except RecursionError:
        raise Problem("malformed-body", "The JSON is nested too deeply.") from None
    if _SURROGATE_ESCAPE.search(data):
        for pointer, string in _strings(value):
            if not _is_text(string):
                raise problem_at(pointer, "the text holds half of a surrogate pair; send whole characters")
    return value


def escape_token(part: object) -> str:
    """A slash and one reference token of a JSON pointer (RFC 6901), safe to encode."""
    token = str(part).encode("utf-8", "backslashreplace").decode()
    return "/" + token.replace("~", "~0").replace("/", "~1")


def sent_pointer(document: Any, pointer: str) -> str:
    """The part of ``pointer`` that exists in ``document``: it ends at a text that stands for an expression.

    A target that was sent as a number of points of the grid is there.
    """
    place, kept = document, ""
    if f"{pointer}/".startswith("/target/") and isinstance(document, dict) and document.get("target") is None:
        grid = document.get("grid")
        if isinstance(grid, dict) and grid.get("points") is not None:
            return "/grid/points"
    for token in pointer.split("/")[1:]:
        if isinstance(place, str) and token == "expression":
            break
        kept += "/" + token
        name = token.replace("~1", "/").replace("~0", "~")
        if isinstance(place, list):
            place = place[int(name)] if name.isdigit() and int(name) < len(place) else None
        else:
            place = place.get(name) if isinstance(place, dict) else None
    return kept


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    if len(pairs) > MAX_KEYS_OF_OBJECT:
        of_lists = all(isinstance(value, list) for _, value in pairs)
        most = MAX_LISTS_OF_OBJECT if of_lists else MAX_KEYS_OF_OBJECT
        if len(pairs) > most:
            raise Problem("malformed-body", f"An object has {len(pairs)} keys; at most {most} are read.")
    found = dict(pairs)
    if any(len(key) > MAX_NAME for key in found):
        raise Problem("malformed-body", f"A key has more than {MAX_NAME} characters.")
    if len(found) < len(pairs):
        seen: set[str] = set()
        for key, _ in pairs:
            if key in seen:
                shown = key.encode("utf-8", "backslashreplace").decode()[:80]
                raise Problem("malformed-body", f"The key {shown!r} comes twice in one object.")
            seen.add(key)
    return found


def _integer(digits: str) -> int | float:
    # Python refuses to read very long integers. They become infinite, which the models refuse.
    return int(digits) if len(digits) <= 400 else float("-inf" if digits.startswith("-") else "inf")


def _strings(value: Any) -> Iterator[tuple[str, str]]:
    """Every key and string with its pointer; without recursion, since the sender chooses the nesting."""
    left: list[tuple[str, Any]] = [("", value)]
    while left:
        pointer, member = left.pop()
        if isinstance(member, str):
            yield pointer, member
        elif isinstance(member, dict):
            yield from ((pointer, key) for key in member)
            left.extend((pointer + escape_token(key), child) for key, child in member.items())
        elif isinstance(member, list):
            left.extend((f"{pointer}/{index}", child) for index, child in enumerate(member))


def _is_text(string: str) -> bool:
    try:
        string.encode()
    except UnicodeEncodeError:
        return False
    return True
