"""Spans of OpenTelemetry, sent by OTLP over HTTP. Imported only when traces are requested."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import version

from opentelemetry.context import Context
from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
from opentelemetry.sdk.resources import Resource
from opentelemetry.sdk.trace import TracerProvider
from opentelemetry.sdk.trace.export import BatchSpanProcessor
from opentelemetry.trace import SpanKind, StatusCode, get_current_span
from opentelemetry.trace.propagation.tracecontext import TraceContextTextMapPropagator

from equimesh_service.telemetry.tracing import Attributes

_W3C = TraceContextTextMapPropagator()
# Short, since a worker that is stopped loses spans that it has not sent.
_DELAY_MILLISECONDS = 500
_TIMEOUT_SECONDS = 5


class OpenTelemetryTracer:
    """A :class:`~equimesh_service.telemetry.tracing.Tracer` with a provider of its own, one for each service."""

    def __init__(self, endpoint: str, part: str) -> None:
        who: Attributes = {
            "service.name": "equimesh",
            "service.version": version("equimesh"),
            "equimesh.part": part,
            "process.pid": os.getpid(),
        }
        self._provider = TracerProvider(resource=Resource.create(who), shutdown_on_exit=False)
        exporter = OTLPSpanExporter(endpoint=endpoint, timeout=_TIMEOUT_SECONDS)
        self._provider.add_span_processor(BatchSpanProcessor(exporter, schedule_delay_millis=_DELAY_MILLISECONDS))
        self._tracer = self._provider.get_tracer("equimesh")

    @contextmanager
    def span(
        self, name: str, attributes: Attributes, *, parent: str | None = None, serves: bool = False
    ) -> Iterator[None]:
        """A span for the length of a ``with``; an exception marks it as failed, without the message."""
        with self._tracer.start_as_current_span(
            name,
            context=_context(parent),
            kind=SpanKind.SERVER if serves else SpanKind.INTERNAL,
            attributes=attributes,
            record_exception=False,
            set_status_on_exception=False,
        ) as span:
            try:
                yield
            except BaseException as error:
                span.set_attribute("error.type", type(error).__name__)
                span.set_status(StatusCode.ERROR)
                raise

    def record(self, name: str, parent: str, start: float, end: float) -> None:
        """Send a span that has ended; times in seconds since 1970."""
        span = self._tracer.start_span(name, context=_context(parent), start_time=_nanoseconds(start))
        span.end(_nanoseconds(end))

    def describe(self, name: str, attributes: Attributes, *, failed: bool) -> None:
        """Set the name, the attributes and the status of the current span."""
        span = get_current_span()
        span.update_name(name)
        span.set_attributes(attributes)
        if failed:
            span.set_status(StatusCode.ERROR)

    def traceparent(self) -> str | None:
        """The current span as a W3C traceparent."""
        carrier: dict[str, str] = {}
        _W3C.inject(carrier)
        return carrier.get("traceparent")

    def close(self) -> None:
        """Send all spans that are left."""
        self._provider.shutdown()


def _context(parent: str | None) -> Context | None:
    return None if parent is None else _W3C.extract({"traceparent": parent}, Context())


def _nanoseconds(seconds: float) -> int:
    return int(seconds * 1e9)
