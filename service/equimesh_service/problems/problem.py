"""Errors over the wire: problem details (RFC 9457), and one table from exceptions to problems."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.responses import Response

from equimesh.errors import ExpressionError, InputError, SamplesError
from equimesh_service.errors import ServiceError
from equimesh_service.problems.kinds import KINDS, Kind
from equimesh_service.problems.sentences import sentence_of
from equimesh_service.telemetry.log_context import current

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
    return Complaint(pointer=pointer, message=error.message, position=position, columns=columns)


def problem_of(error: Exception) -> Problem:
    """The table from exceptions to problems; an exception that is not in it is an internal error."""
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
