"""Strict reading of JSON, without the duplicate keys and lone surrogates that `json` accepts."""

import json
import re
from collections.abc import Iterator
from typing import Any

from equimesh_service.problems.problem import Problem, problem_at
from equimesh_service.spec.bounds import (
    MAX_KEYS_OF_OBJECT,
    MAX_LISTS_OF_OBJECT,
    MAX_NAME,
    MAX_PLAIN_VALUES,
    check_bounds,
)

_SURROGATE_ESCAPE = re.compile(rb"\\u[dD][89a-fA-F]")


def parse(data: bytes, most_values: int = MAX_PLAIN_VALUES) -> Any:
    """The value of a JSON text.

    NaN and infinities are read: the models refuse them, with a pointer. Raises a 400
    :class:`~equimesh_service.problems.problem.Problem` for anything that is not JSON in UTF-8, for a key that occurs
    twice in an object, and for every bound of :mod:`equimesh_service.spec.bounds`; a 413 problem for more than
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
    """The part of ``pointer`` that exists in ``document``: it ends at a text that stands for an expression."""
    place, kept = document, ""
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
