"""Answers that are files of a mesh, for all routes."""

from collections.abc import Mapping
from typing import Any

from fastapi import Request
from starlette.responses import Response

from equimesh.io.write import FORMATS
from equimesh_service.admission.formats import check_head, check_whole
from equimesh_service.files.port import StoredFile
from equimesh_service.problems.problem import Complaint, Problem
from equimesh_service.service import Service
from equimesh_service.store.rows import CANCELED, FAILED, SUCCEEDED, Artifact, MeshRow
from equimesh_service.wire.sending import send_file
from equimesh_service.worker.names import file_name, head_name
from equimesh_service.worker.part_formats import HEADED, PART_FORMATS

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
    headers: Mapping[str, str] | None = None,
    status: int = 200,
) -> Response:
    """The file of a finished mesh, the head of one in parts; raises a 406 problem for a format that it has not."""
    parts = parts_of(row)
    if parts is not None:
        check_head(format, cells)
        artifact = await service.artifact(row.id, head_name(format))
        form, file = PART_FORMATS[format], StoredFile(artifact.sha256, artifact.size)
        name = form.head_name(parts["name"])
        return await send_file(
            request, service.files, file, form.head_media_type, filename=name, headers=headers, status=status
        )
    check_whole(format, cells, is_grid=row.has_grid)
    artifact = await service.artifact(row.id, file_name(format, cells))
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
