"""The log context and the spans of one attempt at a mesh."""

from collections.abc import Iterator
from contextlib import contextmanager

from equimesh_service.store.rows import Claim
from equimesh_service.telemetry import tracing
from equimesh_service.telemetry.log_context import LogContext
from equimesh_service.telemetry.tracing import Attributes


def log_context_of(claim: Claim) -> LogContext:
    """The log context of an attempt, with the id and the key of the request."""
    return LogContext(request_id=claim.request_id or "", mesh_id=claim.mesh_id, key_id=claim.key_id)


@contextmanager
def attempt(claim: Claim) -> Iterator[None]:
    """The spans of an attempt at a mesh: its past wait in the queue, and the work of the worker."""
    tracer = tracing.current()
    if tracer is None or claim.trace is None:
        yield
        return
    tracer.record("queue wait", claim.trace, claim.claimed_at - claim.waited, claim.claimed_at)
    attributes: Attributes = {"equimesh.mesh.id": claim.mesh_id, "equimesh.mesh.attempt": claim.attempt}
    with tracer.span("attempt", attributes, parent=claim.trace):
        yield
