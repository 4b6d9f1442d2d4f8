"""Errors over the wire: problem details (RFC 9457), their kinds, and one table from exceptions to problems."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from typing import Any

from starlette.exceptions import HTTPException
from starlette.responses import Response

from equimesh.errors import ExpressionError, InputError, SamplesError
from equimesh_schema.mesh import WITHOUT_NUL
from equimesh_service.errors import ServiceError
from equimesh_service.telemetry.log_context import current

# The table of problems: every error over the wire, with its status and remedy.


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


# The sentences for values that do not fit: one for each fault that models and parameters of requests can have.

# The most characters of an unknown word that is compared with the known ones.
_MAX_COMPARED = 40
# How similar the nearest word has to be, from 0 to 1.
_MIN_SIMILARITY = 0.6


def did_you_mean(given: object, known: Iterable[str]) -> str:
    """The end of a sentence about an unknown word: the known word that is nearest to it, "" where none is near."""
    if not isinstance(given, str):
        return ""
    by_lower = {word.lower(): word for word in known}
    near = get_close_matches(given[:_MAX_COMPARED].lower(), by_lower, n=1, cutoff=_MIN_SIMILARITY)
    return f"; did you mean {by_lower[near[0]]!r}?" if near else ""


def sentence_of(entry: Mapping[str, Any]) -> str | None:
    """The sentence for an entry of pydantic's errors; None for a type that has no sentence here."""
    make = _SENTENCES.get(entry["type"])
    return make(entry) if callable(make) else make


def _length_of_text(entry: Mapping[str, Any]) -> str:
    return f"this text may have at most {entry['ctx']['max_length']} characters"


def _too_many(entry: Mapping[str, Any]) -> str:
    most = entry["ctx"]["max_length"]
    if entry["ctx"]["field_type"] != "List":
        return f"this object may have at most {most} keys"
    return "this must be a list of 2 items" if most == 2 else f"this must be a list of at most {most} items"


def _choice(entry: Mapping[str, Any]) -> str:
    expected = str(entry["ctx"]["expected"])
    return f"this must be {expected}{did_you_mean(entry['input'], expected.split(chr(39))[1::2])}"


def _pattern(entry: Mapping[str, Any]) -> str:
    if entry["ctx"]["pattern"] == WITHOUT_NUL:
        return "this text must not hold the character U+0000"
    return f"this text must have the form {entry['ctx']['pattern']}"


def _at_least(entry: Mapping[str, Any]) -> str:
    return f"this must be at least {entry['ctx']['ge']}"


def _more_than(entry: Mapping[str, Any]) -> str:
    return f"this must be more than {entry['ctx']['gt']:g}"


def _at_most(entry: Mapping[str, Any]) -> str:
    return f"this must be at most {entry['ctx']['le']}"


_EXAMPLES = {"grid": ', such as {"n_xi": 33, "n_eta": 33}'}
_PLACES_OF_SAMPLES = (
    "this must be a text, the id of uploaded samples or upload: give samples in the document as grid, nodal, scattered"
    " or block_nodes in place of samples"
)


def _last_of(entry: Mapping[str, Any]) -> str:
    """The key of the value that is wrong; empty for the document itself."""
    return str((entry.get("loc") or [""])[-1])


def _object(entry: Mapping[str, Any]) -> str:
    return "this must be a JSON object" + _EXAMPLES.get(_last_of(entry), "")


def _list(entry: Mapping[str, Any]) -> str:
    in_table = isinstance((entry.get("loc") or [""])[-1], int)
    return "this must be a list" + (" of numbers: a table is a list of rows" if in_table else "")


def _text(entry: Mapping[str, Any]) -> str:
    return _PLACES_OF_SAMPLES if _last_of(entry) == "samples" else "this must be a text"


_NUMBER = "this must be a number"
_WHOLE_NUMBER = "this must be a whole number"
_SWITCH = "this must be true or false"
_SENTENCES: Mapping[str, str | Callable[[Mapping[str, Any]], str]] = {
    "model_type": _object,
    "dataclass_type": _object,
    "dict_type": _object,
    "list_type": _list,
    "string_type": _text,
    "string_unicode": "this text holds half of a surrogate pair; send whole characters",
    "string_too_long": _length_of_text,
    "string_pattern_mismatch": _pattern,
    "int_type": _WHOLE_NUMBER,
    "int_parsing": _WHOLE_NUMBER,
    "int_parsing_size": "this whole number has too many digits",
    "int_from_float": _WHOLE_NUMBER,
    "float_type": _NUMBER,
    "float_parsing": _NUMBER,
    "finite_number": "this must be a finite number, not NaN or infinity",
    "bool_type": _SWITCH,
    "bool_parsing": _SWITCH,
    "literal_error": _choice,
    "too_short": "this must be a list of 2 items",
    "too_long": _too_many,
    "greater_than": _more_than,
    "greater_than_equal": _at_least,
    "less_than_equal": _at_most,
    "missing": "this is required",
}


