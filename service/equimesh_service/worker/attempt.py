"""One attempt at a mesh: its log context and its spans."""

from collections.abc import Iterator
from contextlib import contextmanager

from equimesh_service.store.rows import Claim
from equimesh_service.telemetry import tracing
from equimesh_service.telemetry.log_context import LogContext
from equimesh_service.telemetry.tracing import Attributes


def log_context_of(claim: Claim) -> LogContext:
    """The log context of an attempt at a mesh; it continues that of the request."""
    return LogContext(request_id=claim.request_id or "", mesh_id=claim.mesh_id, key_id=claim.key_id)


@contextmanager
def attempt(claim: Claim) -> Iterator[None]:
    """The spans of an attempt at a mesh: its time in the queue, which is over, and what a worker does."""
    tracer = tracing.current()
    if tracer is None or claim.trace is None:
        yield
        return
    tracer.record("queue wait", claim.trace, claim.claimed_at - claim.waited, claim.claimed_at)
    attributes: Attributes = {"equimesh.mesh.id": claim.mesh_id, "equimesh.mesh.attempt": claim.attempt}
    with tracer.span("attempt", attributes, parent=claim.trace):
        yield
