"""Opening a tracer, where traces are requested."""

from equimesh_service.errors import TracingMissingError
from equimesh_service.telemetry.tracing import Tracer


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
