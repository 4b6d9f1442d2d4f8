"""Requests that many tests send, and files that they upload."""

from __future__ import annotations

import io
from typing import Any

import httpx
import numpy as np

from service.conftest import small

WAIT = {"Prefer": "wait=300"}


def post(http: httpx.Client, spec: dict[str, Any], query: str = "", **headers: str) -> httpx.Response:
    return http.post(f"/v1/meshes{query}", json=spec, headers=headers)


def npz(**arrays: Any) -> bytes:
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


def solved(http: httpx.Client, spec: dict[str, Any], **more: Any) -> dict[str, Any]:
    answer = http.post("/v1/meshes", **({"json": spec} | more), headers=WAIT)
    assert answer.status_code in (201, 202), answer.text
    mesh: dict[str, Any] = http.get(answer.headers["Location"], params={"wait": 300}).json()
    assert mesh["status"] == "succeeded", mesh["error"]
    return mesh


def arrays(http: httpx.Client, mesh: dict[str, Any]) -> Any:
    return np.load(io.BytesIO(http.get(mesh["links"]["file"], params={"format": "npz"}).content))


GRID = {"grid": {"x": [0, 1], "y": [0, 1], "values": [[0, 1], [2, 5]]}}
FRONT = small(
    monitor={"kind": "arc_length", "u": {"expression": "tanh(20*(x + y/2 - 0.6))"}, "scaled": False},
    grid={"n_xi": 17, "n_eta": 13},
    domain={"kind": "annulus_sector", "radii": [0.5, 1.5], "angles": [10, 80]},
)


# A domain whose sides are curves.
CURVED: dict[str, Any] = {
    "kind": "quadrilateral",
    "bottom": {"x": "t", "y": "h*sin(pi*t)", "parameters": {"h": 0.2}},
    "right": {"points": [[1, 0], [1.1, 0.5], [1, 1]]},
    "top": {"points": [[0, 1], [1, 1]]},
    "left": {"x": "0", "y": "t"},
}


# A channel with a step, in three blocks.
STEP: dict[str, Any] = {
    "kind": "blocks",
    "vertices": {
        "a": [-1, 0.5],
        "b": [0, 0.5],
        "c": [0, 1],
        "d": [-1, 1],
        "e": [2, 0.5],
        "f": [2, 1],
        "g": [0, 0],
        "h": [2, 0],
    },
    "blocks": [
        {"corners": ["a", "b", "c", "d"], "cells": [6, 4]},
        {"corners": ["b", "e", "f", "c"], "cells": [12, 4], "name": "upper"},
        {"corners": ["g", "h", "e", "b"], "cells": [12, 4]},
    ],
    "sides": {"inlet": [["d", "a"]], "outlet": [["h", "e"], ["e", "f"]], "step": [["a", "b"], ["b", "g"]]},
}
