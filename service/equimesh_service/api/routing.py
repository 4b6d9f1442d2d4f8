"""The parts that routes share: the service, the caller, problems, and the cursors of lists."""

from __future__ import annotations

import math
import re
from struct import pack, unpack
from typing import Annotated, Any, cast

from fastapi import Depends, Request, Security
from fastapi.dependencies.models import Dependant
from fastapi.routing import APIRoute
from fastapi.security import HTTPBearer, SecurityScopes
from pydantic import BaseModel

from equimesh_service.admission.callers import Caller
from equimesh_service.problems.problem import MEDIA_TYPE, Problem, did_you_mean, problem_at
from equimesh_service.service import Service
from equimesh_service.store.keys import ADMIN, READ, WRITE
from equimesh_service.store.rows import MeshRow, Position
from equimesh_service.telemetry import log_context
from equimesh_service.wire.headers import add_headers

MAX_NUMBER = 2**62

_MEANINGS = {
    400: "The body or a header cannot be read.",
    401: "API key required, or this one is unknown or revoked.",
    403: "Forbidden: the API key does not allow this, or a service without keys does not know the host or the origin.",
    404: "Not found.",
    406: "Not acceptable: no such format.",
    408: "Request timeout: the body did not arrive in time.",
    409: "The mesh is not in a state for this.",
    410: "Expired and removed (EQUIMESH_RETENTION_DAYS).",
    412: "The file has changed: If-Match names another one.",
    413: "Body too large.",
    415: "Unsupported media type.",
    416: "Range not satisfiable: the file ends before it.",
    422: "Invalid input: `errors` says where and what.",
    429: "Too many requests, or too many meshes: see Retry-After.",
    503: "Service unavailable.",
    507: "Storage full.",
}


def problems(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """The documentation of error answers."""
    return {
        status: {
            "description": _MEANINGS[status],
            "content": {MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/ProblemDetails"}}},
        }
        for status in statuses
    }


async def _service(request: Request) -> Service:  # async, since FastAPI would use a thread otherwise
    return cast(Service, request.app.state.service)


ServiceDependency = Annotated[Service, Depends(_service)]

# The problems of every route with a caller: of its key, and of query parameters that there are not.
KEY_PROBLEMS = problems(401, 403, 422, 429)
# The answers to ranges and conditions of a request for a file.
FILE_ANSWERS: dict[int | str, dict[str, Any]] = {
    206: {"description": "The part that Range requests."},
    304: {"description": "If-None-Match names the same bytes."},
    **problems(412, 416),
}


class _Callers(HTTPBearer):
    """Finds the callers of requests; a scheme of OpenAPI and the dependency that uses it in one."""

    # FastAPI takes longer over a dependency than over a query parameter.
    async def __call__(self, request: Request, scopes: SecurityScopes) -> Caller:  # type: ignore[override]
        """The caller; raises a 401, 403 or 429 problem."""
        given = await super().__call__(request)
        service = await _service(request)
        caller = await service.callers.identify(None if given is None else given.credentials)
        log_context.current().key_id = caller.key_id
        add_headers(request, service.quotas.count_request(caller))
        missing = set(scopes.scopes) - caller.scopes
        if missing:
            needed, owned = ", ".join(sorted(missing)), ", ".join(sorted(caller.scopes))
            raise Problem("forbidden", f"This needs a key with the scope {needed}; this one has {owned}.")
        _check_parameters(request)
        return caller


_TO_WAIT = "; to wait for a mesh that is requested, send the header Prefer: wait=30"


def _check_parameters(request: Request) -> None:
    """Raise a 422 problem for a query parameter that the route does not have: a misspelled one would do nothing."""
    if not request.scope["query_string"]:
        return
    known = _parameters(request.scope["route"])
    for name in request.query_params:
        if name not in known:
            listed = f"; known are {', '.join(known)}" if known else ""
            hint = _TO_WAIT if name == "wait" else did_you_mean(name, known)
            message = f"there is no such parameter here{listed}{hint}"
            raise problem_at("", message, parameter=name[:80])


def _parameters(route: APIRoute) -> tuple[str, ...]:
    """The names of the query parameters of a route, and of all that its dependencies have."""
    found: list[str] = []
    left: list[Dependant] = [route.dependant]
    while left:
        dependant = left.pop()
        left += dependant.dependencies
        for field in dependant.query_params:
            model = field.field_info.annotation
            if isinstance(model, type) and issubclass(model, BaseModel):
                found += model.model_fields
            else:
                found.append(field.alias)
    return tuple(found)


_callers = _Callers(
    auto_error=False,
    scheme_name="ApiKey",
    bearerFormat="em_<id>_<secret>",
    description="An API key that `equimesh keys create` printed. None is required before the first is created.",
)
# A caller with at least this scope.
Reader = Annotated[Caller, Security(_callers, scopes=[READ])]
Writer = Annotated[Caller, Security(_callers, scopes=[WRITE])]
Admin = Annotated[Caller, Security(_callers, scopes=[ADMIN])]


_NUMBER = re.compile(r"[0-9a-f]{1,16}")
_MOMENT = re.compile(r"([0-9a-f]{16})([!-~]{1,40})")


def cursor_of(row: MeshRow, key_id: str | None) -> str:
    """The cursor of a page that ends with this mesh, for one key, or None for callers who see all meshes."""
    return f"{row.number:x}" if key_id is None else cursor_at(row.created_at, row.id)


def cursor_at(created_at: float, name: str) -> str:
    """The cursor of a page that ends with what was made at this time and has this id."""
    return f"{pack('>d', created_at).hex()}{name}"


def position_of(cursor: str, key_id: str | None) -> Position:
    """The end of the page of this cursor; raises a 422 problem."""
    if key_id is None:
        number = int(cursor, 16) if _NUMBER.fullmatch(cursor) else 0
        if 0 < number < MAX_NUMBER:
            return (number,)
        raise _invalid_cursor()
    return moment_of(cursor)


def moment_of(cursor: str) -> tuple[float, str]:
    """The time and the id of a cursor of :func:`cursor_at`; raises a 422 problem."""
    found = _MOMENT.fullmatch(cursor)
    if found is None:
        raise _invalid_cursor()
    [moment] = unpack(">d", bytes.fromhex(found[1]))
    if not math.isfinite(moment):
        raise _invalid_cursor()
    return moment, found[2]


def _invalid_cursor() -> Problem:
    return problem_at("", "not a cursor of this list", parameter="cursor")
