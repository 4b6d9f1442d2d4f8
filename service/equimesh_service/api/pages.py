"""The pages for people: the documentation of the interface, explanations of problems, and the files that these load.

Pages, scripts and styles are files in ``assets``. Addresses in them are relative, so that they work under any path of a
proxy.
"""

from collections.abc import Mapping
from functools import cache
from html import escape
from importlib.resources import files

from fastapi import APIRouter
from fastapi.responses import HTMLResponse
from starlette.responses import Response

from equimesh_service.problems.problem import KINDS, Kind, Problem
from equimesh_service.wire.security_headers import page_policy

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
