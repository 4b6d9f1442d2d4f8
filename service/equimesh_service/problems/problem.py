"""Errors over the wire: problem details (RFC 9457), and one table from exceptions to problems."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.responses import Response

from equimesh.errors import ExpressionError, InputError
from equimesh_service.telemetry.log_context import current

MEDIA_TYPE = "application/problem+json"


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


@dataclass(frozen=True, kw_only=True)
class Complaint:
    """One thing wrong with the input: where (a JSON pointer), what, and where inside an expression."""

    pointer: str
    message: str
    position: Mapping[str, int] | None = None
    parameter: str | None = None

    def body(self) -> dict[str, Any]:
        """The entry of the problem's ``errors``."""
        entry: dict[str, Any] = {"pointer": self.pointer, "message": self.message}
        if self.position is not None:
            entry["position"] = dict(self.position)
        if self.parameter is not None:
            entry["parameter"] = self.parameter
        return entry


@dataclass(eq=False)
class Problem(Exception):
    """A problem to be answered, or to be kept as the ``error`` of a failed mesh.

    ``remedy`` is what to do about this very case; without one, that of the kind is given.
    """

    name: str
    detail: str
    errors: Sequence[Complaint] = ()
    headers: Mapping[str, str] = field(default_factory=dict)
    remedy: str = ""

    def __str__(self) -> str:
        return f"{self.name}: {self.detail}"

    @property
    def kind(self) -> Kind:
        """The entry of the table of kinds."""
        return KINDS[self.name]

    def body(self) -> dict[str, Any]:
        """The JSON object of RFC 9457, without ``status``: for the ``error`` of a mesh."""
        kind = self.kind
        body: dict[str, Any] = {
            "type": kind.type,
            "title": kind.title,
            "detail": self.detail,
            "remedy": self.remedy or kind.remedy,
        }
        if self.errors:
            body["errors"] = [complaint.body() for complaint in self.errors]
        return body

    def response(self) -> Response:
        """The HTTP answer."""
        body = self.body()
        return answer(body, self.kind.status, self.headers)


def answer(body: Mapping[str, Any], status: int, headers: Mapping[str, str] | None = None) -> Response:
    """The response that carries a problem's body; any text is safe in it, lone surrogates included."""
    told = {**body, "status": status}
    if status >= 500 and (request_id := current().request_id):
        told["request_id"] = request_id  # by which the log is searched
    content = json.dumps(told, allow_nan=False).encode()
    return Response(content, status, dict(headers or {}), media_type=MEDIA_TYPE)


def invalid(pointer: str, message: str, *, parameter: str | None = None) -> Problem:
    """A 422 for one thing wrong."""
    return refused([Complaint(pointer=pointer, message=message, parameter=parameter)])


def refused(complaints: Sequence[Complaint]) -> Problem:
    """A 422 for everything wrong; the detail repeats the first complaint."""
    first = complaints[0]
    where = first.parameter or first.pointer
    more = f" (and {len(complaints) - 1} more)" if len(complaints) > 1 else ""
    detail = f"{where}: {first.message}{more}" if where else f"{first.message}{more}"
    return Problem("invalid-input", detail, complaints)


def complaint_of(error: InputError, pointer: str) -> Complaint:
    """What the solver said of the input, at the place in the body that it belongs to."""
    position = None
    if isinstance(error, ExpressionError) and error.position is not None:
        place = error.position
        position = {"offset": place.offset, "line": place.line, "column": place.column}
    return Complaint(pointer=pointer, message=error.message, position=position)


def problem_of(error: Exception) -> Problem:
    """The table from exceptions to problems; an exception that is not in it is an internal error."""
    match error:
        case Problem():
            return error
        case RequestValidationError():
            return refused([_parameter_complaint(entry) for entry in error.errors()])
        case HTTPException(status_code=405):
            allowed = (error.headers or {}).get("Allow", "")
            return Problem("method-not-allowed", f"This path takes {allowed}.", headers=dict(error.headers or {}))
        case HTTPException(status_code=404):
            return Problem("not-found", "No such path.")
        case HTTPException(status_code=status) if 400 <= status < 500:
            return Problem("malformed-body", str(error.detail))
        case InputError():
            return refused([complaint_of(error, "")])
        case _:
            return Problem("internal-error", "An unexpected error; the service's log has the details.")


def _parameter_complaint(entry: Mapping[str, Any]) -> Complaint:
    place = [str(part) for part in entry["loc"]]
    return Complaint(pointer="", message=str(entry["msg"]), parameter=place[-1] if place else None)
