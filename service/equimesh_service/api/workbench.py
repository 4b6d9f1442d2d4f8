"""The workbench, the page at ``/``: its document, and the scripts and styles that this loads.

They are the files of ``equimesh_service/workbench``, and ``choices.js``, the kinds and settings of the schema. They are
served under ``/workbench``. Addresses in them are relative, so that they work under any path of a proxy.
"""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from importlib.resources import files
from importlib.resources.abc import Traversable

from fastapi import APIRouter, Request
from starlette.responses import Response

from equimesh_schema.settings import choices as schema_choices
from equimesh_service.problems.problem import Problem
from equimesh_service.wire.security_headers import page_policy

router = APIRouter(include_in_schema=False)

# HEAD is answered as GET; the server leaves the body out.
_METHODS = ["GET", "HEAD"]
_PAGE = "index.html"
# The types of files that are served; others in the folder are not.
_TYPES = {
    ".css": "text/css",
    ".html": "text/html",
    ".js": "text/javascript",
    ".json": "application/json",
    ".npz": "application/octet-stream",
    ".svg": "image/svg+xml",
}
# Pictures of the page are made in the browser, as blobs.
_POLICY = page_policy(pictures="'self' blob:")


@dataclass(frozen=True, kw_only=True)
class WorkbenchFile:
    """A file of the workbench, with the ETag of its bytes."""

    content: bytes
    media_type: str
    etag: str


@router.api_route("/", methods=_METHODS)
async def workbench(request: Request) -> Response:
    """The page."""
    return _answer(request, workbench_files()[_PAGE])


@router.api_route("/workbench/{path:path}", methods=_METHODS)
async def workbench_file(path: str, request: Request) -> Response:
    """A file that the page loads; ``path`` is looked up in a table, and is never part of a path on disk."""
    file = workbench_files().get(path)
    if file is None or path == _PAGE:
        raise Problem("not-found", "No such file of the workbench.")
    return _answer(request, file)


@cache
def workbench_files() -> Mapping[str, WorkbenchFile]:
    """The files of the workbench by their path below its folder."""
    head = "// The kinds and settings that /v1/capabilities lists."
    choices = f"{head}\nexport const CHOICES = {json.dumps(schema_choices())};\n"
    return {
        **dict(_walk(files("equimesh_service").joinpath("workbench"), "")),
        "choices.js": _file(choices.encode(), _TYPES[".js"]),
    }


def _walk(folder: Traversable, above: str) -> Iterator[tuple[str, WorkbenchFile]]:
    for entry in folder.iterdir():
        path = f"{above}{entry.name}"
        media_type = _TYPES.get("." + entry.name.rpartition(".")[2])
        if entry.is_dir():
            yield from _walk(entry, f"{path}/")
        elif media_type is not None:
            yield path, _file(entry.read_bytes(), media_type)


def _file(content: bytes, media_type: str) -> WorkbenchFile:
    return WorkbenchFile(content=content, media_type=media_type, etag=f'"{sha256(content).hexdigest()}"')


def _answer(request: Request, file: WorkbenchFile) -> Response:
    # A browser asks each time whether a file has changed: a page never mixes scripts of two releases.
    headers = {"Cache-Control": "no-cache", "ETag": file.etag}
    if file.media_type == "text/html":
        headers["Content-Security-Policy"] = _POLICY
    if file.etag in request.headers.get("If-None-Match", ""):
        return Response(status_code=304, headers=headers)
    return Response(file.content, media_type=file.media_type, headers=headers)
