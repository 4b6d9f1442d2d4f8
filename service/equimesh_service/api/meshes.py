"""Routes that create, list, cancel and delete meshes, and the answer to a request that may wait for its mesh."""

from __future__ import annotations

import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Literal

from fastapi import APIRouter, Query, Request
from fastapi.responses import JSONResponse
from pydantic import BaseModel, Field
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from equimesh_schema.mesh import WITHOUT_NUL, MeshSpec
from equimesh_service.admission.callers import Caller
from equimesh_service.admission.formats import known_format
from equimesh_service.admission.intake import AcceptedMesh, MeshRequest
from equimesh_service.api.mesh_requests import MESH_BODY, Format, IdempotencyKey, Prefer, check_key, receive_body
from equimesh_service.api.resources import MeshList, MeshResource, UnstoredMesh, mesh_resource
from equimesh_service.api.results import MEDIA_TYPES, MESH_CONTENT, check_done, mesh_bytes, mesh_file
from equimesh_service.api.routing import (
    KEY_PROBLEMS,
    Reader,
    ServiceDependency,
    Writer,
    cursor_of,
    position_of,
    problems,
)
from equimesh_service.api.unstored import CERTIFICATE, answer_unstored, check_unstored
from equimesh_service.problems.problem import Problem
from equimesh_service.service import Service
from equimesh_service.store.rows import CANCELED, Ending, MeshRow
from equimesh_service.telemetry import stopwatch
from equimesh_service.wire.headers import choose_explicit_offer, parse_wait


@dataclass(frozen=True)
class Waiting:
    """The form and the time of an answer: a file in ``format``, or JSON for None, after at most ``seconds``.

    ``wanted`` is the wait of the header Prefer in seconds, None without the header.
    """

    format: str | None
    seconds: int
    wanted: int | None

    @classmethod
    def of(cls, request: Request, service: Service, format: str | None, prefer: str | None) -> Waiting:
        """Read ?format=, Accept and Prefer; raises a 406 problem."""
        name = known_format(format) if format is not None else None
        wanted = parse_wait(prefer)
        return cls(
            name or choose_explicit_offer(request.headers.get("accept"), MEDIA_TYPES),
            min(wanted or 0, int(service.settings.max_wait)),
            wanted,
        )

    async def answer(
        self,
        request: Request,
        service: Service,
        caller: Caller,
        accepted: AcceptedMesh,
        headers: dict[str, str],
        describe: Callable[[MeshRow], Awaitable[BaseModel]],
    ) -> Response:
        """Wait for the mesh, and answer with its file or with the resource that ``describe`` makes of its row."""
        if self.wanted is not None:
            headers["Preference-Applied"] = f"wait={self.seconds}"
        until, name = time.monotonic() + self.seconds - accepted.waited, self.format
        ending = await service.intake.wait_for_ending(accepted, until - time.monotonic())
        if ending is not None:
            stopwatch.include(ending.laps)
            stopwatch.lap("hand-over")
        if ending is not None and name is not None and (file := ending.requested):
            content = ending.content
            return await mesh_bytes(
                request, service, accepted.mesh_id, name, file, headers=headers, status=201, content=content
            )
        row = await service.wait_for_end(accepted.mesh_id, until - time.monotonic(), caller)
        if row.reused_from is not None:
            headers["Equimesh-Reused"] = row.reused_from
        if row.finished and name is not None:
            check_done(row, partial=False, headers=headers)
            return await mesh_file(request, service, row, name, row.cells, headers=headers, status=201)
        if not row.finished:
            headers["Retry-After"] = "1"
        resource = await describe(row)
        return JSONResponse(resource.model_dump(mode="json", by_alias=True), 201 if row.finished else 202, headers)


router = APIRouter(prefix="/v1/meshes", tags=["meshes"], responses=KEY_PROBLEMS)

_LOCATION = {"Location": {"description": "The mesh.", "schema": {"type": "string"}}}
_REUSED = {
    "Equimesh-Reused": {
        "description": "The earlier mesh whose points and files these are; absent if the mesh was computed.",
        "schema": {"type": "string"},
    }
}
_CERTIFICATE = {
    CERTIFICATE: {"description": "With a file: its certificate, as JSON in ASCII.", "schema": {"type": "string"}},
    "Cache-Control": {"description": "no-store", "schema": {"type": "string"}},
}


