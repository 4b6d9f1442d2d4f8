"""Bad input gets a precise answer: a 422 with pointer, message and position, and never a 500."""

from __future__ import annotations

import io
import json

import httpx
import numpy as np
import pytest

from equimesh_service.store.rows import NewMesh
from refusals import AIMED, OF_A_SERVICE, REFUSALS, Refusal, on_step, u
from service.requests import arrays, solved

PARTS = {**REFUSALS, "of a service": OF_A_SERVICE}


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


@pytest.mark.parametrize(("part", "name"), [(part, name) for part in PARTS for name in PARTS[part]])
def test_a_bad_spec_is_refused_precisely(http: httpx.Client, part: str, name: str) -> None:
    expect_refusal(http, PARTS[part][name])


@pytest.mark.parametrize("name", ["grid", "boundary", "schwarz.groups"])
def test_bad_settings_are_refused_after_a_check_of_the_same_monitor(http: httpx.Client, name: str) -> None:
    """A check that runs in a worker is not repeated, so what is remembered has to have the settings, too."""
    assert http.post("/v1/meshes", json=on_step()).status_code in {200, 202}
    expect_refusal(http, REFUSALS["blocks"][name])


@pytest.mark.parametrize("constant", ["1", "0*x", "3 + t"])
def test_a_constant_u_gives_the_uniform_mesh(http: httpx.Client, constant: str) -> None:
    answer = http.post("/v1/meshes?format=npz", json=u(constant), headers={"Prefer": "wait=300"})
    assert answer.status_code == 201
    arrays = np.load(io.BytesIO(answer.content))
    np.testing.assert_allclose(arrays["x"], np.linspace(0, 1, 8)[:, None] * np.ones(9), atol=1e-14)


def test_all_complaints_come_at_once(http: httpx.Client) -> None:
    answer = http.post(
        "/v1/meshes",
        json={"monitor": {"kind": "arc_length", "u": {"expression": "x"}, "a": "1"}, "cells": "hex", "n": 1},
    )
    assert [entry["pointer"] for entry in answer.json()["errors"]] == ["/monitor/a", "/cells", "/n"]


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


def test_the_shape_of_a_grid_of_so_many_points_is_found(http: httpx.Client) -> None:
    mesh = solved(http, {"monitor": {"kind": "least_error", "u": "exp(-30*x)", "norm": "h1"}, "grid": {"points": 200}})
    assert mesh["grid"]["n_xi"] > 4 * mesh["grid"]["n_eta"]
    assert mesh["points"] <= 200
    canonical = http.get(mesh["links"]["spec"]).json()
    assert (canonical["grid"], canonical["target"]) == (None, {"norm": "h1", "error": None, "max_points": 200})
    assert solved(http, canonical)["grid"] == mesh["grid"]


def test_a_target_counts_as_the_largest_grid_that_it_may_take() -> None:
    spec = {"grid": None, "target": {"norm": "l2", "error": 1e-3, "max_points": 5000}}
    assert NewMesh(id="m", spec=spec).points == 70 * 70
    assert NewMesh(id="m", spec={"grid": {"n_xi": 3, "n_eta": 5}, "target": None}).points == 15
