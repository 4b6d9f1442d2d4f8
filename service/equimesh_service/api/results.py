"""Routes of results: the mesh file, its quality, its convergence, pictures."""

import json
from typing import Annotated, Any, Literal, TypeAlias

from fastapi import APIRouter, Query, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import JSONResponse, Response

from equimesh.io.write import FORMATS
from equimesh_service.admission.formats import known_format
from equimesh_service.api.mesh_files import (
    HEAD_TYPES,
    MESH_CONTENT,
    WHOLE_TYPES,
    check_done,
    mesh_file,
    parts_of,
    send_artifact,
)
from equimesh_service.api.mesh_requests import NPZ
from equimesh_service.api.routing import FILE_ANSWERS, KEY_PROBLEMS, Reader, ServiceDependency, problems
from equimesh_service.problems.problem import Problem
from equimesh_service.service import Service
from equimesh_service.store.rows import Artifact, MeshRow
from equimesh_service.wire.negotiation import choose_offer
from equimesh_service.worker.convergence import NO_ITERATIONS, ConvergenceHistory, table
from equimesh_service.worker.names import ARRAYS, CONVERGENCE, DRAWING, PICTURES, plot_name
from equimesh_service.worker.part_formats import HEADED, WRITTEN

router = APIRouter(prefix="/v1/meshes/{id}", tags=["results"], responses=KEY_PROBLEMS)

PlotKind: TypeAlias = Literal["mesh", "convergence", "quality", "comparison"]
"""What a picture shows: the kinds of :data:`equimesh_service.worker.names.PLOTS`."""

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
_PARTIAL = Query(description="Also the last valid mesh of a solve that failed.")


@router.get("/file", summary="Download the mesh", operation_id="getMeshFile", response_class=Response, responses=_FILES)
async def get_file(
    id: str,
    request: Request,
    service: ServiceDependency,
    caller: Reader,
    format: Annotated[str | None, _FORMAT] = None,
    cells: Annotated[Literal["quad", "triangle"] | None, _CELLS] = None,
    partial: Annotated[bool, _PARTIAL] = False,
) -> Response:
    """The mesh in a format that a solver reads; written on the first request, then stored.

    Of a mesh in parts it is the head, which names the files of the parts; see `/parts`.
    """
    row = await service.mesh(id, caller)
    name = known_format(format) if format is not None else _choose_format(request, row)
    check_done(row, partial=partial)
    return await mesh_file(request, service, row, name, cells or row.cells)


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
