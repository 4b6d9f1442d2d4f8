"""The site of the documentation under ``/site``: what ``deploy/site`` built into the folder ``site`` of the package.

Where nobody built it, the pages of the guide have the same addresses, in a plain form.
A path is looked up among the files that are there, and is never part of a path on the disk. Addresses in the pages are
relative, so that they work under any path of a proxy.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from functools import lru_cache
from importlib.resources import files
from pathlib import Path

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response
from starlette.staticfiles import StaticFiles

from equimesh_service.guide.plain import ROOT, guide_nowhere, guide_page, guide_pages
from equimesh_service.problems.problem import Problem
from equimesh_service.wire.security_headers import page_policy

router = APIRouter(include_in_schema=False)

# The built site; the folder is not there where nobody built it.
FOLDER = Path(__file__).parents[1] / "site"
# HEAD is answered as GET; the server leaves the body out.
_METHODS = ["GET", "HEAD"]
# Icons of the theme are addresses that begin with data:.
_POLICY = page_policy(pictures="'self' data:")
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
    return await run_in_threadpool(_answer, path, request)


def _answer(path: str, request: Request) -> Response:
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
    response.headers["Content-Security-Policy"] = _POLICY
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
    return {"Content-Security-Policy": _POLICY, "Cache-Control": _PAGES}
