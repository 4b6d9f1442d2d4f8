"""Routes of results: the mesh file, its quality, its convergence, pictures."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Annotated, Any, Literal, TypeAlias

from fastapi import APIRouter, Query, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import JSONResponse, Response

from equimesh.io.formats import FORMATS
from equimesh_service.admission.formats import check_head, check_whole, known_format
from equimesh_service.api.routing import FILE_ANSWERS, KEY_PROBLEMS, Reader, ServiceDependency, problems
from equimesh_service.files.port import StoredFile
from equimesh_service.problems.problem import Complaint, Problem
from equimesh_service.service import Service
from equimesh_service.store.rows import CANCELED, FAILED, SUCCEEDED, Artifact, MeshRow
from equimesh_service.wire.body import NPZ
from equimesh_service.wire.headers import choose_offer
from equimesh_service.wire.sending import send_file
from equimesh_service.worker.job import ARRAYS, CONVERGENCE, DRAWING, PICTURES, file_name, head_name, plot_name
from equimesh_service.worker.part_formats import HEADED, PART_FORMATS, WRITTEN
from equimesh_service.worker.summary import NO_ITERATIONS, ConvergenceHistory, table

# The media types of the formats of whole meshes, by their names.
WHOLE_TYPES = {name: form.media_type for name, form in FORMATS.items()}
# Those of the heads of meshes in parts.
HEAD_TYPES = {name: PART_FORMATS[name].head_media_type for name in HEADED}
MEDIA_TYPES = {**WHOLE_TYPES, **HEAD_TYPES}
# The documentation of answers that are mesh files.
MESH_CONTENT: dict[str, Any] = {media_type: {} for media_type in MEDIA_TYPES.values()}


async def mesh_file(
    request: Request,
    service: Service,
    row: MeshRow,
    format: str,
    cells: str,
    *,
    order: int = 1,
    headers: Mapping[str, str] | None = None,
    status: int = 200,
) -> Response:
    """The file of a finished mesh, the head of one in parts; raises a 406 problem for a format that it has not."""
    parts = parts_of(row)
    if parts is not None:
        check_head(format, cells, order)
        artifact = await service.artifact(row.id, head_name(format))
        form, file = PART_FORMATS[format], StoredFile(artifact.sha256, artifact.size)
        name = form.head_name(parts["name"])
        return await send_file(
            request, service.files, file, form.head_media_type, filename=name, headers=headers, status=status
        )
    check_whole(format, cells, is_grid=row.has_grid, order=order)
    artifact = await service.artifact(row.id, file_name(format, cells, order))
    return await mesh_bytes(request, service, row.id, format, artifact, headers=headers, status=status)


async def mesh_bytes(
    request: Request,
    service: Service,
    mesh_id: str,
    format: str,
    artifact: Artifact,
    *,
    headers: Mapping[str, str] | None = None,
    status: int = 200,
    content: bytes | None = None,
) -> Response:
    """The file of a mesh, whose artifact is known, and the bytes of the file where they are at hand."""
    form = FORMATS[format]
    name = f"equimesh-{mesh_id}{form.suffix}"
    file = StoredFile(artifact.sha256, artifact.size)
    return await send_file(
        request,
        service.files,
        file,
        form.media_type,
        filename=name,
        headers=headers,
        status=status,
        content=content,
    )


def parts_of(row: MeshRow) -> dict[str, Any] | None:
    """What the result of a mesh in parts says of them; None for a mesh that is whole, or not finished."""
    found: dict[str, Any] | None = (row.result or {}).get("parts")
    return found


def check_done(row: MeshRow, *, partial: bool, headers: Mapping[str, str] | None = None) -> None:
    """Raise the problem of a mesh that has no files; with ``partial``, those of a failed mesh count."""
    more = dict(headers or {})
    if row.status == SUCCEEDED or (partial and row.partial):
        return
    if row.status == CANCELED:
        raise Problem("canceled", "The mesh was canceled before it was finished.", headers=more)
    if row.status != FAILED:
        raise Problem("not-finished", f"The mesh is {row.status}.", headers={**more, "Retry-After": "1"})
    error = row.error or {}
    name = str(error.get("type", "")).rpartition("/")[2]
    complaints = [Complaint(**entry) for entry in error.get("errors", ())]
    raise Problem(name, str(error.get("detail", "")), complaints, more, str(error.get("remedy", "")))


async def send_artifact(request: Request, service: Service, artifact: Artifact, media_type: str) -> Response:
    """The file of an artifact, without a name for the download."""
    file = StoredFile(artifact.sha256, artifact.size)
    return await send_file(request, service.files, file, media_type)


router = APIRouter(prefix="/v1/meshes/{id}", tags=["results"], responses=KEY_PROBLEMS)

PlotKind: TypeAlias = Literal["mesh", "convergence", "quality", "comparison"]
"""What a picture shows: the kinds of :data:`equimesh_service.worker.job.PLOTS`."""

_TEXT = {"type": "string"}
_FILES: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "The mesh.",
        "content": MESH_CONTENT,
        "headers": {"ETag": {"description": "The SHA-256 of the bytes.", "schema": _TEXT}},
    },
    **FILE_ANSWERS,
    **problems(404, 410, 406, 409, 422, 503, 507),
}
_FORMAT = Query(
    description=f"One of {', '.join(FORMATS)}, by default vtu; of a mesh in parts one of {', '.join(HEADED)}, "
    f"by default {WRITTEN}. It takes precedence over Accept.",
    json_schema_extra={"enum": [*FORMATS, *HEADED]},
)
_CELLS = Query(description="Cells of the file; by default those of the spec.")
_ORDER = Query(
    description="2: cells with a node in the middle of each edge, on curved sides of the domain on the curve, for"
    f" {', '.join(name for name, form in FORMATS.items() if form.second_order)}.",
    ge=1,
    le=2,
)
_PARTIAL = Query(description="Also the last valid mesh of a solve that failed.")


@router.get("/file", summary="Download the mesh", operation_id="getMeshFile", response_class=Response, responses=_FILES)
async def get_file(
    id: str,
    request: Request,
    service: ServiceDependency,
    caller: Reader,
    format: Annotated[str | None, _FORMAT] = None,
    cells: Annotated[Literal["quad", "triangle"] | None, _CELLS] = None,
    order: Annotated[int, _ORDER] = 1,
    partial: Annotated[bool, _PARTIAL] = False,
) -> Response:
    """The mesh in a format that a solver reads; written on the first request, then stored.

    Of a mesh in parts it is the head, which names the files of the parts; see `/parts`.
    """
    row = await service.mesh(id, caller)
    name = known_format(format) if format is not None else _choose_format(request, row)
    check_done(row, partial=partial)
    return await mesh_file(request, service, row, name, cells or row.cells, order=order)


router.head(
    "/file",
    summary="Headers of the mesh file",
    description="As GET, without the bytes.",
    operation_id="headMeshFile",
    response_class=Response,
    responses=_FILES,
)(get_file)


@router.get(
    "/quality",
    summary="Quality of the mesh",
    operation_id="getMeshQuality",
    response_class=Response,
    responses={200: {"content": {"application/json": {}}}, **FILE_ANSWERS, **problems(404, 410, 406, 409, 422, 503)},
)
async def get_quality(
    id: str,
    request: Request,
    service: ServiceDependency,
    caller: Reader,
    arrays: Annotated[bool, Query(description="With `cells`, the values per cell, xi first.")] = False,
) -> Response:
    """All measures: maximum, minimum, mean and root mean square over the cells; also for a partial mesh."""
    row = await service.mesh(id, caller)
    quality = (row.result or {}).get("quality")
    if quality is None:
        check_done(row, partial=False)
        raise Problem("not-found", "There is no mesh with this id.")
    if arrays:
        _check_whole(row, "quality of each cell")
        return await send_artifact(request, service, await service.artifact(id, ARRAYS), "application/json")
    return JSONResponse(quality)


@router.get(
    "/convergence",
    summary="The Schwarz iteration, or the descent",
    operation_id="getMeshConvergence",
    response_class=Response,
    responses={
        200: {"model": ConvergenceHistory, "content": {"application/json": {}, "text/csv": {}}},
        **FILE_ANSWERS,
        **problems(404, 410, 406, 409, 422),
    },
)
async def get_convergence(
    id: str,
    request: Request,
    service: ServiceDependency,
    caller: Reader,
    format: Annotated[Literal["json", "csv"] | None, Query(description="It takes precedence over Accept.")] = None,
) -> Response:
    """Each iteration: change, error, work, traffic, and the solves of all subdomains; iteration 0 is the start.

    Of a least-error mesh each step of the descent: its grid, its error, and the gain over the uniform mesh.
    """
    row = await service.mesh(id, caller)
    artifact = await run_in_threadpool(service.store.meshes.artifact, id, CONVERGENCE)
    if artifact is None and row.result is None:
        check_done(row, partial=False)
    offers = {"json": "application/json", "csv": "text/csv"}
    name = format or choose_offer(request.headers.get("accept"), offers)
    if name is None:
        raise Problem("not-acceptable", "Convergence is application/json or text/csv.")
    if name == "json" and artifact is not None:
        return await send_artifact(request, service, artifact, "application/json")
    headers = {"Vary": "Accept"}
    if name == "json":
        return JSONResponse(NO_ITERATIONS, headers=headers)
    text = table(NO_ITERATIONS) if artifact is None else await run_in_threadpool(_csv, service, artifact)
    return Response(text, media_type="text/csv", headers=headers)


@router.get(
    "/plot",
    summary="A picture",
    operation_id="getMeshPlot",
    response_class=Response,
    responses={
        200: {"content": {media: {} for media in PICTURES.values()}},
        **FILE_ANSWERS,
        **problems(404, 410, 406, 409, 422, 503),
    },
)
async def get_plot(
    id: str,
    request: Request,
    service: ServiceDependency,
    caller: Reader,
    kind: Annotated[PlotKind, Query(description="What to draw.")] = "mesh",
    format: Annotated[Literal["svg", "png"] | None, Query(description="It takes precedence over Accept.")] = None,
) -> Response:
    """The mesh with its subdomains, its cells coloured by Q_eq, or the history of a Schwarz iteration or a descent.

    A comparison is the mesh next to the uniform mesh of its size: cells coloured by the error of u, and the gain.
    """
    name = format or choose_offer(request.headers.get("accept"), PICTURES)
    if name is None:
        raise Problem("not-acceptable", f"Pictures are {', '.join(PICTURES.values())}.")
    row = await service.mesh(id, caller)
    if row.result is None or (kind != "convergence" and row.result.get("quality") is None):
        check_done(row, partial=False)
    _check_whole(row, "picture")
    artifact = await service.artifact(id, plot_name(kind, name))
    return await send_artifact(request, service, artifact, PICTURES[name])


@router.get(
    "/drawing",
    summary="All that is needed to draw the mesh",
    operation_id="getMeshDrawing",
    response_class=Response,
    responses={200: {"content": {NPZ: {}}}, **FILE_ANSWERS, **problems(404, 410, 406, 409, 422, 503)},
)
async def get_drawing(id: str, request: Request, service: ServiceDependency, caller: Reader) -> Response:
    """The npz that `POST /v1/previews` answers with, of a mesh that the service keeps; without frames.

    It is made on the first request, then stored. Of a failed solve it draws the partial mesh.
    """
    row = await service.mesh(id, caller)
    if row.result is None or row.result.get("quality") is None:
        check_done(row, partial=False)
    _check_whole(row, "drawing")
    return await send_artifact(request, service, await service.artifact(id, DRAWING), NPZ)


def _choose_format(request: Request, row: MeshRow) -> str:
    offers = WHOLE_TYPES if parts_of(row) is None else HEAD_TYPES
    name = choose_offer(request.headers.get("accept"), offers)
    if name is None:
        raise Problem("not-acceptable", f"This mesh is {', '.join(offers.values())}.")
    return name


def _check_whole(row: MeshRow, what: str) -> None:
    """Raise a 406 problem for what there is of whole meshes only."""
    if parts_of(row) is not None:
        raise Problem("not-acceptable", f"There is no {what} of a mesh in parts. See its parts and its quality.")


def _csv(service: Service, artifact: Artifact) -> str:
    with service.files.local(artifact.sha256) as path:
        return table(json.loads(path.read_bytes()))
