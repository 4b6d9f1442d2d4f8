"""Bad input gets a precise answer: a 422 with pointer, message and position, and never a 500."""

from __future__ import annotations

import io

import httpx
import numpy as np
import pytest

from service.conftest import small
from service.spec.bad_specs import (
    Refusal,
    expect_refusal,
    u,
)

SPECS: dict[str, Refusal] = {
    "other mode": (small(mode="fast"), "/mode", "'discretization' or 'tight'", None),
    "text for allow_relaxed": (small(allow_relaxed="no"), "/allow_relaxed", "boolean", None),
    "few points": (small(grid={"n_xi": 3, "n_eta": 8}), "/grid/n_xi", "at least 4", None),
    "negative points": (small(grid={"n_xi": -8, "n_eta": -8}), "/grid/n_xi", "at least 4", None),
    "fractional points": (small(grid={"n_xi": 8.5, "n_eta": 8}), "/grid/n_xi", "integer", None),
    "text points": (small(grid={"n_xi": "8"}), "/grid/n_xi", "integer", None),
    "many points": (small(grid={"n_xi": 200, "n_eta": 200}), "/grid", "20000", None),
    "absurd points": (small(grid={"n_xi": 10**30, "n_eta": 8}), "/grid/n_xi", "20000", None),
    "endless points": (
        '{"monitor": {"kind": "arc_length", "u": {"expression": "x"}}, "grid": {"n_xi": ' + "9" * 9999 + "}}",
        "/grid/n_xi",
        "",
        None,
    ),
    "other boundary": (small(boundary="free"), "/boundary", "trace", None),
    "other initial": (small(initial="cold"), "/initial", "nested", None),
    "other cells": (small(cells="hex"), "/cells", "triangle", None),
    "long label": (small(label="x" * 201), "/label", "200", None),
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
