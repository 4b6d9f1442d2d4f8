"""Checks of expressions, and the capabilities of a service."""

from __future__ import annotations

from typing import Any

import httpx
import numpy as np
import pytest

from equimesh_service import Settings
from service.assembly.specs import DOMAINS, MONITORS
from service.conftest import PAPER


def test_capabilities_name_every_choice(http: httpx.Client, document: dict[str, Any], settings: Settings) -> None:
    able = http.get("/v1/capabilities").json()
    spectral = {"hohqmesh", "re2", "nmsh", "specfem"}
    names = {*spectral, "vtu", "vtk", "vts", "vtm", "hdf", "p3d", "xdmf", "msh"}
    names |= {"medit", "su2", "abaqus", "foam", "npz"}
    assert {form["name"] for form in able["formats"]} == names
    assert {form["name"] for form in able["formats"] if form["cells"] == ["quad"]} == {"vts", "vtm", "p3d", *spectral}
    properties = document["components"]["schemas"]["MeshSpec"]["properties"]
    assert able["boundaries"] == properties["boundary"]["enum"]
    assert able["initials"] == properties["initial"]["enum"]
    assert able["cells"] == properties["cells"]["enum"]
    schwarz = document["components"]["schemas"]["Schwarz"]["properties"]
    data = document["components"]["schemas"]["Optimized"]["properties"]["data"]
    for key, choices in (
        ("interface_data", data["enum"]),
        ("orderings", schwarz["ordering"]["enum"]),
        ("accelerations", schwarz["acceleration"]["enum"]),
        ("local_solvers", schwarz["local_solver"]["enum"]),
    ):
        assert [entry["name"] for entry in able[key]] == choices
        assert all(entry["when_to_use"].endswith(".") for entry in able[key])
    assert able["limits"]["max_points"] == settings.max_points
    assert "tanh" in able["expressions"]["functions"]
    assert able["engine"] == {"kind": "processes", "workers": 2, "ready": True}


def test_a_check_knows_domains(http: httpx.Client) -> None:
    ring = {"kind": "annulus_sector", "radii": [1, 2], "angles": [0, 90]}
    found = http.post("/v1/expressions/check", json={"expression": "log(x*x + y*y)", "domain": ring})
    assert found.status_code == 200, found.text
    report = found.json()
    assert report["u"]["max"] == pytest.approx(np.log(4))
    np.testing.assert_allclose(report["domain"]["box"], [[0, 2], [0, 2]], atol=1e-12)
    assert report["domain"]["area"] == pytest.approx(0.75 * np.pi)
    assert http.post("/v1/expressions/check", json={"expression": "log(x*x + y*y)"}).status_code == 422
    bad = http.post("/v1/expressions/check", json={"expression": "x", "domain": {**ring, "radii": [2, 1]}})
    assert (bad.status_code, bad.json()["errors"][0]["pointer"]) == (422, "/domain/radii")


def test_capabilities_say_what_to_use_when(http: httpx.Client) -> None:
    able = http.get("/v1/capabilities").json()
    assert {entry["name"] for entry in able["monitors"]} == {m["kind"] for m in MONITORS.values()} | {"nodal_solution"}
    assert {entry["name"] for entry in able["domains"]} == {d["kind"] for d in DOMAINS.values()} | {"blocks", "mesh"}
    assert {entry["name"] for entry in able["modes"]} == {"discretization", "tight"}
    assert all(entry["when_to_use"].endswith(".") for key in ("monitors", "domains", "modes") for entry in able[key])


def test_expression_check_tells_the_column(http: httpx.Client) -> None:
    good = http.post("/v1/expressions/check", json={"expression": PAPER})
    assert good.status_code == 200
    report = good.json()
    assert (report["names"], report["constant"]) == (["x", "y"], False)
    assert report["understood"] == PAPER
    assert report["u"]["max"] == pytest.approx(1.0, abs=0.01)
    assert report["gradient"]["max"] == pytest.approx(15.0, abs=0.01)
    typed = http.post("/v1/expressions/check", json={"expression": "2x − |y|^2"})
    assert typed.json()["understood"] == "2*x - abs(y)**2"
    bad = http.post("/v1/expressions/check", json={"expression": "x + foo"})
    assert bad.status_code == 422
    (error,) = bad.json()["errors"]
    assert "foo" in error.pop("message")
    assert error == {"pointer": "/expression", "position": {"offset": 4, "line": 1, "column": 5}}
    assert http.post("/v1/expressions/check", content=b"x").status_code == 415
    assert http.post("/v1/expressions/check", json={"expression": 1}).status_code == 422
