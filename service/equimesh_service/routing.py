"""What all routes share: the service behind them, and the problems that they document."""

from __future__ import annotations

from typing import Annotated, Any, cast

from fastapi import Depends, Request

from equimesh_service.problems import MEDIA_TYPE
from equimesh_service.service import Service

LARGEST = 2**62

_MEANINGS = {
    400: "The body or a header cannot be read.",
    404: "There is no such thing.",
    406: "No such format.",
    409: "The mesh is not in a state for this.",
    413: "The body is too large.",
    415: "The body's type is not supported.",
    416: "The file ends before the range.",
    422: "The input cannot be used: `errors` says where and what.",
    429: "Too many meshes are waiting.",
    503: "The service cannot do this now.",
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


def _service(request: Request) -> Service:
    return cast(Service, request.app.state.service)


ServiceDependency = Annotated[Service, Depends(_service)]
