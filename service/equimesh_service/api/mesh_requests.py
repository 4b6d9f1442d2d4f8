"""Requests for a mesh: their bodies, headers and examples, for all routes that take one."""

from typing import Annotated, Any

from fastapi import Header, Query, Request

from equimesh.io.formats import FORMATS
from equimesh_service.admission.callers import Caller
from equimesh_service.admission.intake import Body
from equimesh_service.admission.tasks import AdmittedSpec
from equimesh_service.problems.problem import Problem
from equimesh_service.service import Service
from equimesh_service.telemetry import stopwatch
from equimesh_service.wire import body as bodies
from equimesh_service.wire.headers import MAX_PREFER, PREFER_PATTERN
from equimesh_service.worker.part_formats import HEADED

# Parameters of requests that may wait for a mesh.
Format = Annotated[
    str | None,
    Query(
        description="Answer with the mesh file in this format, when it finishes in time.",
        json_schema_extra={"enum": [*FORMATS, *HEADED]},
    ),
]
Prefer = Annotated[
    str | None,
    Header(
        description="`wait=N` answers when the mesh is finished, or after N seconds; without it at once.",
        # The page /docs fills the example in, so that its first request gives a mesh.
        json_schema_extra={"pattern": PREFER_PATTERN, "maxLength": MAX_PREFER, "example": "wait=30"},
    ),
]
IdempotencyKey = Annotated[
    str | None,
    Header(
        description="A repeated request with the same key gives the same mesh.",
        json_schema_extra={"minLength": 1, "maxLength": 255},
    ),
]
EXAMPLES: dict[str, Any] = {
    "single domain": {
        "summary": "One expression, everything else by default",
        "value": {"monitor": {"u": "tanh(20*(x + y/2 - 0.75))"}},
    },
    "paper": {
        "summary": "The mesh of Haynes and Howse's Table 1, classical conditions",
        "value": {
            "monitor": {
                "kind": "arc_length",
                "u": {"expression": "(1-exp(15*(x-1)))*sin(pi*y)"},
                "a": 0.7,
                "b": 0.05,
                "scaled": False,
            },
            "grid": {"n_xi": 12, "n_eta": 12},
            "boundary": "equidistributed_1d",
            "initial": "uniform",
            "schwarz": {
                "subdomains": [2, 1],
                "overlap": 2,
                "transmission": {"kind": "classical"},
                "ordering": "parallel",
                "tolerance": None,
                "max_iterations": 5,
            },
        },
    },
    "least error": {
        "summary": "The nodes where the error of the gradient is least, on triangles",
        "value": {
            "monitor": {"kind": "least_error", "u": "tanh(30*(y - 0.5 - 0.25*sin(2*pi*x)))", "norm": "h1"},
            "cells": "triangle",
        },
    },
    "target": {
        "summary": "An error in place of a grid",
        "value": {"monitor": {"u": "tanh(20*(x - y))"}, "target": {"norm": "l2", "error": 0.001}},
    },
    "curvature": {
        "summary": "The least interpolation error on a part of a ring",
        "value": {
            "monitor": {"kind": "curvature", "u": {"expression": "tanh(10*(x - y))"}, "smoothing": 0.05},
            "domain": {"kind": "annulus_sector", "radii": [1, 2], "angles": [0, 90]},
            "grid": {"n_xi": 33, "n_eta": 33},
        },
    },
    "weight": {
        "summary": "Cells three times smaller along the bottom of a channel with a bump",
        "value": {
            "monitor": {"kind": "weight", "rho": {"expression": "1 + 8*exp(-(4*y)**2)"}},
            "domain": {
                "kind": "quadrilateral",
                "bottom": {"x": "3*t", "y": "h*exp(-(6*t - 3)**2)", "parameters": {"h": 0.2}},
                "right": {"x": "3", "y": "h*exp(-9)*(1 - t) + t", "parameters": {"h": 0.2}},
                "top": {"points": [[0, 1], [3, 1]]},
                "left": {"x": "0", "y": "h*exp(-9)*(1 - t) + t", "parameters": {"h": 0.2}},
            },
            "grid": {"n_xi": 49, "n_eta": 17},
            "mode": "tight",
        },
    },
    "samples": {
        "summary": "u as samples on a grid",
        "value": {
            "monitor": {"u": {"grid": {"x": [0, 0.5, 1], "y": [0, 1], "values": [[0, 0], [1, 1], [0, 0]]}}},
            "grid": {"n_xi": 16, "n_eta": 16},
        },
    },
}


_SPEC = {"$ref": "#/components/schemas/MeshSpec"}


MESH_BODY = {
    "required": True,
    "content": {
        "application/json": {"schema": _SPEC, "examples": EXAMPLES},
        "multipart/form-data": {
            "schema": {
                "type": "object",
                "required": ["spec"],
                "properties": {
                    "spec": _SPEC,
                    "samples": {
                        "type": "string",
                        "contentMediaType": "application/octet-stream",
                        "description": "For {'samples': 'upload'}: npz, npy, csv, json, vtu or vtk.",
                    },
                    "mesh": {
                        "type": "string",
                        "contentMediaType": "application/octet-stream",
                        "description": "For the domain {'kind': 'mesh', 'file': 'upload'}: a file of quadrilaterals, "
                        "as POST /v1/samples?kind=mesh takes it. Its name tells the format.",
                    },
                },
            },
            "encoding": {"spec": {"contentType": "application/json"}},
        },
        bodies.NPZ: {
            "schema": {
                "type": "string",
                "contentMediaType": "application/octet-stream",
                "description": "The array `spec` with the JSON text of the spec, and arrays of samples beside it: for "
                "{'samples': 'upload'}.",
            }
        },
    },
}


async def read_raw(request: Request, service: Service, place: bodies.BodyPlace) -> bytes:
    """The bytes of a request for a mesh; raises 408, 413 and 415 problems."""
    bodies.check_kind(request.headers.get("content-type", ""))
    return await bodies.read_body(request, service.settings.max_body, place)


async def receive_body(request: Request, service: Service, caller: Caller, place: bodies.BodyPlace) -> Body:
    """A request for a mesh that is kept, as it came; raises a 429 problem for a key without room for it."""
    content = await read_raw(request, service, place)
    stopwatch.lap("receive")
    await service.quotas.check_bytes(caller, len(content))  # before the files are stored
    return Body(content_type=request.headers["content-type"], content=content, caller=caller)


async def receive_mesh(request: Request, service: Service, caller: Caller) -> AdmittedSpec:
    """Read and admit a request for a mesh, with the samples that came with it."""
    with service.bodies.place(caller.key_id) as place:
        body = await receive_body(request, service, caller, place)
        admitted = await service.intake.admit(body)
    service.metrics.count_uploads(admitted.uploads)
    stopwatch.lap("check")
    return admitted


def check_key(key: str | None) -> str | None:
    """The idempotency key, checked; raises a 400 problem."""
    if key is not None and not (0 < len(key) <= 255 and key.isprintable()):
        raise Problem("malformed-header", "An Idempotency-Key has 1 to 255 printable characters.")
    return key
