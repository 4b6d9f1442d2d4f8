"""The table of problems: every error over the wire, with its status and remedy."""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Kind:
    """One stable type of problem, ``/problems/<name>``: its HTTP status, title and remedy."""

    name: str
    status: int
    title: str
    remedy: str

    @property
    def type(self) -> str:
        """The relative URI that clients match on; it never changes."""
        return f"/problems/{self.name}"


# The solver writes the remedy of a failed solve, for its problem.
_REMEDY_OF_SOLVE = "Follow the remedy in the mesh's error, which fits its spec."

KINDS: Mapping[str, Kind] = {
    kind.name: kind
    for kind in (
        Kind("malformed-body", 400, "Malformed body", "Send one UTF-8 JSON object, or multipart parts."),
        Kind("malformed-header", 400, "Malformed header", "Correct the header that the detail names."),
        Kind(
            "unauthorized",
            401,
            "API key required",
            "Send the header 'Authorization: Bearer em_...'; `equimesh keys create` makes a key.",
        ),
        Kind("forbidden", 403, "Forbidden", "Use a key with the scope that the detail names."),
        Kind(
            "unknown-host",
            403,
            "Unknown host",
            "Use localhost or 127.0.0.1, or add the host to EQUIMESH_ALLOWED_HOSTS, or create a key with "
            "`equimesh keys create`.",
        ),
        Kind(
            "foreign-origin",
            403,
            "Foreign origin",
            "Use the pages of the service itself, or a program that is no browser. A proxy has to pass the header Host "
            "on.",
        ),
        Kind("not-found", 404, "Not found", "Check the path and the id; see /docs for all paths."),
        Kind("method-not-allowed", 405, "Method not allowed", "See the Allow header."),
        Kind("not-acceptable", 406, "Not acceptable", "Request one of the formats in /v1/capabilities."),
        Kind("request-timeout", 408, "Request timeout", "Send it again over a faster connection."),
        Kind("conflict", 409, "Conflict", "Read the mesh's status first."),
        Kind("not-finished", 409, "Mesh not finished", "Wait with GET /v1/meshes/{id}?wait=30."),
        Kind("canceled", 409, "Mesh canceled", "Post its spec again to compute it."),
        Kind("gone", 410, "Expired and removed", "Post the spec, or the samples, again."),
        Kind("precondition-failed", 412, "The file has changed", "Download it without If-Match, from its first byte."),
        Kind("body-too-large", 413, "Body too large", "Send fewer samples, or samples as npz."),
        Kind("unsupported-media-type", 415, "Unsupported media type", "Send the type that the detail names."),
        Kind("range-not-satisfiable", 416, "Range not satisfiable", "Request bytes below the size of the file."),
        Kind("headers-too-large", 431, "Headers too large", "Send shorter headers, and a shorter query."),
        Kind("invalid-input", 422, "Invalid input", "Correct each entry of 'errors'."),
        Kind(
            "idempotency-key-reused",
            422,
            "Idempotency-Key reused",
            "Use a new key for a new request, or repeat the first request exactly.",
        ),
        Kind("queue-full", 429, "Queue full", "Try again after the Retry-After time."),
        Kind(
            "quota-exceeded",
            429,
            "Quota exceeded",
            "Wait until meshes are finished, or delete what is no longer needed; the detail says which limit it is.",
        ),
        Kind("rate-limited", 429, "Rate limit exceeded", "Try again after the Retry-After time."),
        Kind("internal-error", 500, "Internal error", "Report it, with the request that caused it."),
        Kind("unavailable", 503, "Service unavailable", "Try again; /readyz says what is wrong."),
        Kind("workers-busy", 503, "Workers busy", "Try again, or request the mesh itself, which waits in the queue."),
        Kind(
            "storage-full",
            507,
            "Storage full",
            "Delete meshes and samples that are no longer needed, or give the service more storage; then try again.",
        ),
        # Failed meshes: the problem is the `error` of the mesh, and the answer to requests for its file.
        Kind("not-converged", 409, "Schwarz iteration not converged", _REMEDY_OF_SOLVE),
        Kind("newton-failed", 409, "Newton's method not converged", _REMEDY_OF_SOLVE),
        Kind("folded", 409, "Mesh folded", _REMEDY_OF_SOLVE),
        Kind("time-limit", 409, "Time limit reached", "Request fewer points, or raise EQUIMESH_TIME_LIMIT."),
        Kind(
            "memory-limit",
            409,
            "Memory limit reached",
            "Request fewer points or more subdomains, or raise EQUIMESH_MEMORY_LIMIT.",
        ),
        Kind(
            "cluster-refused",
            409,
            "Refused by the cluster",
            "Follow the detail: request fewer points or other parts, or give the cluster more workers or memory.",
        ),
        Kind(
            "worker-lost",
            409,
            "Workers lost",
            "Post the spec again; if it happens again, give the workers more memory.",
        ),
    )
}
