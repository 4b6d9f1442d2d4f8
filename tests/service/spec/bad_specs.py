"""Specs with one mistake each, and the answer that each gets: a 422 with pointer, message and position."""

from __future__ import annotations

import json
from typing import Any

import httpx

from service.conftest import small
from service.requests import CURVED

GRID = {"x": [0, 0.5, 1], "y": [0, 1], "values": [[0, 0], [1, 1], [0, 2]]}
SCATTERED = {"points": [[0, 0], [1, 0], [0, 1], [1, 1], [0.4, 0.6]], "values": [0, 1, 2, 3, 4]}


def u(expression: str, **more: Any) -> dict[str, Any]:
    return small(monitor={"kind": "arc_length", "u": {"expression": expression, **more}})


def on_grid(**more: Any) -> dict[str, Any]:
    return small(monitor={"kind": "arc_length", "u": {"grid": {**GRID, **more}}})


def scattered(**more: Any) -> dict[str, Any]:
    return small(monitor={"kind": "arc_length", "u": {"scattered": {**SCATTERED, **more}}})


def schwarz(**more: Any) -> dict[str, Any]:
    return small(schwarz=more)


def monitor(kind: str, **more: Any) -> dict[str, Any]:
    return small(monitor={"kind": kind, **more})


def both(*monitors: Any) -> dict[str, Any]:
    return monitor("intersection", monitors=list(monitors))


def on(**domain: Any) -> dict[str, Any]:
    return small(domain=domain)


def between(**sides: Any) -> dict[str, Any]:
    return small(domain={**CURVED, **sides})


X = {"expression": "x"}
ONE = {"expression": "1"}
ARC: dict[str, Any] = {"u": X}
WEIGHT = {"kind": "weight", "rho": ONE}
LINE = [[0, k / 10_000] for k in range(10_001)]
EXPRESSION = "/monitor/u/expression"


# The spec, or its text; the pointer to the mistake; a part of the message; and in an expression the column.
Refusal = tuple[Any, str, str] | tuple[Any, str, str, int]


def expect_refusal(http: httpx.Client, refusal: Refusal) -> None:
    spec, pointer, message, *column = refusal
    body = spec if isinstance(spec, str) else json.dumps(spec)
    answer = http.post("/v1/meshes", content=body, headers={"Content-Type": "application/json"})
    assert answer.status_code == 422, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    problem = answer.json()
    assert (problem["type"], problem["status"]) == ("/problems/invalid-input", 422)
    first = problem["errors"][0]
    assert first["pointer"] == pointer, first
    assert message in first["message"], first
    assert len(first["message"]) < 1000
    assert not column or [first["position"]["column"]] == column, first
