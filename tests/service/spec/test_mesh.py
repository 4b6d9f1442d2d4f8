"""Bad input gets a precise answer: a 422 with pointer, message and position, and never a 500."""

from __future__ import annotations

import io

import httpx
import numpy as np
import pytest

from equimesh_service.store.rows import NewMesh
from service.conftest import small
from service.requests import arrays, solved
from service.spec.bad_specs import (
    Refusal,
    expect_refusal,
    u,
)

SPECS: dict[str, Refusal] = {
    "other mode": (small(mode="fast"), "/mode", "'discretization' or 'tight'"),
    "text for allow_relaxed": (small(allow_relaxed="no"), "/allow_relaxed", "true or false"),
    "few points": (small(grid={"n_xi": 3, "n_eta": 8}), "/grid/n_xi", "at least 4"),
    "negative points": (small(grid={"n_xi": -8, "n_eta": -8}), "/grid/n_xi", "at least 4"),
    "fractional points": (small(grid={"n_xi": 8.5, "n_eta": 8}), "/grid/n_xi", "whole number"),
    "text points": (small(grid={"n_xi": "8"}), "/grid/n_xi", "whole number"),
    "many points": (small(grid={"n_xi": 200, "n_eta": 200}), "/grid", "20000"),
    "absurd points": (small(grid={"n_xi": 10**30, "n_eta": 8}), "/grid/n_xi", "20000"),
    "endless points": (
        '{"monitor": {"kind": "arc_length", "u": {"expression": "x"}}, "grid": {"n_xi": ' + "9" * 9999 + "}}",
        "/grid/n_xi",
        "",
    ),
    "other boundary": (small(boundary="free"), "/boundary", "trace"),
    "other initial": (small(initial="cold"), "/initial", "nested"),
    "other cells": (small(cells="hex"), "/cells", "triangle"),
    "long label": (small(label="x" * 201), "/label", "200"),
}


@pytest.mark.parametrize("name", SPECS)
def test_bad_spec_is_refused_precisely(http: httpx.Client, name: str) -> None:
    expect_refusal(http, SPECS[name])


@pytest.mark.parametrize("constant", ["1", "0*x", "3 + t"])
def test_a_constant_u_gives_the_uniform_mesh(http: httpx.Client, constant: str) -> None:
    answer = http.post("/v1/meshes?format=npz", json=u(constant), headers={"Prefer": "wait=30"})
    assert answer.status_code == 201
    arrays = np.load(io.BytesIO(answer.content))
    np.testing.assert_allclose(arrays["x"], np.linspace(0, 1, 8)[:, None] * np.ones(9), atol=1e-14)


def test_all_complaints_come_at_once(http: httpx.Client) -> None:
    answer = http.post(
        "/v1/meshes",
        json={"monitor": {"kind": "arc_length", "u": {"expression": "x"}, "a": "1"}, "cells": "hex", "n": 1},
    )
    assert [entry["pointer"] for entry in answer.json()["errors"]] == ["/monitor/a", "/cells", "/n"]


AIMED = {"monitor": {"u": "tanh(9*(x - y))"}}
TARGETS: dict[str, Refusal] = {
    "both": (
        {**AIMED, "grid": {"n_xi": 9, "n_eta": 9}, "target": {"error": 1}},
        "/target",
        "takes the place of the grid",
    ),
    "no error": ({**AIMED, "target": {}}, "/target/error", "required"),
    "error of zero": ({**AIMED, "target": {"error": 0}}, "/target/error", "positive"),
    "other norm": ({**AIMED, "target": {"error": 1, "norm": "max"}}, "/target/norm", "'l2' or 'h1'"),
    "few points": ({**AIMED, "target": {"error": 1, "max_points": 9}}, "/target/max_points", "at least 25"),
    "many points": ({**AIMED, "target": {"error": 1, "max_points": 10**9}}, "/target/max_points", "at most"),
    "no function": ({"monitor": {"kind": "weight", "rho": "1"}, "target": {"error": 1}}, "/target", "has no u"),
    "subdomains": ({**AIMED, "schwarz": {}, "target": {"error": 1}}, "/target", "a grid that is known"),
    "out of reach": (
        {**AIMED, "target": {"error": 1e-9, "max_points": 900}},
        "/target/error",
        "the largest allowed grid, 30 x 30, would give about",
    ),
}


@pytest.mark.parametrize("name", TARGETS)
def test_a_target_that_cannot_be_reached_or_used_is_refused(http: httpx.Client, name: str) -> None:
    expect_refusal(http, TARGETS[name])


def test_a_target_takes_the_grid_that_it_needs(http: httpx.Client) -> None:
    spec = {**AIMED, "target": {"norm": "l2", "error": 2e-3, "max_points": 5000}}
    mesh = solved(http, spec)
    told = mesh["certificate"]["target"]
    assert told["error"] == 2e-3
    assert told["reached"] <= 2e-3
    assert [mesh["grid"]["n_xi"], mesh["grid"]["n_eta"]] == told["grid"]
    assert list(arrays(http, mesh)["x"].shape) == told["grid"]
    error = mesh["quality"]["interpolation_error"]["l2"]
    assert error == told["reached"]
    canonical = http.get(mesh["links"]["spec"]).json()
    assert canonical["target"] == spec["target"]
    assert canonical["grid"] is None
    again = solved(http, canonical)
    assert again["grid"] == mesh["grid"]
    assert again["certificate"]["target"] == told
    cells = http.get(mesh["links"]["quality"], params={"arrays": True}).json()["q_eq"]["cells"]
    assert [len(cells) + 1, len(cells[0]) + 1] == told["grid"]


def test_a_target_counts_as_the_largest_grid_that_it_may_take() -> None:
    spec = {"grid": None, "target": {"norm": "l2", "error": 1e-3, "max_points": 5000}}
    assert NewMesh(id="m", spec=spec).points == 70 * 70
    assert NewMesh(id="m", spec={"grid": {"n_xi": 3, "n_eta": 5}, "target": None}).points == 15