@router.post(
    "",
    summary="Request a mesh",
    operation_id="createMesh",
    status_code=201,
    response_model=None,
    responses={
        201: {
            "description": "The finished mesh; its file, when a mesh format was requested.",
            "model": MeshResource,
            "headers": {**_LOCATION, **_REUSED},
            "content": MESH_CONTENT,
        },
        200: {
            "description": "With `store=false`: the mesh, of which the service keeps nothing.",
            "model": UnstoredMesh,
            "headers": _CERTIFICATE,
            "content": MESH_CONTENT,
        },
        202: {"description": "The mesh waits or runs; see Location.", "model": MeshResource, "headers": _LOCATION},
        **problems(400, 406, 408, 409, 413, 415, 422, 429, 503, 507),
    },
    openapi_extra={"requestBody": MESH_BODY},
)
async def create(
    request: Request,
    service: ServiceDependency,
    caller: Writer,
    format: Format = None,
    prefer: Prefer = None,
    idempotency_key: IdempotencyKey = None,
    reuse: Annotated[
        bool, Query(description="Answer with a finished mesh of the same spec and samples, where there is one.")
    ] = True,
    store: Annotated[
        bool,
        Query(description="Keep the mesh. With false, the answer is the mesh, and the service keeps nothing of it."),
    ] = True,
) -> Response:
    """Request a mesh by its spec, as JSON or as multipart with the parts `spec`, `samples` and `mesh`.

    With `Prefer: wait=N` the answer comes when the mesh is finished, in one round trip. A mesh that fails in this
    time also answers 201, with status `failed` and the reason in `error`. Where its file was requested, the answer is
    the problem, as for a request for the file.

    If the same mesh has been computed before, the answer is immediate: a new mesh with the same points and files.
    `reused_from` and the header `Equimesh-Reused` name the earlier one; `reuse=false` computes it again.

    With `store=false` the request waits for a mesh that has no id: its file in the requested format, with the
    certificate in the header `Equimesh-Certificate`, or a JSON document without its points. A service keeps nothing of
    it, so there is nothing to repeat: an `Idempotency-Key` is refused. The wait is at most EQUIMESH_MAX_WAIT seconds.
    """
    waiting = Waiting.of(request, service, format, prefer)
    key = check_key(idempotency_key)
    if not store:
        check_unstored(waiting.format, key)
        return await answer_unstored(request, service, caller, waiting.format, waiting.wanted)

    async def describe(row: MeshRow) -> MeshResource:
        return mesh_resource(row, service.settings.root)

    with service.quotas.count_wait(caller, waiting.seconds):
        with service.bodies.place(caller.key_id) as place:
            body = await receive_body(request, service, caller, place)
            mesh_request = MeshRequest(format=waiting.format, seconds=waiting.seconds, key=key, reuse=reuse)
            accepted = await service.intake.take(body, mesh_request)
        headers = {"Location": f"{service.settings.root}/v1/meshes/{accepted.mesh_id}"}
        return await waiting.answer(request, service, caller, accepted, headers, describe)


class _Page(BaseModel):
    """The meshes that a page lists."""

    status: Literal["queued", "running", "succeeded", "failed", "canceled"] | None = Field(
        None, description="Only these."
    )
    label: str | None = Field(None, pattern=WITHOUT_NUL, description="Only those with exactly this label.")
    limit: int = Field(50, ge=1, le=200, description="Most meshes on a page.")
    cursor: str | None = Field(None, description="`next_cursor` of the page before.")


@router.get("", summary="List meshes, newest first", operation_id="listMeshes", responses=problems(422))
async def list_meshes(
    request: Request, response: Response, service: ServiceDependency, caller: Reader, page: Annotated[_Page, Query()]
) -> MeshList:
    """A page of meshes; the header `Link` with rel="next" leads to the next one."""
    only, limit = caller.only, page.limit
    before = None if page.cursor is None else position_of(page.cursor, only)
    find = partial(service.store.meshes.page, key_id=only, status=page.status, label=page.label, before=before)
    rows = await run_in_threadpool(find, limit=limit + 1)
    following = cursor_of(rows[limit - 1], only) if len(rows) > limit else None
    if following is not None:
        url = request.url.include_query_params(cursor=following)
        response.headers["Link"] = f'<{url.path}?{url.query}>; rel="next"'
    return MeshList(items=[mesh_resource(row, service.settings.root) for row in rows[:limit]], next_cursor=following)


@router.get("/{id}", summary="Look at a mesh", operation_id="getMesh", responses=problems(404, 410, 422))
async def get_mesh(
    id: str,
    service: ServiceDependency,
    caller: Reader,
    wait: Annotated[
        float, Query(ge=0, le=3600, allow_inf_nan=False, description="Seconds to wait for it to finish.")
    ] = 0.0,
) -> MeshResource:
    """Status, progress, quality and links. The `error` of a failed mesh says why it failed."""
    with service.quotas.count_wait(caller, wait):
        return mesh_resource(await service.wait_for_end(id, wait, caller), service.settings.root)


@router.post("/{id}/cancel", summary="Cancel a mesh", operation_id="cancelMesh", responses=problems(404, 410, 409))
async def cancel(id: str, service: ServiceDependency, caller: Writer) -> MeshResource:
    """Cancel a mesh that is not finished; a worker that computes it is stopped."""
    await service.mesh(id, caller)
    if await run_in_threadpool(service.store.queue.cancel, id):
        service.metrics.count_end(Ending(status=CANCELED))
        service.dispatcher.cancel(id)
    row = await service.mesh(id, caller)
    if row.status != CANCELED:
        raise Problem("conflict", f"The mesh has already {row.status}.")
    return mesh_resource(row, service.settings.root)


@router.delete(
    "/{id}", summary="Delete a mesh", operation_id="deleteMesh", status_code=204, responses=problems(404, 410)
)
async def delete(id: str, service: ServiceDependency, caller: Writer) -> None:
    """Delete the record and the files; an unfinished mesh is canceled first."""
    await service.mesh(id, caller)
    if await run_in_threadpool(service.store.queue.cancel, id):
        service.metrics.count_end(Ending(status=CANCELED))
    if not await run_in_threadpool(service.store.meshes.delete, id, service.discard):
        raise Problem("not-found", "There is no mesh with this id.")
    service.dispatcher.cancel(id)


@router.get(
    "/{id}/spec",
    summary="The spec with all defaults",
    operation_id="getMeshSpec",
    response_model=MeshSpec,
    responses=problems(404, 410),
)
async def get_spec(id: str, service: ServiceDependency, caller: Reader) -> Response:
    """The spec with every default filled in: posting it again gives the same mesh."""
    await service.mesh(id, caller)
    spec = await run_in_threadpool(service.store.meshes.spec, id)
    if spec is None:
        raise Problem("not-found", "There is no mesh with this id.")
    return JSONResponse(spec)
