"""Routes for samples of monitor functions: uploaded once, used by any number of meshes."""

from __future__ import annotations

import os
from typing import Annotated, Literal

from fastapi import APIRouter, Query, Request
from fastapi.responses import JSONResponse
from starlette.concurrency import run_in_threadpool
from starlette.responses import FileResponse, Response

from equimesh_service.body import read_upload
from equimesh_service.problems import Problem
from equimesh_service.ranges import settle_range
from equimesh_service.resources import SamplesResource, samples_resource
from equimesh_service.routing import ServiceDependency, problems

router = APIRouter(prefix="/v1/samples", tags=["samples"])

_BINARY = {"type": "string", "contentMediaType": "application/octet-stream"}
_BODY = {
    "required": True,
    "content": {
        "multipart/form-data": {
            "schema": {"type": "object", "required": ["samples"], "properties": {"samples": _BINARY}}
        },
        "application/json": {
            "schema": {"type": "object"},
            "example": {"grid": {"x": [0, 1], "y": [0, 1], "values": [[0, 1], [1, 2]]}},
        },
        "text/csv": {"schema": {"type": "string"}, "example": "x,y,u\n0,0,0\n0,1,1\n1,0,1\n1,1,2\n"},
        "application/x-npz": {"schema": _BINARY},
        "application/x-npy": {"schema": _BINARY},
        "application/octet-stream": {"schema": _BINARY},
    },
}


@router.post(
    "",
    summary="Upload samples",
    operation_id="createSamples",
    status_code=201,
    response_model=SamplesResource,
    responses={
        200: {"description": "They were here already.", "model": SamplesResource},
        **problems(400, 413, 415, 422),
    },
    openapi_extra={"requestBody": _BODY},
)
async def create(
    request: Request,
    service: ServiceDependency,
    filename: Annotated[
        str | None, Query(max_length=200, description="Its suffix tells the format of a raw body.")
    ] = None,
) -> Response:
    """Samples of a function as npz, npy, csv, json, vtu or vtk; the same samples give the same id."""
    upload = await read_upload(request, service.settings.max_body, filename)
    row, new = await service.check(service.admission.keep, upload)
    headers = {"Location": f"/v1/samples/{row.id}"}
    return JSONResponse(samples_resource(row).model_dump(mode="json"), 201 if new else 200, headers)


@router.get(
    "/{id}",
    summary="Look at samples",
    operation_id="getSamples",
    response_model=SamplesResource,
    responses={200: {"content": {"application/x-npz": {}}}, **problems(404, 416, 422)},
)
async def get(
    id: str,
    request: Request,
    service: ServiceDependency,
    format: Annotated[Literal["json", "npz"], Query(description="npz gives the samples themselves.")] = "json",
) -> Response:
    """What the samples are, or the samples as npz."""
    row = await run_in_threadpool(service.store.samples.get, id)
    if row is None:
        raise Problem("not-found", "There are no samples with this id.")
    if format == "npz":
        path = service.files.path(row.sha256)
        headers = {"ETag": f'"{row.sha256}"'}
        try:
            stat = os.stat(path)
        except FileNotFoundError:
            raise Problem("not-found", "The samples were deleted.") from None
        settle_range(request, stat.st_size)
        return FileResponse(path, 200, headers, "application/x-npz", filename=f"{row.id}.npz", stat_result=stat)
    return JSONResponse(samples_resource(row).model_dump(mode="json"))


@router.delete(
    "/{id}",
    summary="Delete samples",
    operation_id="deleteSamples",
    status_code=204,
    responses=problems(404, 409),
)
async def delete(id: str, service: ServiceDependency) -> None:
    """Delete samples that no waiting or running mesh needs."""
    done = await run_in_threadpool(service.store.samples.delete, id, service.files.remove)
    if done is None:
        raise Problem("not-found", "There are no samples with this id.")
    if not done:
        raise Problem("conflict", "A mesh that is not finished needs these samples.")
