"""The FastAPI application: routes, errors, and the life of the service behind them."""

import re
import sqlite3
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from importlib.metadata import version
from typing import Any, Literal

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from pydantic import TypeAdapter
from sqlalchemy.exc import SQLAlchemyError
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.responses import Response

from equimesh_schema.mesh import ExpressionCheck, MeshSpec
from equimesh_schema.sequences import StepSettings, StepSpec
from equimesh_service.api import checks, events, mesh_parts, meshes, pages, results, samples, sequences, unstored
from equimesh_service.api import operations as operations_api
from equimesh_service.api.middleware import Observation, SiteGuard
from equimesh_service.api.resources import MeshEvents, ProblemDetails
from equimesh_service.problems.problem import Problem, problem_of
from equimesh_service.problems.storage import storage_problem
from equimesh_service.service import open_service
from equimesh_service.settings import Settings
from equimesh_service.telemetry.tracer import open_tracer
from equimesh_service.upkeep.metrics import Metrics
from equimesh_service.wire.headers import HeaderLimit, SecurityHeaders

_DESCRIPTION = """Adaptive 2D meshes for PDE solvers: send a monitor function, get a mesh.

One noun, **mesh**: it is requested (`POST /v1/meshes`), computed, and downloaded
(`GET /v1/meshes/{id}/file`). With `Prefer: wait=30` all of that is one round trip.

Every error is `application/problem+json` (RFC 9457) with a stable `type`. For bad input, `errors` lists what is wrong
and where: a JSON pointer, and the column in an expression.
"""
_TAGS = [
    {"name": "meshes", "description": "Request meshes, follow and cancel them."},
    {"name": "results", "description": "The mesh as a file, its quality, its convergence, pictures."},
    {"name": "sequences", "description": "Meshes that follow a time-stepper, step by step."},
    {"name": "samples", "description": "Monitor functions as samples, uploaded once."},
    {"name": "checks", "description": "Questions before a mesh is requested."},
    {"name": "operations", "description": "Health, and explanations of problems."},
]


def create_app(settings: Settings) -> FastAPI:
    """The application; its service opens and closes with the lifespan of the server."""
    metrics, tracer = Metrics(), open_tracer(settings.trace_endpoint, "service")

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        try:
            service = open_service(settings, metrics)
        except Exception as error:
            app.state.fault = f"{type(error).__name__}: {error}"  # the server only logs it
            raise
        app.state.service = service
        try:
            yield
        finally:
            service.wakeups.close()
            await run_in_threadpool(service.close)
            if tracer is not None:
                await run_in_threadpool(tracer.close)

    app = FastAPI(
        title="equimesh",
        summary="Equidistributed 2D meshes by Schwarz domain decomposition.",
        description=_DESCRIPTION,
        version=version("equimesh"),
        license_info={"name": "MIT", "identifier": "MIT"},
        openapi_tags=_TAGS,
        lifespan=lifespan,
        docs_url=None,
        redoc_url=None,
        swagger_ui_oauth2_redirect_url=None,
        redirect_slashes=False,  # a redirect of a POST is empty, and clients do not follow it
    )
    routes = (
        meshes,
        unstored,
        events,
        results,
        mesh_parts,
        sequences,
        samples,
        checks,
        operations_api,
        pages,
    )
    for part in routes:
        app.include_router(part.router)
    for kind in (Problem, RequestValidationError, HTTPException):
        app.add_exception_handler(kind, _answer_problem)
    for fault in (OSError, SQLAlchemyError, sqlite3.Error):
        app.add_exception_handler(fault, _answer_fault)
    app.add_middleware(HeaderLimit)
    app.add_middleware(SiteGuard, settings=settings)
    app.add_middleware(Observation, metrics=metrics, tracer=tracer)  # last, so that it is outermost
    _complete_schema(app)
    build = app.build_middleware_stack
    app.build_middleware_stack = lambda: SecurityHeaders(build())  # type: ignore[method-assign]
    return app


async def _answer_problem(request: Request, error: Exception) -> Response:
    if isinstance(error, HTTPException) and error.status_code == 405:
        error.headers = {**(error.headers or {}), "Allow": ", ".join(_methods(request))}
    return problem_of(error).response()


async def _answer_fault(_: Request, error: Exception) -> Response:
    problem = storage_problem(error)
    if problem is None:
        raise error
    return problem.response()


def _methods(request: Request) -> list[str]:
    """All methods of a path; Starlette names only those of one of its routes."""
    paths: dict[str, dict[str, Any]] = request.app.openapi()["paths"]
    taken: set[str] = set()
    for template, operations in paths.items():
        if re.fullmatch(re.sub(r"\{\w+\}", "[^/]+", template), request.url.path):
            taken |= {method.upper() for method in operations}
    return sorted(taken) or ["GET"]


def _complete_schema(app: FastAPI) -> None:
    """Add the models of the bodies that routes read themselves."""
    generate = app.openapi

    def openapi() -> dict[str, Any]:
        if app.openapi_schema is None:
            schema = generate()
            requests, answers = (MeshSpec, ExpressionCheck, StepSpec, StepSettings), (MeshEvents, ProblemDetails)
            bodies: list[tuple[str, Literal["validation", "serialization"], TypeAdapter[Any]]] = [
                *((made.__name__, "validation", TypeAdapter[Any](made)) for made in requests),
                *((made.__name__, "serialization", TypeAdapter[Any](made)) for made in answers),
            ]
            _, extra = TypeAdapter.json_schemas(bodies, ref_template="#/components/schemas/{model}")
            schema["components"]["schemas"].update(extra["$defs"])
            _remove_foreign_errors(schema)
            _make_keys_optional(schema)
            app.openapi_schema = schema
        return app.openapi_schema

    app.openapi = openapi  # type: ignore[method-assign]


def _remove_foreign_errors(schema: dict[str, Any]) -> None:
    """Remove FastAPI's own 422 from every route with a parameter; the service documents its own."""
    for name in ("HTTPValidationError", "ValidationError"):
        schema["components"]["schemas"].pop(name, None)
    for operations in schema["paths"].values():
        for operation in operations.values():
            if "application/json" in operation["responses"].get("422", {}).get("content", {}):
                del operation["responses"]["422"]


def _make_keys_optional(schema: dict[str, Any]) -> None:
    """Document that operations also work without a key: they do until the first key is created."""
    for operations in schema["paths"].values():
        for operation in operations.values():
            if "security" in operation:
                operation["security"].append({})
