"""Routes used before a mesh is requested: checks of expressions, and the capabilities of the service."""

from collections.abc import Mapping
from dataclasses import asdict
from importlib.metadata import version
from typing import Any

from fastapi import APIRouter, Request

from equimesh.formulas.vocabulary import FUNCTIONS, LIMITS
from equimesh.io.formats import FORMATS
from equimesh_schema import schwarz
from equimesh_schema.document import OneOf, Words
from equimesh_schema.domains import DOMAINS
from equimesh_schema.mesh import BOUNDARIES, CELLS, INITIALS, MODES
from equimesh_schema.monitors import MONITORS
from equimesh_schema.sequences import LOCATIONS, MAX_COMPONENTS, MAX_FIELDS, OUTRUNS, TRANSFERS
from equimesh_schema.settings import choices
from equimesh_service.admission.callers import Caller
from equimesh_service.api.resources import DomainReport, ExpressionReport
from equimesh_service.api.routing import KEY_PROBLEMS, Reader, ServiceDependency, problems
from equimesh_service.service import Service
from equimesh_service.spec.document import parse
from equimesh_service.spec.mesh import MESH_PLACE, read_expression_check
from equimesh_service.spec.strict import to_json
from equimesh_service.wire import body as bodies
from equimesh_service.worker.job import PICTURES, PLOTS
from equimesh_service.worker.part_formats import PART_FORMATS

router = APIRouter(prefix="/v1", tags=["checks"])

# Points in each direction at which an expression is evaluated.
_CHECKED_POINTS = 65
_BODY = {
    "required": True,
    "content": {
        "application/json": {
            "schema": {"$ref": "#/components/schemas/ExpressionCheck"},
            "example": {"expression": "tanh(k*(x - 0.5))", "parameters": {"k": 20}},
        }
    },
}


@router.post(
    "/expressions/check",
    summary="Check an expression",
    operation_id="checkExpression",
    responses={**problems(400, 408, 413, 415, 422, 503), **KEY_PROBLEMS},
    openapi_extra={"requestBody": _BODY},
)
async def check(request: Request, service: ServiceDependency, caller: Reader) -> ExpressionReport:
    """Parse the expression and evaluate it on the domain, the unit square unless given.

    A 422 tells what is wrong, and at which column.
    """
    with service.bodies.place(caller.key_id) as place:
        data = await bodies.read_plain_json(request, service.settings.max_body, place)

    return await service.check(_report, data, service, caller)


@router.get(
    "/capabilities", summary="What this service can do", operation_id="getCapabilities", responses=problems(403)
)
async def capabilities(service: ServiceDependency) -> dict[str, Any]:
    """Formats and their readers, limits, the language of expressions, the choices of a spec, the engine."""
    settings = service.settings
    health = service.engine.health()
    return {
        "version": version("equimesh"),
        "formats": [asdict(form) for form in FORMATS.values()],
        "part_formats": [asdict(form) for form in PART_FORMATS.values()],
        "cells": list(CELLS),
        "plots": {"kinds": list(PLOTS), "formats": dict(PICTURES)},
        "samples": {
            "formats": ["npz", "npy", "csv", "txt", "json", "vtu", "vtk"],
            "max_samples": settings.max_samples,
        },
        "sequences": {
            "monitors": list(MONITORS.documents),
            "max_fields": MAX_FIELDS,
            "max_components": MAX_COMPONENTS,
            "transfers": list(TRANSFERS),
            "locations": list(LOCATIONS),
            "outruns": list(OUTRUNS),
        },
        **choices(),
        "domains": _uses(DOMAINS),
        "modes": _uses(MODES),
        "boundaries": list(BOUNDARIES),
        "initials": list(INITIALS),
        "interface_data": _uses(schwarz.INTERFACE_DATA),
        "orderings": _uses(schwarz.ORDERINGS),
        "accelerations": _uses(schwarz.ACCELERATIONS),
        "local_solvers": _uses(schwarz.LOCAL_SOLVERS),
        "expressions": {"names": ["x", "y", "t", "pi", "e"], "functions": dict(FUNCTIONS), "limits": asdict(LIMITS)},
        "limits": {
            "max_points": settings.max_points,
            "max_cluster_points": settings.max_cluster_points if settings.has_cluster else 0,
            "max_preview_points": min(settings.max_points, settings.max_preview_points),
            "preview_seconds": settings.preview_seconds,
            "max_body": settings.max_body,
            "max_samples": settings.max_samples,
            "max_subdomains": settings.max_subdomains,
            "max_iterations": settings.max_iterations,
            "max_wait": settings.max_wait,
            "time_limit": settings.time_limit,
            "memory_limit": settings.memory_limit,
        },
        "engine": {"kind": "processes", "workers": health.workers, "ready": health.ready},
    }


def _uses(choices: OneOf | Words) -> list[dict[str, str]]:
    """The names of documents or words, and when to use them."""
    uses = choices.uses if isinstance(choices, Words) else {n: made.USE for n, made in choices.documents.items()}
    return [{"name": name, "when_to_use": use} for name, use in uses.items()]


def _report(data: bytes, service: Service, caller: Caller) -> ExpressionReport:
    document, admission = to_json(read_expression_check(parse(data))), service.checks.admission
    from equimesh import specs
    from equimesh_service.assembly.problem import translate_errors
    from equimesh_service.assembly.samples import blocks_of

    def find(name: str, settings: Mapping[str, Any]) -> Any:
        row = admission.find_stored(name, MESH_PLACE, caller)
        with service.files.local(row.sha256) as path:
            return blocks_of(path, settings)

    with translate_errors():
        domain = specs.build_domain(document.pop("domain"), find)
        expression = specs.build_expression(document, domain)
    shape = DomainReport(box=[list(ends) for ends in domain.box], area=domain.area)
    return ExpressionReport(**expression.summary(_CHECKED_POINTS, domain), domain=shape)
