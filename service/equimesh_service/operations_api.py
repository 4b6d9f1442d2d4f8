"""Routes for operators and for people: health, explanations of problems, the docs, the front page."""

from __future__ import annotations

from collections.abc import Callable
from html import escape
from importlib.resources import files
from typing import Any

from fastapi import APIRouter, FastAPI, Request
from fastapi.openapi.docs import get_swagger_ui_html
from fastapi.responses import HTMLResponse, JSONResponse
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from equimesh_service.problems import KINDS, Problem
from equimesh_service.routing import ServiceDependency, problems
from equimesh_service.service import Service

router = APIRouter(tags=["operations"])

_ASSETS = {
    "swagger-ui-bundle.js": "text/javascript",
    "swagger-ui.css": "text/css",
    "favicon-32x32.png": "image/png",
}


@router.get("/livez", summary="Is the process alive", operation_id="getLiveness")
async def livez() -> dict[str, str]:
    """200 as long as the process answers."""
    return {"status": "ok"}


@router.get(
    "/readyz",
    summary="Can the service work",
    operation_id="getReadiness",
    response_model=dict[str, Any],
    responses={503: {"description": "Something is not ready; the body says what."}},
)
async def readyz(service: ServiceDependency) -> Response:
    """Whether the store, the files, the engine and the dispatcher do their work."""
    checks = await run_in_threadpool(_checks, service)
    ready = all(result == "ok" for result in checks.values())
    return JSONResponse({"status": "ok" if ready else "unavailable", "checks": checks}, 200 if ready else 503)


@router.get(
    "/problems/{name}",
    summary="What a problem means",
    operation_id="getProblem",
    responses=problems(404),
)
async def get_problem(name: str) -> dict[str, Any]:
    """The explanation of a problem's `type`."""
    kind = KINDS.get(name)
    if kind is None:
        raise Problem("not-found", f"There is no such problem; there are {', '.join(KINDS)}.")
    return {"type": kind.type, "title": kind.title, "status": kind.status, "remedy": kind.remedy}


def add_pages(app: FastAPI) -> None:
    """Add the pages for people; everything they load comes from this service."""

    @app.get("/docs", include_in_schema=False)
    async def docs(request: Request) -> HTMLResponse:
        root = request.scope.get("root_path", "").rstrip("/")
        return get_swagger_ui_html(
            openapi_url=f"{root}/openapi.json",
            title="equimesh API",
            swagger_js_url=f"{root}/docs/assets/swagger-ui-bundle.js",
            swagger_css_url=f"{root}/docs/assets/swagger-ui.css",
            swagger_favicon_url=f"{root}/docs/assets/favicon-32x32.png",
            swagger_ui_parameters={"tryItOutEnabled": True, "validatorUrl": None},
        )

    @app.get("/docs/assets/{name}", include_in_schema=False)
    def asset(name: str) -> Response:
        if name not in _ASSETS:
            raise Problem("not-found", "No such file.")
        data = files("fastapi_swagger.resources").joinpath(name).read_bytes()
        return Response(data, media_type=_ASSETS[name], headers={"Cache-Control": "max-age=86400"})

    @app.get("/", include_in_schema=False)
    async def front(request: Request) -> HTMLResponse:
        return HTMLResponse(_FRONT.format(base=escape(str(request.base_url).rstrip("/"))))


def _checks(service: Service) -> dict[str, str]:
    health = service.engine.health()
    desk = service.desk.health()
    return {
        "store": _try(service.store.check),
        "files": _try(service.files.check),
        "engine": "ok" if health.ready else health.detail,
        "exports": "ok" if desk.ready else desk.detail,
        "dispatcher": "ok" if service.dispatcher.alive() else "stopped",
    }


def _try(check: Callable[[], None]) -> str:
    try:
        check()
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return "ok"


_FRONT = """<!doctype html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>equimesh</title>
<style>
body {{ font: 1rem/1.5 system-ui, sans-serif; max-width: 46rem; margin: 3rem auto; padding: 0 1rem; color: #222 }}
pre {{ background: #f3f3f3; padding: 1rem; overflow-x: auto; border-radius: 4px }}
code {{ font-family: ui-monospace, monospace; font-size: .9em }}
a {{ color: #14508c }}
</style>
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
<li><a href="v1/meshes">Meshes</a> that were asked for</li>
<li><a href="readyz">State of the service</a></li>
</ul>
</html>
"""
