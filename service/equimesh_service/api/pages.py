"""The pages for people: the documentation, the site and the workbench, with the files that these load.

Pages, scripts and styles are files in ``assets``. Addresses in them are relative, so that they work under any path of a
proxy.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache, lru_cache
from hashlib import sha256
from html import escape
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response
from starlette.staticfiles import StaticFiles

from equimesh_schema.settings import choices as schema_choices
from equimesh_service.guide.plain import ROOT, guide_nowhere, guide_page, guide_pages
from equimesh_service.problems.problem import KINDS, Kind, Problem
from equimesh_service.wire.headers import page_policy

router = APIRouter(include_in_schema=False)

# HEAD is answered as GET; the server leaves the body out.
_METHODS = ["GET", "HEAD"]
# The packages of the files: the service's own, and those of Swagger UI.
_OURS = "equimesh_service.api.assets"
_SWAGGER = "fastapi_swagger.resources"
_ASSETS = {
    "docs.js": (_OURS, "text/javascript"),
    "docs.css": (_OURS, "text/css"),
    "problem.css": (_OURS, "text/css"),
    "swagger-ui-bundle.js": (_SWAGGER, "text/javascript"),
    "swagger-ui.css": (_SWAGGER, "text/css"),
}
_PROBLEM_POLICY = page_policy(pictures="'self'")
_DOCS_POLICY = page_policy(pictures="'self' data:")


@router.api_route("/docs", methods=_METHODS)
async def docs() -> HTMLResponse:
    """The interface, to read and to try."""
    return HTMLResponse(_read("docs.html"), headers={"Content-Security-Policy": _DOCS_POLICY})


@router.api_route("/docs/assets/{name}", methods=_METHODS)
async def asset(name: str) -> Response:
    """A file that a page loads; ``name`` is looked up, and is never part of a path."""
    if name not in _ASSETS:
        raise Problem("not-found", "No such file.")
    return Response(_read(name), media_type=_ASSETS[name][1], headers={"Cache-Control": "max-age=86400"})


def problem_page(kind: Kind, headers: Mapping[str, str]) -> HTMLResponse:
    """The explanation of a problem, and the list of all others, for browsers."""
    others = "".join(f'<li><a href="{other.name}">{escape(other.title)}</a></li>' for other in KINDS.values())
    values = {"TITLE": escape(kind.title), "STATUS": str(kind.status), "TYPE": kind.type}
    page = _read("problem.html").decode()
    for word, value in {**values, "REMEDY": escape(kind.remedy), "OTHERS": others}.items():
        page = page.replace(word, value)
    return HTMLResponse(page, headers={"Content-Security-Policy": _PROBLEM_POLICY, **headers})


@cache
def _read(name: str) -> bytes:
    return files(_ASSETS[name][0] if name in _ASSETS else _OURS).joinpath(name).read_bytes()


# The built site; the folder is not there where nobody built it.
FOLDER = Path(__file__).parents[1] / "site"
# Icons of the theme are addresses that begin with data:.
_SITE_POLICY = page_policy(pictures="'self' data:")
# In the page for addresses that lead nowhere: the way up to the front page, which depends on the address.
_ROOT = "{{root}}"
# Below more folders than this an address gets no page: each link in it would be as long as the address.
_MAX_DEPTH = 20
# Pages and the index of the search are asked for again each time, with their ETag; what pages load is kept for a day.
_PAGES = "no-cache"
_LOADED = "max-age=86400"
_LOADED_FOLDERS = ("_static", "_images")
_FILES = StaticFiles(check_dir=False)
# What the guide is read from, where nobody built the site.
GUIDE = ROOT


@router.api_route("/site", methods=_METHODS)
async def without_slash() -> Response:
    """The way to the front page."""
    return Response(status_code=307, headers={"Location": "site/", "Cache-Control": _PAGES})


@router.api_route("/site/{path:path}", methods=_METHODS)
async def page(path: str, request: Request) -> Response:
    """A file of the site; of a folder its ``index.html``."""
    return await run_in_threadpool(_site_answer, path, request)


def _site_answer(path: str, request: Request) -> Response:
    try:
        built = os.stat(FOLDER / "index.html").st_mtime_ns
    except OSError:
        return _plain(path, request)
    known = _table(FOLDER, built)
    if f"{path}/index.html" in known:  # relative addresses of that page need the slash
        return Response(status_code=307, headers={"Location": f"{path.rpartition('/')[2]}/", "Cache-Control": _PAGES})
    found = known.get(f"{path}index.html" if path.endswith("/") or not path else path)
    if found is None or not found.is_file():
        return _nowhere(_depth(request), known)
    response = _FILES.file_response(found, os.stat(found), request.scope)
    response.headers["Content-Security-Policy"] = _SITE_POLICY
    response.headers["Cache-Control"] = _LOADED if path.startswith(_LOADED_FOLDERS) else _PAGES
    return response


@lru_cache(maxsize=1)
def _table(folder: Path, _built: int) -> Mapping[str, Path]:
    """The files of a site by their paths; another build is looked at again."""
    return {file.relative_to(folder).as_posix(): file for file in folder.rglob("*") if file.is_file()}


def _depth(request: Request) -> int:
    """How many folders below the front page a browser is; an encoded slash is none for it."""
    sent: bytes = request.scope.get("raw_path") or request.scope["path"].encode()
    above = str(request.scope.get("root_path", "")) + "/site/"
    return sent.partition(b"?")[0].count(b"/") - above.count("/")


def _nowhere(depth: int, known: Mapping[str, Path]) -> Response:
    """The site's page for an address that leads nowhere, with links from where the reader is."""
    if "404.html" not in known or depth > _MAX_DEPTH:
        raise Problem("not-found", "No such page.")
    text = known["404.html"].read_text(encoding="utf-8").replace(_ROOT, "../" * depth)
    return HTMLResponse(text, status_code=404, headers=_headers())


def _plain(path: str, request: Request) -> Response:
    """A page of the guide where nobody built the site."""
    pages = guide_pages(GUIDE)
    if not pages:
        return _unbuilt(_depth(request))
    if f"{path}/index.html" in pages:
        return Response(status_code=307, headers={"Location": f"{path.rpartition('/')[2]}/", "Cache-Control": _PAGES})
    name = f"{path}index.html" if path.endswith("/") or not path else path
    if name not in pages:
        if _depth(request) > _MAX_DEPTH:
            raise Problem("not-found", "No such page.")
        return HTMLResponse(guide_nowhere(_depth(request)), status_code=404, headers=_headers())
    if name.endswith(".html"):
        return HTMLResponse(guide_page(name, pages), headers=_headers())
    response = _FILES.file_response(pages[name], os.stat(pages[name]), request.scope)
    response.headers.update(_headers())
    return response


def _unbuilt(depth: int) -> Response:
    if depth > _MAX_DEPTH:
        raise Problem("not-found", "No such page.")
    text = files("equimesh_service.api.assets").joinpath("site_unbuilt.html").read_text(encoding="utf-8")
    return HTMLResponse(text.replace(_ROOT, "../" * depth), status_code=404, headers=_headers())


def _headers() -> dict[str, str]:
    return {"Content-Security-Policy": _SITE_POLICY, "Cache-Control": _PAGES}


_PAGE = "index.html"
# The types of files that are served; others in the folder are not.
_TYPES = {
    ".css": "text/css",
    ".html": "text/html",
    ".js": "text/javascript",
    ".json": "application/json",
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
        **dict(_walk(files("equimesh_schema").joinpath("browser"), "browser/")),
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
