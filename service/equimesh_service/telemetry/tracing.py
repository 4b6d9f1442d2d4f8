"""Traces, as an option: spans that cross from a request into a worker. Without a tracer all of this does nothing."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar
from typing import Protocol

from equimesh_service.store.rows import Claim

Attributes = Mapping[str, str | int | float]


class TracingMissingError(OSError):
    """Traces are asked for, and OpenTelemetry is not installed."""


class Tracer(Protocol):
    """Makes spans. ``parent`` is a W3C traceparent; without one, spans belong to the current one."""

    def span(
        self,
        name: str,
        attributes: Attributes,
        *,
        parent: str | None = None,
        serves: bool = False,
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
        """The current span, for others to go on from."""
        ...

    def close(self) -> None:
        """Send what is left."""
        ...


_tracer: ContextVar[Tracer | None] = ContextVar("tracer", default=None)
_NOTHING = nullcontext()
_PLAIN: Attributes = {}


def open_tracer(endpoint: str, part: str) -> Tracer | None:
    """A tracer that sends to an OTLP/HTTP address, None for an empty one; ``part`` is "service" or "worker".

    Raises :class:`TracingMissingError`.
    """
    if not endpoint:
        return None
    try:
        from equimesh_service.telemetry.spans import OpenTelemetryTracer
    except ImportError as error:
        raise TracingMissingError(
            f"traces need OpenTelemetry ({error.name} is missing): pip install 'equimesh[tracing]', "
            "or leave EQUIMESH_TRACE_ENDPOINT empty"
        ) from None
    return OpenTelemetryTracer(endpoint, part)


def use(tracer: Tracer | None) -> None:
    """Let this thread, or task, make its spans with ``tracer`` from now on."""
    _tracer.set(tracer)


def span(name: str, attributes: Attributes = _PLAIN) -> AbstractContextManager[None]:
    """A span under the current one, for the length of a ``with``."""
    tracer = _tracer.get()
    return _NOTHING if tracer is None else tracer.span(name, attributes)


def follow(name: str, parent: str | None) -> AbstractContextManager[None]:
    """A span under one of another process; nothing without ``parent``."""
    tracer = _tracer.get()
    return _NOTHING if tracer is None or parent is None else tracer.span(name, _PLAIN, parent=parent)


def traceparent() -> str | None:
    """The current span as a W3C traceparent, for the store."""
    tracer = _tracer.get()
    return None if tracer is None else tracer.traceparent()


@contextmanager
def attempt(claim: Claim) -> Iterator[None]:
    """The spans of an attempt at a mesh: its time in the queue, which is over, and what a worker does."""
    tracer = _tracer.get()
    if tracer is None or claim.trace is None:
        yield
        return
    tracer.record("queue wait", claim.trace, claim.claimed_at - claim.waited, claim.claimed_at)
    told: Attributes = {"equimesh.mesh.id": claim.mesh_id, "equimesh.mesh.attempt": claim.attempt}
    with tracer.span("attempt", told, parent=claim.trace):
        yield
