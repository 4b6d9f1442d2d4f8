"""The route of a mesh's events, as a stream (Server-Sent Events) or as JSON."""

import json
import math
import time
from collections.abc import AsyncIterator
from contextlib import AbstractContextManager
from typing import Annotated, Any

from fastapi import APIRouter, Header, Query, Request
from fastapi.responses import JSONResponse
from fastapi.sse import KEEPALIVE_COMMENT, EventSourceResponse, format_sse_event
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from equimesh_service.admission.callers import Caller
from equimesh_service.api.resources import MeshEvents, event_resource
from equimesh_service.api.routing import KEY_PROBLEMS, MAX_NUMBER, Reader, ServiceDependency, problems
from equimesh_service.problems.problem import Problem
from equimesh_service.service import Service
from equimesh_service.store.rows import EventRow
from equimesh_service.wire.headers import choose_offer

router = APIRouter(prefix="/v1/meshes/{id}", tags=["meshes"], responses=KEY_PROBLEMS)

_OFFERS = {"stream": "text/event-stream", "json": "application/json"}
_EVENT = {
    "type": "object",
    "required": ["id", "event", "data"],
    "properties": {
        "id": {"type": "string", "pattern": "^[0-9]+$"},
        "event": {"type": "string", "enum": ["status", "progress", "done"]},
        "data": {"type": "string", "contentMediaType": "application/json"},
    },
}
_PING_SECONDS = 15.0
_RETRY_MILLISECONDS = 1000
# How often a quiet stream checks that the caller is still allowed in.
_RECHECK_SECONDS = 1.0


@router.get(
    "/events",
    summary="Follow a mesh",
    operation_id="getMeshEvents",
    response_model=None,
    responses={
        200: {
            "description": "Events `status`, `progress` and `done`; their ids are 1, 2, 3, …",
            "content": {
                "text/event-stream": {"itemSchema": _EVENT},
                "application/json": {"schema": {"$ref": "#/components/schemas/MeshEvents"}},
            },
        },
        204: {"description": "The mesh is finished, and no event follows Last-Event-ID."},
        **problems(404, 410, 406, 422),
    },
)
async def get_events(
    id: str,
    request: Request,
    service: ServiceDependency,
    caller: Reader,
    after: Annotated[int, Query(ge=0, le=MAX_NUMBER, description="Only events with larger ids.")] = 0,
    last_event_id: Annotated[
        str | None, Header(description="As `after`; browsers send it when they reconnect.")
    ] = None,
) -> Response:
    """A stream that ends with the event `done`; with `Accept: application/json`, the events so far."""
    kind = choose_offer(request.headers.get("accept"), _OFFERS)
    if kind is None:
        raise Problem("not-acceptable", "Events are text/event-stream or application/json.")
    row = await service.mesh(id, caller)
    if last_event_id is not None and last_event_id.isascii() and last_event_id.isdigit():
        after = max(after, min(int(last_event_id[:19]), MAX_NUMBER))
    if kind == "json":
        events = await run_in_threadpool(service.store.meshes.events, id, after=after)
        last = events[-1].number if events else after
        items = [event_resource(event) for event in events]
        done = row.finished and last >= row.last_event
        return JSONResponse(MeshEvents(items=items, last=last, done=done).model_dump(mode="json"))
    if row.finished and after >= row.last_event:
        return Response(status_code=204)  # a browser does not reconnect after it
    after = min(after, row.last_event)  # after the number of no event, the stream would not end
    return _Stream(_stream(service, id, after, caller), service.quotas.count_wait(caller, math.inf))


class _Stream(EventSourceResponse):
    """A stream that counts as a wait of the caller while it is sent."""

    def __init__(self, events: AsyncIterator[bytes], wait: AbstractContextManager[None]) -> None:
        super().__init__(events, headers={"Cache-Control": "no-store"})
        self._wait = wait

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        with self._wait:
            await super().__call__(scope, receive, send)


async def _stream(service: Service, mesh_id: str, after: int, caller: Caller) -> AsyncIterator[bytes]:
    yield format_sse_event(retry=_RETRY_MILLISECONDS)
    quiet_since, news = time.monotonic(), True
    while not service.wakeups.closing and await service.callers.is_valid(caller):
        events = await run_in_threadpool(service.store.meshes.events, mesh_id, after=after) if news else []
        for event in events:
            yield _wire(event)
            after = event.number
            if event.kind == "done":
                return
        if events:
            quiet_since = time.monotonic()
        elif time.monotonic() - quiet_since > _PING_SECONDS:
            quiet_since = time.monotonic()
            yield KEEPALIVE_COMMENT
        if news and not events and await run_in_threadpool(service.store.meshes.get, mesh_id) is None:
            return  # deleted
        news = await service.wakeups.wait(mesh_id, _RECHECK_SECONDS, seen=after)


def _wire(event: EventRow) -> bytes:
    data: dict[str, Any] = event.data
    return format_sse_event(
        event=event.kind, id=str(event.number), data_str=json.dumps(data, allow_nan=False, separators=(",", ":"))
    )
