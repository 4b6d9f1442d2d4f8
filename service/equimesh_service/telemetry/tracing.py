"""Optional traces: spans that cross from a request into a worker. Without a tracer these functions do nothing."""

from collections.abc import Mapping
from contextlib import AbstractContextManager, nullcontext
from contextvars import ContextVar
from typing import Protocol

Attributes = Mapping[str, str | int | float]


class Tracer(Protocol):
    """Creates spans. ``parent`` is a W3C traceparent; without it, the parent is the current span."""

    def span(
        self, name: str, attributes: Attributes, *, parent: str | None = None, serves: bool = False
    ) -> AbstractContextManager[None]:
        """A span for the length of a ``with``; ``serves`` marks that of a request."""
        ...

    def record(self, name: str, parent: str, start: float, end: float) -> None:
        """Send a span that has ended; times in seconds since 1970."""
        ...

    def describe(self, name: str, attributes: Attributes, *, failed: bool) -> None:
        """Set the name, the attributes and the status of the current span."""
        ...

    def traceparent(self) -> str | None:
        """The current span as a W3C traceparent."""
        ...

    def close(self) -> None:
        """Send all spans that are left."""
        ...


_tracer: ContextVar[Tracer | None] = ContextVar("tracer", default=None)
_NOTHING = nullcontext()
_PLAIN: Attributes = {}


def current() -> Tracer | None:
    """The tracer of this thread or task, None without traces."""
    return _tracer.get()


def use(tracer: Tracer | None) -> None:
    """Set the tracer of this thread or task."""
    _tracer.set(tracer)


def span(name: str, attributes: Attributes = _PLAIN) -> AbstractContextManager[None]:
    """A span under the current one, for the length of a ``with``."""
    tracer = _tracer.get()
    return _NOTHING if tracer is None else tracer.span(name, attributes)


def continue_span(name: str, parent: str | None) -> AbstractContextManager[None]:
    """A span under one of another process; nothing without ``parent``."""
    tracer = _tracer.get()
    return _NOTHING if tracer is None or parent is None else tracer.span(name, _PLAIN, parent=parent)


def traceparent() -> str | None:
    """The current span as a W3C traceparent, for the store."""
    tracer = _tracer.get()
    return None if tracer is None else tracer.traceparent()
