"""The route of previews: meshes to look at, of which the service keeps nothing."""

from typing import Annotated

from fastapi import APIRouter, Query, Request
from starlette.responses import Response

from equimesh_service.api.mesh_requests import MESH_BODY, NPZ, read_request
from equimesh_service.api.routing import KEY_PROBLEMS, ServiceDependency, Writer, problems
from equimesh_service.telemetry import stopwatch

router = APIRouter(prefix="/v1/previews", tags=["meshes"], responses=KEY_PROBLEMS)

# A preview waits for a worker and for its solve; it counts as one wait of its key.
_COUNTED_SECONDS = 1.0
_FRAMES = Query(
    description="With Schwarz settings, also the mesh of every iteration, as `frames_x` and `frames_y`; of a long "
    "iteration every second, fourth, … mesh. `frames` of the document has the numbers of the iterations."
)


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
    with service.quotas.count_wait(caller, _COUNTED_SECONDS), service.bodies.place(caller.key_id) as place:
        document, upload, mesh = await read_request(request, service, place)
        stopwatch.lap("receive")
        if upload is not None or mesh is not None:
            service.metrics.count_upload()
        drawing = await service.previews.draw(
            document, upload, caller, mesh=mesh, frames=frames, has_left=request.is_disconnected
        )
    if drawing is None:
        return Response(status_code=204)  # there is no one to read it
    return Response(drawing, media_type=NPZ, headers={"Cache-Control": "no-store"})
