"""Domains of blocks in specs: what a request makes of them, and what is refused with its place."""

from __future__ import annotations

from typing import Any

import httpx
import pytest

from service.requests import STEP
from service.spec.bad_specs import Refusal, expect_refusal

LEAST: dict[str, Any] = {"kind": "least_error", "u": {"expression": "tanh(9*(y - x))"}}


def spec(**more: Any) -> dict[str, Any]:
    return {"monitor": LEAST, "domain": STEP, **more}


def step(**more: Any) -> dict[str, Any]:
    return spec(domain={**STEP, **more})


UNEVEN = [{**STEP["blocks"][0], "cells": [6, 5]}, *STEP["blocks"][1:]]
REFUSED: dict[str, Refusal] = {
    "grid": (spec(grid={"n_xi": 9, "n_eta": 9}), "/grid", "leave the grid out"),
    "target": (spec(target={"error": 1e-3}), "/target", "refine the blocks"),
    "another schwarz": (spec(schwarz={"subdomains": [2, 1]}), "/schwarz/subdomains", "known are overlap"),
    "schwarz.overlap": (spec(schwarz={"overlap": 0}), "/schwarz/overlap", "from 1 to 64"),
    "schwarz.max_exchanges": (spec(schwarz={"max_exchanges": 1001}), "/schwarz/max_exchanges", "at most 1000"),
    "schwarz.groups": (spec(schwarz={"groups": [["upper"]]}), "/schwarz/groups", "is in no group"),
    "no list of groups": (spec(schwarz={"groups": ["upper"]}), "/schwarz/groups", "a list of lists"),
    "boundary": (spec(boundary="orthogonal"), "/boundary", "slide"),
    "metric": (spec(monitor={"kind": "curvature", "u": "x*y"}), "/monitor", "LeastError"),
    "preset": (spec(monitor={"kind": "auto", "u": "x", "for": "finite_volume"}), "/monitor/for", "orthogonality"),
    "pole": (spec(monitor={"u": "1/x"}), "/monitor/u", "not finite", 1),
    "counts that contradict": (step(blocks=UNEVEN), "/domain/blocks/1/cells", "the edge b-c has 5 cells"),
    "no such vertex": (step(edges=[{"from": "a", "to": "z"}]), "/domain/edges/0/to", "is no vertex"),
    "no block": (step(blocks=[]), "/domain/blocks", "1 to"),
    "a file of points": (step(curves={"c": {"points": "c.csv"}}), "/domain/curves/c/points", "as a list"),
    "too many points": (step(refine=40), "/domain", "at most 20000"),
    "far too many points": (step(refine=1e9), "/domain/blocks", "nodes"),
    "unknown key": (step(cells=3), "/domain/cells", "known are"),
    "no vertices": (spec(domain={"kind": "blocks", "blocks": []}), "/domain/vertices", "required"),
    "no file": (spec(domain={"kind": "mesh"}), "/domain/file", "required"),
    "unknown file": (spec(domain={"kind": "mesh", "file": "s-1"}), "/domain/file", "no samples"),
    "upload": (spec(domain={"kind": "mesh", "file": "upload"}), "/domain/file", 'parts "spec" and "mesh"'),
}


@pytest.mark.parametrize("name", REFUSED)
def test_bad_blocks_are_refused_precisely(http: httpx.Client, name: str) -> None:
    expect_refusal(http, REFUSED[name])


@pytest.mark.parametrize("name", ["grid", "boundary", "schwarz.groups"])
def test_bad_settings_are_refused_after_a_check_of_the_same_monitor(http: httpx.Client, name: str) -> None:
    """A check that runs in a worker is not repeated, so what is remembered has to have the settings, too."""
    assert http.post("/v1/meshes", json=spec()).status_code in {200, 202}
    expect_refusal(http, REFUSED[name])
