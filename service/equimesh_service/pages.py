"""The pages for people: a front page and the documentation, with all that they load. Scripts and styles are files."""

from __future__ import annotations

from functools import cache
from html import escape
from importlib.resources import files

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse
from starlette.responses import Response

from equimesh_service.problems import Problem
from equimesh_service.security_headers import page_policy

router = APIRouter(include_in_schema=False)

_OURS, _SWAGGER = "equimesh_service.assets", "fastapi_swagger.resources"
_ASSETS = {
    "docs.js": (_OURS, "text/javascript"),
    "front.css": (_OURS, "text/css"),
    "swagger-ui-bundle.js": (_SWAGGER, "text/javascript"),
    "swagger-ui.css": (_SWAGGER, "text/css"),
    "favicon-32x32.png": (_SWAGGER, "image/png"),
}
_FRONT_POLICY = page_policy(scripts="'none'", connects="'none'")
_DOCS_POLICY = page_policy(scripts="'self'", connects="'self'")


@router.get("/")
async def front(request: Request) -> HTMLResponse:
    """The front page."""
    base = escape(str(request.base_url).rstrip("/"))
    return HTMLResponse(_FRONT.format(base=base), headers={"Content-Security-Policy": _FRONT_POLICY})


@router.get("/docs")
async def docs() -> HTMLResponse:
    """The description of the interface, to read and to try."""
    return HTMLResponse(_DOCS, headers={"Content-Security-Policy": _DOCS_POLICY})


@router.get("/docs/assets/{name}")
async def asset(name: str) -> Response:
    """A file that a page loads; ``name`` is looked up, and is never part of a path."""
    if name not in _ASSETS:
        raise Problem("not-found", "No such file.")
    return Response(_read(name), media_type=_ASSETS[name][1], headers={"Cache-Control": "max-age=86400"})


@cache
def _read(name: str) -> bytes:
    return files(_ASSETS[name][0]).joinpath(name).read_bytes()


# Addresses are relative, so that they are right under any path that a proxy serves this at.
_DOCS = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>equimesh API</title>
<link rel="stylesheet" href="docs/assets/swagger-ui.css">
<link rel="icon" href="docs/assets/favicon-32x32.png">
</head>
<body>
<div id="swagger-ui"></div>
<script src="docs/assets/swagger-ui-bundle.js"></script>
<script src="docs/assets/docs.js"></script>
</body>
</html>
"""
_FRONT = """<!doctype html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>equimesh</title>
<link rel="stylesheet" href="docs/assets/front.css">
<link rel="icon" href="docs/assets/favicon-32x32.png">
<h1>equimesh</h1>
<p>Adaptive 2D meshes for PDE solvers. Send a function u(x, y); get back a mesh whose cells are small where u is
steep, in the format that your solver reads.</p>
<h2>A mesh in one request</h2>
<pre><code>curl '{base}/v1/meshes?format=vtu' \\
  -H 'Content-Type: application/json' -H 'Prefer: wait=30' -o mesh.vtu \\
  -d '{{"monitor": {{"u": {{"expression": "tanh(20*(x + y/2 - 0.75))"}}}}, "grid": {{"n_xi": 33, "n_eta": 33}}}}'
</code></pre>
<h2>Where to go</h2>
<ul>
<li><a href="docs">Documentation of the interface</a>, to read and to try (<a href="openapi.json">OpenAPI</a>)</li>
<li><a href="v1/capabilities">What this service can do</a>: formats, limits, functions in expressions</li>
<li><a href="v1/meshes">Meshes</a> that were asked for (where no API key is needed)</li>
<li><a href="readyz">State of the service</a></li>
</ul>
</html>
"""
