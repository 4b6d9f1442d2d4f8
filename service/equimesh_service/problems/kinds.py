"""The table of problems: every error over the wire, with its status and what to do."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Kind:
    """One stable type of problem: ``/problems/<name>``, its HTTP status, title and what to do about it."""

    name: str
    status: int
    title: str
    remedy: str

    @property
    def type(self) -> str:
        """The relative URI that clients match on; it never changes."""
        return f"/problems/{self.name}"


KINDS: Mapping[str, Kind] = {
    kind.name: kind
    for kind in (
        Kind("malformed-body", 400, "The body cannot be read", "Send one UTF-8 JSON object, or multipart parts."),
        Kind("malformed-header", 400, "A header cannot be used", "Correct the header that the detail names."),
        Kind(
            "unauthorized",
            401,
            "A key is needed",
            "Send the header 'Authorization: Bearer em_...'; `equimesh keys create` makes a key.",
        ),
        Kind("forbidden", 403, "The key does not allow this", "Use a key with the scope that the detail names."),
        Kind("not-found", 404, "There is nothing here", "Check the path and the id; see /docs for all paths."),
        Kind("method-not-allowed", 405, "This path does not take this method", "See the Allow header."),
        Kind("not-acceptable", 406, "No such format", "Ask for one of the formats in /v1/capabilities."),
        Kind("request-timeout", 408, "The body did not come in time", "Send it again, over a faster connection."),
        Kind("conflict", 409, "Not in this state", "Read the mesh's status first."),
        Kind("not-finished", 409, "The mesh is not finished", "Wait with GET /v1/meshes/{id}?wait=30."),
        Kind("canceled", 409, "The mesh was canceled", "Post its spec again to compute it."),
        Kind("gone", 410, "It was removed after its time", "Post the spec, or the samples, again."),
        Kind(
            "precondition-failed",
            412,
            "The file is another one",
            "Ask without If-Match, and start from its first byte.",
        ),
        Kind("body-too-large", 413, "The body is too large", "Send fewer samples, or samples as npz."),
        Kind("unsupported-media-type", 415, "The body's type is not supported", "Send the type the detail names."),
        Kind("range-not-satisfiable", 416, "The file ends before this range", "Ask for bytes below the file's size."),
        Kind("invalid-input", 422, "The input cannot be used", "Correct each entry of 'errors'."),
        Kind(
            "idempotency-key-reused",
            422,
            "This Idempotency-Key belongs to another request",
            "Use a new key for a new request, or repeat the first request exactly.",
        ),
        Kind("queue-full", 429, "Too many meshes are waiting", "Try again after the Retry-After time."),
        Kind(
            "quota-exceeded",
            429,
            "The key has as much as it may have",
            "Wait until meshes are finished, or delete what is no longer needed; the detail says which limit it is.",
        ),
        Kind("rate-limited", 429, "Too many requests", "Try again after the Retry-After time."),
        Kind("internal-error", 500, "The service made a mistake", "Report it, with the request that caused it."),
        Kind("unavailable", 503, "The service cannot do this now", "Try again; see /readyz for what is wrong."),
        Kind(
            "storage-full",
            507,
            "The service has no room left",
            "Delete meshes and samples that are no longer needed, or give the service more room; then try again.",
        ),
        # Endings of a solve: they stand in the mesh's `error`, and answer requests for its file.
        Kind(
            "not-converged",
            409,
            "The Schwarz iteration did not reach its tolerance",
            "Raise max_iterations or tolerance, use the optimized transmission, or solve as a single domain. "
            "The partial mesh, when it is not folded, downloads with ?partial=true.",
        ),
        Kind(
            "newton-failed",
            409,
            "Newton's method did not converge",
            "Lower a, raise b, use boundary = trace and initial = nested, or use more points where u is steep.",
        ),
        Kind("folded", 409, "The mesh folded", "Lower a, raise b, use boundary = trace, or use more points."),
        Kind("time-limit", 409, "The time limit was reached", "Ask for fewer points, or raise EQUIMESH_TIME_LIMIT."),
        Kind(
            "memory-limit",
            409,
            "The memory limit was reached",
            "Ask for fewer points or more subdomains, or raise EQUIMESH_MEMORY_LIMIT.",
        ),
        Kind(
            "worker-lost",
            409,
            "The workers that ran this mesh died",
            "Post the spec again; if it happens again, give the workers more memory.",
        ),
    )
}
