"""Meshes of which the service keeps nothing: previews, and the answers of ``POST /v1/meshes?store=false``."""

from typing import Annotated

from fastapi import APIRouter, Query, Request
from starlette.responses import Response

from equimesh.io.formats import FORMATS
from equimesh_service.admission.callers import Caller
from equimesh_service.admission.formats import check_whole
from equimesh_service.admission.tasks import ComputationResult
from equimesh_service.api.mesh_requests import MESH_BODY, read_raw
from equimesh_service.api.routing import KEY_PROBLEMS, ServiceDependency, Writer, problems
from equimesh_service.problems.problem import Problem
from equimesh_service.service import Service
from equimesh_service.telemetry import stopwatch
from equimesh_service.wire.body import JSON, NPZ
from equimesh_service.worker.job import DRAWING

# A preview waits for a worker and for its solve; it counts as one wait of its key.
_COUNTED_SECONDS = 1.0
_FRAMES = Query(
    description="With Schwarz settings, also the mesh of every iteration, as `frames_x` and `frames_y`; of a long "
    "iteration every second, fourth, … mesh. `frames` of the document has the numbers of the iterations."
)
# The header with the certificate of a file that is not kept.
CERTIFICATE = "Equimesh-Certificate"
_NOT_KEPT = {"Cache-Control": "no-store"}

router = APIRouter(prefix="/v1/previews", tags=["meshes"], responses=KEY_PROBLEMS)


@router.post(
    "",
    summary="Preview a mesh",
    operation_id="createPreview",
    response_class=Response,
    responses={
        200: {"description": "The drawing, as an npz of arrays.", "content": {NPZ: {}}},
        **problems(400, 408, 409, 413, 415, 422, 503, 507),
    },
    openapi_extra={"requestBody": MESH_BODY},
)
async def create(
    request: Request, service: ServiceDependency, caller: Writer, frames: Annotated[bool, _FRAMES] = False
) -> Response:
    """Solve a mesh at once, and answer with all that is needed to draw it; the service keeps nothing of it.

    The npz holds `document`, JSON text as bytes, with the spec, the status, the certificate, the quality, and sentences
    about them; then nodes, u, Q_eq and the error of every cell, of this mesh and of the uniform one of its size.

    A solve that fails is answered with the status `failed` in the document; of a folded mesh the arrays are missing.
    The limits are EQUIMESH_MAX_PREVIEW_POINTS and EQUIMESH_PREVIEW_SECONDS. When all workers are busy, the answer is a
    503 with Retry-After.
    """
    seconds = service.settings.preview_seconds
    computed = await _computed(request, service, caller, DRAWING, seconds, frames=frames)
    if computed is None:
        return _gone()
    service.metrics.count_uploads(computed.ending.uploads)  # a preview is no mesh that ends
    return Response(computed.content, media_type=NPZ, headers=_NOT_KEPT)


def check_unstored(format: str | None, key: str | None) -> None:
    """Raise a 400 problem for an idempotency key, and a 406 problem for a format of meshes in parts alone."""
    if key is not None:
        detail = "An Idempotency-Key finds a mesh that is kept, and with store=false none is: leave one of them out."
        raise Problem("malformed-header", detail)
    if format is not None and format not in FORMATS:
        check_whole(format, "quad")


async def answer_unstored(
    request: Request, service: Service, caller: Caller, format: str | None, wait: int | None
) -> Response:
    """The answer with a mesh that is not kept: its file in a ``format``, or its document for None.

    ``wait`` is that of the header Prefer in seconds, None without the header.
    """
    most = min(service.settings.max_wait, service.settings.time_limit)
    seconds = most if wait is None else min(wait, most)
    computed = await _computed(request, service, caller, format, seconds)
    if computed is None:
        return _gone()
    service.metrics.count_end(computed.ending)
    headers = _NOT_KEPT if wait is None else {**_NOT_KEPT, "Preference-Applied": f"wait={seconds:g}"}
    if format is None:
        return Response(computed.content, media_type=JSON, headers=headers)
    form = FORMATS[format]
    headers = {
        **headers,
        CERTIFICATE: computed.certificate,
        "Content-Disposition": f'attachment; filename="equimesh{form.suffix}"',
    }
    return Response(computed.content, media_type=form.media_type, headers=headers)


async def _computed(
    request: Request, service: Service, caller: Caller, format: str | None, seconds: float, *, frames: bool = False
) -> ComputationResult | None:
    """The answer to a request of which nothing is kept; None for a caller who has left."""
    with (
        service.quotas.count_wait(caller, _COUNTED_SECONDS),
        service.bodies.place(caller.key_id) as place,
    ):
        body = await read_raw(request, service, place)
        stopwatch.lap("receive")

        async def leaves() -> None:
            while (await request.receive())["type"] != "http.disconnect":
                pass

        return await service.unstored.compute(
            body,
            request.headers["content-type"],
            caller,
            format=format,
            seconds=seconds,
            frames=frames,
            leaves=leaves,
        )


def _gone() -> Response:
    """The answer that no one reads."""
    return Response(status_code=204)
