"""The Schwarz iteration over HTTP: every choice of the solver, what is recorded, and what a fallback says."""

from __future__ import annotations

import itertools
from typing import Any, get_args

import httpx
import pytest

from equimesh import Acceleration, LineData, LocalSolver, Ordering, Schwarz, TransmissionCondition
from equimesh_service.assembly.problem import build_schwarz
from equimesh_service.spec.mesh import read_spec
from equimesh_service.spec.schwarz import TRANSMISSION_USES, AnyTransmission, OptimizedSpec, SchwarzSpec
from service.conftest import small

WAIT = {"Prefer": "wait=30"}
KINDS: list[dict[str, Any]] = [
    {"kind": "optimized"},
    {"kind": "optimized", "data": "local"},
    {"kind": "classical"},
    {"kind": "linear_robin", "p": 2.3},
    {"kind": "nonlinear_robin"},
]


def test_the_choices_are_the_solvers() -> None:
    for name, kind in (("ordering", Ordering), ("acceleration", Acceleration), ("local_solver", LocalSolver)):
        asked = get_args(SchwarzSpec.model_fields[name].annotation)
        assert [word for word in asked if word != "auto"] == list(kind), name
    assert list(get_args(OptimizedSpec.model_fields["data"].annotation)) == list(LineData)
    kinds = {get_args(spec.model_fields["kind"].annotation)[0] for spec in get_args(AnyTransmission)}
    assert kinds == {*TRANSMISSION_USES} == {kind.name for kind in get_args(TransmissionCondition)}


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
    assert build_schwarz(read_spec(small(schwarz=asked))) == built


def test_a_fallback_is_told(http: httpx.Client) -> None:
    spec = {
        "monitor": {"u": {"expression": "tanh(20*((x-0.5)**2 + (y-0.5)**2 - 0.09))"}},
        "grid": {"n_xi": 33, "n_eta": 33},
        "schwarz": {"transmission": {"kind": "linear_robin"}, "ordering": "alternating"},
    }
    mesh = http.post("/v1/meshes", json=spec, headers=WAIT)
    said = mesh.json()["convergence"]
    assert (said["status"], said["transmission"]) == ("converged", "optimized")
    assert "The linear_robin condition stalled; from iteration" in said["message"]
    history = http.get(mesh.json()["links"]["convergence"]).json()["iterations"]
    assert [record["transmission"] for record in (history[0], history[-1])] == ["linear_robin", "optimized"]
    assert said["work"] == sum(record["work"] for record in history) > 33 * 33
    assert said["traffic"] == sum(record["traffic"] for record in history) > 0
