"""Routes for operators: health, metrics, explanations of problems."""

from typing import Any

from fastapi import APIRouter, Request
from fastapi.responses import JSONResponse, PlainTextResponse
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from equimesh_service.api.pages import problem_page
from equimesh_service.api.resources import ReadinessReport
from equimesh_service.api.routing import KEY_PROBLEMS, Admin, ServiceDependency, problems
from equimesh_service.problems.problem import KINDS, Problem, did_you_mean
from equimesh_service.upkeep.readiness import OK
from equimesh_service.wire.headers import choose_offer

router = APIRouter(tags=["operations"])

_UNREADY: dict[int | str, dict[str, Any]] = {
    503: {"description": "A part is not ready; the body says which.", "model": ReadinessReport}
}
_PROBLEM_OFFERS = {"json": "application/json", "page": "text/html"}
_PROBLEM_ANSWERS: dict[int | str, dict[str, Any]] = {
    200: {"content": {"text/html": {"schema": {"type": "string"}}}},
    **problems(403, 404),
}
_OPENMETRICS = "application/openmetrics-text"


@router.get("/livez", summary="Is the process alive", operation_id="getLiveness")
@router.head("/livez", summary="As GET, without a body", operation_id="headLiveness")
async def livez() -> dict[str, str]:
    """200 while the process answers."""
    return {"status": "ok"}


@router.get(
    "/readyz",
    summary="Can the service work",
    operation_id="getReadiness",
    response_model=ReadinessReport,
    responses=_UNREADY,
)
@router.head("/readyz", summary="As GET, without a body", operation_id="headReadiness", responses=_UNREADY)
async def readyz(service: ServiceDependency) -> Response:
    """Whether the store, the files, the engine and the dispatcher work, by checks that are at most a second old.

    `warnings` has sentences about what is wrong but stops no work. `warm_up` tells how far the loops
    are that are compiled in advance; with 200, those of rare kinds of problems are still missing.
    """
    checks = await service.readiness.check()
    ready = all(result == OK for result in checks.values())
    status = OK if ready else "unavailable"
    body = {"status": status, "checks": checks, "warnings": service.readiness.warnings()}
    warm_up = await run_in_threadpool(service.readiness.warm_up)
    if warm_up is not None:
        body["warm_up"] = warm_up
    return JSONResponse(body, 200 if ready else 503)


@router.get(
    "/metrics",
    summary="Metrics for Prometheus",
    operation_id="getMetrics",
    response_class=PlainTextResponse,
    responses={
        200: {"content": {media: {"schema": {"type": "string"}} for media in ("text/plain", _OPENMETRICS)}},
        **problems(404),
        **KEY_PROBLEMS,
    },
)
async def get_metrics(request: Request, service: ServiceDependency, caller: Admin) -> Response:  # noqa: ARG001
    """The metrics, in the text format of Prometheus or, where Accept requests it, of OpenMetrics."""
    if not service.settings.metrics:
        raise Problem("not-found", "Metrics are switched off (EQUIMESH_METRICS).")
    content, media_type = await run_in_threadpool(service.metrics.scrape, request.headers.get("accept", ""))
    return Response(content, headers={"Content-Type": media_type})


@router.get(
    "/problems/{name}",
    summary="What a problem means",
    operation_id="getProblem",
    response_model=dict[str, Any],
    responses=_PROBLEM_ANSWERS,
)
@router.head(
    "/problems/{name}", summary="As GET, without a body", operation_id="headProblem", responses=_PROBLEM_ANSWERS
)
async def get_problem(name: str, request: Request) -> Response:
    """The explanation of a problem's `type`: JSON, or a page where Accept names `text/html` first, as browsers do."""
    kind = KINDS.get(name)
    if kind is None:
        near = did_you_mean(name, KINDS) or "."
        raise Problem("not-found", f"There is no such problem; there are {', '.join(KINDS)}{near}")
    vary = {"Vary": "Accept"}
    if choose_offer(request.headers.get("accept"), _PROBLEM_OFFERS) == "page":
        return problem_page(kind, vary)
    body = {"type": kind.type, "title": kind.title, "status": kind.status, "remedy": kind.remedy}
    return JSONResponse(body, headers=vary)