MEDIA_TYPE = "application/problem+json"


@dataclass(frozen=True, kw_only=True)
class Complaint:
    """One fault of the input: its JSON pointer, a message, and the position in an expression.

    ``columns`` are those of a file, where the sender has to say which is u.
    """

    pointer: str
    message: str
    position: Mapping[str, int] | None = None
    parameter: str | None = None
    columns: Sequence[str] = ()

    def body(self) -> dict[str, Any]:
        """The entry of the problem's ``errors``."""
        entry: dict[str, Any] = {"pointer": self.pointer, "message": self.message}
        if self.position is not None:
            entry["position"] = dict(self.position)
        if self.parameter is not None:
            entry["parameter"] = self.parameter
        if self.columns:
            entry["columns"] = list(self.columns)
        return entry


@dataclass(eq=False)
class Problem(ServiceError):
    """A problem: the answer to a request, or the ``error`` of a failed mesh.

    ``remedy`` is for this case; without one, the remedy of the kind is used.
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
        """The JSON object of RFC 9457 without ``status``, as for the ``error`` of a mesh."""
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
        status = self.kind.status
        body = {**self.body(), "status": status}
        if status >= 500 and (request_id := current().request_id):
            body["request_id"] = request_id  # to search the log
        content = json.dumps(body, allow_nan=False).encode()  # in ASCII, so that lone surrogates are safe
        return Response(content, status, dict(self.headers), media_type=MEDIA_TYPE)


def problem_at(pointer: str, message: str, *, parameter: str | None = None) -> Problem:
    """A 422 problem for one fault."""
    return input_problem([Complaint(pointer=pointer, message=message, parameter=parameter)])


def input_problem(complaints: Sequence[Complaint]) -> Problem:
    """A 422 problem for all faults; the detail repeats the first complaint."""
    first = complaints[0]
    where = first.parameter or first.pointer
    more = f" (and {len(complaints) - 1} more)" if len(complaints) > 1 else ""
    detail = f"{where}: {first.message}{more}" if where else f"{first.message}{more}"
    return Problem("invalid-input", detail, complaints)


def repointed(problem: Problem, pointer_of: Callable[[str], str]) -> Problem:
    """The same 422 problem with other pointers."""
    return input_problem([replace(complaint, pointer=pointer_of(complaint.pointer)) for complaint in problem.errors])


def complaint_of(error: InputError, pointer: str) -> Complaint:
    """The complaint about an input error of the solver, with the pointer into the body."""
    position = None
    if isinstance(error, ExpressionError) and error.position is not None:
        place = error.position
        position = {"offset": place.offset, "line": place.line, "column": place.column}
    columns = error.columns if isinstance(error, SamplesError) else ()
    pointer += "".join(f"/{k}" for k in error.index) if isinstance(error, SamplesError) else ""
    return Complaint(pointer=pointer, message=error.message, position=position, columns=columns)


def problem_of(error: Exception) -> Problem:
    """The table from exceptions to problems; an exception that is not in it is an internal error."""
    from fastapi.exceptions import RequestValidationError  # workers answer no requests, and have no FastAPI

    match error:
        case Problem():
            return error
        case RequestValidationError():
            return input_problem([_parameter_complaint(entry) for entry in error.errors()])
        case HTTPException(status_code=405):
            allowed = (error.headers or {}).get("Allow", "")
            return Problem("method-not-allowed", f"This path takes {allowed}.", headers=dict(error.headers or {}))
        case HTTPException(status_code=404):
            return Problem("not-found", "No such path.")
        case HTTPException(status_code=status) if 400 <= status < 500:
            return Problem("malformed-body", str(error.detail))
        case InputError():
            return input_problem([complaint_of(error, "")])
        case _:
            return Problem("internal-error", "An unexpected error; the service's log has the details.")


def _parameter_complaint(entry: Mapping[str, Any]) -> Complaint:
    place = [str(part) for part in entry["loc"]]
    message = sentence_of(entry) or "this does not fit here"
    return Complaint(pointer="", message=message, parameter=place[-1] if place else None)
