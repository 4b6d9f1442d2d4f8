"""The log context of a request: its id, its mesh and its API key, which every log line carries."""

import re
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass

# Short, and safe in a header, a log line and a column of the store.
_SAFE_ID = re.compile(r"[A-Za-z0-9._:-]{1,64}", re.ASCII)


@dataclass(kw_only=True)
class LogContext:
    """The fields that a log line carries; "" stands for unknown.

    Mutable: the middleware creates it before key and mesh are known, and routes fill these in.
    """

    request_id: str = ""
    mesh_id: str = ""
    key_id: str = ""

    def to_fields(self) -> dict[str, str]:
        """The known fields, by name."""
        return {name: value for name, value in vars(self).items() if value}


_current: ContextVar[LogContext | None] = ContextVar("log_context", default=None)


def current() -> LogContext:
    """The current context; an empty one outside of requests and attempts."""
    return _current.get() or LogContext()


@contextmanager
def enter(context: LogContext) -> Iterator[None]:
    """Make ``context`` the current one for the length of a ``with``."""
    token = _current.set(context)
    try:
        yield
    finally:
        _current.reset(token)


def choose_request_id(given: str | None) -> str:
    """The client's id of a request when it is short and safe, else a new one."""
    return given if given is not None and _SAFE_ID.fullmatch(given) else secrets.token_hex(12)
