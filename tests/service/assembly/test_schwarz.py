"""The Schwarz iteration of a spec: every choice reaches the solver."""

from __future__ import annotations

import itertools
from typing import Any

import httpx
import pytest

from equimesh import Acceleration, LocalSolver, Ordering, Schwarz
from equimesh.specs import build_schwarz
from equimesh_service.spec.mesh import read_spec
from service.conftest import small

KINDS: list[dict[str, Any]] = [
    {"kind": "optimized"},
    {"kind": "optimized", "data": "local"},
    {"kind": "classical"},
    {"kind": "linear_robin", "p": 2.3},
    {"kind": "nonlinear_robin"},
]


def test_every_condition_goes_with_every_ordering(http: httpx.Client) -> None:
    asked = [
        small(schwarz={"transmission": kind, "ordering": ordering, "tolerance": None, "max_iterations": 2})
        for kind, ordering in itertools.product(KINDS, Ordering)
    ]
    posted = [http.post("/v1/meshes", json=spec).json() for spec in asked]
    for spec, mesh in zip(asked, posted, strict=True):
        done = http.get(mesh["links"]["self"], params={"wait": 30}).json()
        assert done["status"] == "succeeded", (spec, done["error"])
        assert done["convergence"]["transmission"].startswith(spec["schwarz"]["transmission"]["kind"])


@pytest.mark.parametrize(
    ("asked", "built"),
    [
        ({}, Schwarz()),
        (
            {
                "line_correction": 2,
                "acceleration": "anderson",
                "local_solver": "newton",
                "fallback": False,
                "tolerance": "discretization",
            },
            Schwarz(
                line_correction=2,
                acceleration=Acceleration.ANDERSON,
                local_solver=LocalSolver.NEWTON,
                fallback=False,
                tolerance="discretization",
            ),
        ),
    ],
)
def test_the_solver_is_given_what_was_asked(asked: dict[str, Any], built: Schwarz) -> None:
    assert build_schwarz(read_spec(small(schwarz=asked)).canonical) == built
