"""Cursors of the lists of meshes and sequences: the end of a page, as a text that a client sends back.

For callers who see all meshes it is the number of the last mesh. For a key that sees only its own it is the time and
the id of the last mesh, since the number would reveal how many meshes others request. Neither depends on other meshes.
"""

import math
import re
from struct import pack, unpack

from equimesh_service.api.routing import MAX_NUMBER
from equimesh_service.problems.problem import Problem, problem_at
from equimesh_service.store.rows import MeshRow, Position

_NUMBER = re.compile(r"[0-9a-f]{1,16}")
_MOMENT = re.compile(r"([0-9a-f]{16})([!-~]{1,40})")


def cursor_of(row: MeshRow, key_id: str | None) -> str:
    """The cursor of a page that ends with this mesh, for one key, or None for callers who see all meshes."""
    return f"{row.number:x}" if key_id is None else cursor_at(row.created_at, row.id)


def cursor_at(created_at: float, name: str) -> str:
    """The cursor of a page that ends with what was made at this time and has this id."""
    return f"{pack('>d', created_at).hex()}{name}"


def position_of(cursor: str, key_id: str | None) -> Position:
    """The end of the page of this cursor; raises a 422 problem."""
    if key_id is None:
        number = int(cursor, 16) if _NUMBER.fullmatch(cursor) else 0
        if 0 < number < MAX_NUMBER:
            return (number,)
        raise _invalid_cursor()
    return moment_of(cursor)


def moment_of(cursor: str) -> tuple[float, str]:
    """The time and the id of a cursor of :func:`cursor_at`; raises a 422 problem."""
    found = _MOMENT.fullmatch(cursor)
    if found is None:
        raise _invalid_cursor()
    [moment] = unpack(">d", bytes.fromhex(found[1]))
    if not math.isfinite(moment):
        raise _invalid_cursor()
    return moment, found[2]


def _invalid_cursor() -> Problem:
    return problem_at("", "not a cursor of this list", parameter="cursor")
