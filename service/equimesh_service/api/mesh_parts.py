"""Routes of meshes in parts: the manifest, which lists all files, and the file of each part."""

from collections.abc import Mapping
from typing import Annotated, Any

from fastapi import APIRouter, Path, Query, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from equimesh_schema.answers import FileOfParts, GridSize, PartRecord, Parts
from equimesh_service.admission.formats import check_part
from equimesh_service.api.results import check_done, parts_of
from equimesh_service.api.routing import FILE_ANSWERS, KEY_PROBLEMS, MAX_NUMBER, Reader, ServiceDependency, problems
from equimesh_service.files.port import StoredFile
from equimesh_service.problems.problem import Problem
from equimesh_service.service import Service
from equimesh_service.store.rows import Artifact, MeshRow
from equimesh_service.wire.sending import send_file
from equimesh_service.worker.job import head_name, part_artifact
from equimesh_service.worker.part_formats import PART_FORMATS, WRITTEN, PartFormat

router = APIRouter(prefix="/v1/meshes/{id}/parts", tags=["results"], responses=KEY_PROBLEMS)


_FORMAT = Query(
    description=f"One of {', '.join(PART_FORMATS)}; by default {WRITTEN}.",
    json_schema_extra={"enum": [*PART_FORMATS]},
)
_NUMBER = Path(ge=0, le=MAX_NUMBER, description="The number of the part.")
_TEXT = {"type": "string"}
_FILES: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "The part.",
        "content": {form.media_type: {} for form in PART_FORMATS.values()},
        "headers": {"ETag": {"description": "The SHA-256 of the bytes.", "schema": _TEXT}},
    },
    **FILE_ANSWERS,
    **problems(404, 410, 406, 409, 422, 503, 507),
}


@router.get(
    "",
    summary="The files of a mesh in parts",
    operation_id="listMeshParts",
    responses=problems(404, 410, 406, 409, 422),
)
async def get_manifest(
    id: str,
    service: ServiceDependency,
    caller: Reader,
    format: Annotated[str, _FORMAT] = WRITTEN,
) -> Parts:
    """Row ranges, names, sizes and hashes of all files; a 404 for a mesh that is whole.

    Save the files of all parts under their names, next to the head, and open the head.
    """
    check_part(format)
    row, parts = await _mesh_in_parts(id, service, caller)
    artifacts = await run_in_threadpool(service.store.meshes.artifacts, id)
    return _manifest(row, parts, PART_FORMATS[format], artifacts, service.settings.root)


@router.get(
    "/{number}",
    summary="Download a part of a mesh",
    operation_id="getMeshPart",
    response_class=Response,
    responses=_FILES,
)
async def get_part(
    id: str,
    number: Annotated[int, _NUMBER],
    request: Request,
    service: ServiceDependency,
    caller: Reader,
    format: Annotated[str, _FORMAT] = WRITTEN,
) -> Response:
    """The file of a part, with ranges and an ETag; other formats than the default are made on the first request."""
    check_part(format)
    _, parts = await _mesh_in_parts(id, service, caller)
    count = len(parts["rows"])
    if number >= count:
        raise Problem("not-found", f"The mesh has {count} parts, with the numbers 0 to {count - 1}.")
    artifact = await service.artifact(id, part_artifact(format, number))
    form, file = PART_FORMATS[format], StoredFile(artifact.sha256, artifact.size)
    return await send_file(request, service.files, file, form.media_type, filename=form.part_name(number))


router.head(
    "/{number}",
    summary="Headers of a part",
    description="As GET, without the bytes.",
    operation_id="headMeshPart",
    response_class=Response,
    responses=_FILES,
)(get_part)


async def _mesh_in_parts(mesh_id: str, service: Service, caller: Reader) -> tuple[MeshRow, dict[str, Any]]:
    """A finished mesh in parts, and what its result says of them; raises 404 and 409 problems."""
    row = await service.mesh(mesh_id, caller)
    check_done(row, partial=False)
    parts = parts_of(row)
    if parts is None:
        raise Problem("not-found", "This mesh is whole, and has no parts.", remedy="GET /v1/meshes/{id}/file has it.")
    return row, parts


def _manifest(
    row: MeshRow, parts: Mapping[str, Any], form: PartFormat, artifacts: Mapping[str, Artifact], root: str
) -> Parts:
    here = f"{root}/v1/meshes/{row.id}"
    rows = [(int(first), int(last)) for first, last in parts["rows"]]
    listed = [
        PartRecord(
            number=number,
            first=first,
            last=last,
            rows=min(last + 1, row.n_xi) - first,
            file=_file(
                form.path_of_part(parts["name"], number),
                form.media_type,
                artifacts.get(part_artifact(form.name, number)),
                f"{here}/parts/{number}?format={form.name}",
            ),
        )
        for number, (first, last) in enumerate(rows)
    ]
    head = None
    if form.head_suffix:
        found = artifacts.get(head_name(form.name))
        href = f"{here}/file?format={form.name}"
        head = _file(form.head_name(parts["name"]), form.head_media_type, found, href)
    sizes = [file.size for file in (head, *(part.file for part in listed)) if file is not None]
    return Parts(
        id=row.id,
        format=form.name,
        formats=(*PART_FORMATS,),
        grid=GridSize(n_xi=row.n_xi, n_eta=row.n_eta),
        count=len(listed),
        size=None if None in sizes else sum(filter(None, sizes)),
        head=head,
        parts=tuple(listed),
    )


def _file(name: str, media_type: str, artifact: Artifact | None, href: str) -> FileOfParts:
    size, sha256 = (None, None) if artifact is None else (artifact.size, artifact.sha256)
    return FileOfParts(name=name, media_type=media_type, size=size, sha256=sha256, href=href)
