"""Traces, as an option: spans that cross from a request into a worker. Without a tracer all of this does nothing."""

from collections.abc import Mapping
from contextlib import AbstractContextManager, nullcontext
from contextvars import ContextVar
from typing import Protocol

Attributes = Mapping[str, str | int | float]


class Tracer(Protocol):
    """Makes spans. ``parent`` is a W3C traceparent; without one, spans belong to the current one."""

    def span(
        self, name: str, attributes: Attributes, *, parent: str | None = None, serves: bool = False
    ) -> AbstractContextManager[None]:
        """A span for the length of a ``with``; ``serves`` for that of a request."""
        ...

    def record(self, name: str, parent: str, start: float, end: float) -> None:
        """A span that is over; times in seconds since 1970."""
        ...

    def describe(self, name: str, attributes: Attributes, *, failed: bool) -> None:
        """Name the current span, and say how it went."""
        ...

    def traceparent(self) -> str | None:
        """The current span, for other spans to continue."""
        ...

    def close(self) -> None:
        """Send what is left."""
        ...


_tracer: ContextVar[Tracer | None] = ContextVar("tracer", default=None)
_NOTHING = nullcontext()
_PLAIN: Attributes = {}


def current() -> Tracer | None:
    """The tracer of this thread or task, None where no traces are requested."""
    return _tracer.get()


def use(tracer: Tracer | None) -> None:
    """Let this thread, or task, make its spans with ``tracer`` from now on."""
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
