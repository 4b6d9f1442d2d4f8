"""The trail of a request: its id, the mesh and the API key that it is about, for every log line on the way."""

from __future__ import annotations

import re
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass

# Short, and safe in a header, a log line and a column of the store.
_SANE = re.compile(r"[A-Za-z0-9._:-]{1,64}", re.ASCII)


@dataclass(kw_only=True)
class Trail:
    """What a log line says of where it belongs; "" is not known.

    Not frozen: the middleware lays it down before anybody knows the key and the mesh, and routes fill these in.
    """

    request_id: str = ""
    mesh_id: str = ""
    key_id: str = ""

    def known(self) -> dict[str, str]:
        """All that is known, by name."""
        return {name: value for name, value in vars(self).items() if value}


_trail: ContextVar[Trail | None] = ContextVar("trail", default=None)


def current() -> Trail:
    """The trail of what runs now; an empty one outside of requests and attempts."""
    return _trail.get() or Trail()


@contextmanager
def follow(trail: Trail) -> Iterator[None]:
    """Make ``trail`` the current one for the length of a ``with``."""
    token = _trail.set(trail)
    try:
        yield
    finally:
        _trail.reset(token)


def request_id(given: str | None) -> str:
    """The client's id of a request when it is short and safe, else a new one."""
    return given if given is not None and _SANE.fullmatch(given) else secrets.token_hex(12)
