"""Routes for samples of monitor functions: uploaded once, used by any number of meshes."""

from dataclasses import replace
from typing import Annotated, Literal

from fastapi import APIRouter, Query, Request
from fastapi.responses import JSONResponse
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from equimesh_service.admission.callers import Caller
from equimesh_service.api.resources import SamplesResource, samples_resource
from equimesh_service.api.routing import FILE_ANSWERS, KEY_PROBLEMS, Reader, ServiceDependency, Writer, problems
from equimesh_service.assembly.upload import Upload
from equimesh_service.files.port import StoredFile
from equimesh_service.problems.problem import Problem, problem_at
from equimesh_service.service import Service
from equimesh_service.store.rows import SamplesRow
from equimesh_service.wire.body import read_upload
from equimesh_service.wire.sending import send_file

router = APIRouter(prefix="/v1/samples", tags=["samples"], responses=KEY_PROBLEMS)

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
        "text/plain": {"schema": {"type": "string"}},
        "application/x-npz": {"schema": _BINARY},
        "application/x-npy": {"schema": _BINARY},
        "application/vnd.vtk.vtu+xml": {"schema": _BINARY},
        "application/vnd.vtk": {"schema": _BINARY},
        "application/zip": {"schema": _BINARY},
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
        200: {"description": "The samples are already stored.", "model": SamplesResource},
        **problems(400, 408, 413, 415, 422, 503, 507),
    },
    openapi_extra={"requestBody": _BODY},
)
async def create(
    request: Request,
    service: ServiceDependency,
    caller: Writer,
    filename: Annotated[
        str | None, Query(max_length=200, description="Its suffix gives the format of a raw body.")
    ] = None,
    column: Annotated[
        str | None,
        Query(
            max_length=200,
            description="The name of u among the columns, arrays or point data of the file; of a table without a "
            "header its number, from 1, or matrix.",
        ),
    ] = None,
    kind: Annotated[
        Literal["samples", "mesh"], Query(description="mesh: the file is a mesh of quadrilaterals, to be a domain.")
    ] = "samples",
) -> Response:
    """Samples of a function as npz, npy, csv, txt, json, vtu or vtk; the same samples give the same id.

    With `kind=mesh` it is a mesh for `{"kind": "mesh", "file": id}` in a domain.
    """
    if column is not None and kind == "mesh":
        raise problem_at("", "a mesh has no columns: leave this out", parameter="column")
    with service.bodies.place(caller.key_id) as place:
        upload = await read_upload(request, service.settings.max_body, filename, place)
        upload = replace(upload, column=column)
        await service.quotas.check_bytes(caller, len(upload.data))
        row, new = await service.check(_keep, service, upload, caller, kind)
    service.metrics.count_uploads(1)
    headers = {"Location": f"{service.settings.root}/v1/samples/{row.id}"}
    return JSONResponse(
        samples_resource(row, service.settings.root).model_dump(mode="json"), 201 if new else 200, headers
    )


def _keep(service: Service, upload: Upload, caller: Caller, kind: str) -> tuple[SamplesRow, bool]:
    admission = service.checks.admission
    return (admission.keep if kind == "samples" else admission.keep_mesh)(upload, caller)


@router.get(
    "/{id}",
    summary="Look at samples",
    operation_id="getSamples",
    response_model=SamplesResource,
    responses={200: {"content": {"application/x-npz": {}}}, **FILE_ANSWERS, **problems(404, 410, 422, 503)},
)
async def get(
    id: str,
    request: Request,
    service: ServiceDependency,
    caller: Reader,
    format: Annotated[Literal["json", "npz"], Query(description="npz gives the samples themselves.")] = "json",
) -> Response:
    """A summary of the samples, or the samples as npz."""
    row = await run_in_threadpool(service.store.samples.get, id, caller.only)
    if row is None:
        raise await service.missing_problem(id, caller, "There are no samples with this id.")
    if format == "npz":
        file = StoredFile(row.sha256, row.size)
        return await send_file(request, service.files, file, "application/x-npz", filename=f"{row.id}.npz")
    return JSONResponse(samples_resource(row, service.settings.root).model_dump(mode="json"))


@router.delete(
    "/{id}", summary="Delete samples", operation_id="deleteSamples", status_code=204, responses=problems(404, 410, 409)
)
async def delete(id: str, service: ServiceDependency, caller: Writer) -> None:
    """Delete samples that no unfinished mesh needs."""
    done = await run_in_threadpool(service.store.samples.delete, id, service.discard, caller.only)
    if done is None:
        raise await service.missing_problem(id, caller, "There are no samples with this id.")
    if not done:
        raise Problem("conflict", "A mesh that is not finished needs these samples.")
