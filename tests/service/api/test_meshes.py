"""Meshes over HTTP: requested, waited for, listed, canceled; checks of expressions, and the capabilities."""

from __future__ import annotations

import threading
import xml.etree.ElementTree as ET
from typing import Any

import httpx
import numpy as np
import pytest

from equimesh.io.write import FORMATS
from equimesh_service import Settings
from service.assembly.specs import DOMAINS, MONITORS
from service.conftest import PAPER, SLOW, small, until
from service.requests import WAIT, post


def test_without_a_wish_to_wait_the_mesh_is_accepted(http: httpx.Client) -> None:
    answer = post(http, small())
    assert answer.status_code == 202
    assert answer.headers["retry-after"] == "1"
    mesh = http.get(answer.headers["location"], params={"wait": 300}).json()
    assert (mesh["status"], mesh["id"]) == ("succeeded", answer.json()["id"])
    assert mesh["progress"]["fraction"] == 1.0


def test_one_round_trip(http: httpx.Client) -> None:
    answer = post(http, small(label="one"), Prefer="wait=600")
    assert answer.status_code == 201
    assert answer.headers["preference-applied"] == "wait=300"
    mesh = answer.json()
    assert (mesh["status"], mesh["label"], mesh["attempts"]) == ("succeeded", "one", 1)
    assert mesh["quality"]["q_eq"]["max"] > 1.0
    assert mesh["convergence"]["status"] == "converged"
    assert min(mesh["timings"]["total"], mesh["timings"]["solve"]) > 0  # by two clocks: not to be compared
    assert mesh["error"] is None
    assert http.get(answer.headers["location"]).json() == mesh


@pytest.mark.parametrize("asked", [{"query": "?format=vtu"}, {"Accept": FORMATS["vtu"].media_type}])
def test_the_file_itself_in_one_round_trip(http: httpx.Client, asked: dict[str, str]) -> None:
    answer = post(http, small(), **asked, **WAIT)
    assert answer.status_code == 201
    assert answer.headers["content-type"] == FORMATS["vtu"].media_type
    assert ET.fromstring(answer.content).tag == "VTKFile"
    again = http.get(answer.headers["location"] + "/file")
    assert (again.status_code, again.content) == (200, answer.content)


def test_the_list_is_paged(http: httpx.Client) -> None:
    ids = [post(http, small(label="paged")).json()["id"] for _ in range(5)]
    seen, url = [], "/v1/meshes?label=paged&limit=2"
    while url:
        page = http.get(url)
        seen += [mesh["id"] for mesh in page.json()["items"]]
        url = page.links.get("next", {}).get("url", "")
        assert bool(url) == (page.json()["next_cursor"] is not None)
    assert seen == ids[::-1]
    for mesh_id in ids:
        http.get(f"/v1/meshes/{mesh_id}?wait=300")
    assert http.get("/v1/meshes?label=paged&status=succeeded").json()["items"][0]["id"] == ids[-1]
    assert http.get("/v1/meshes?label=paged&status=failed").json()["items"] == []


def test_a_key_makes_a_request_act_once(http: httpx.Client) -> None:
    key = {"Idempotency-Key": "act-once"}
    first = http.post("/v1/meshes", json=small(label="k"), headers=key)
    again = http.post("/v1/meshes", json=small(label="k"), headers=key | WAIT)
    assert again.json()["id"] == first.json()["id"]
    assert again.status_code == 201
    other = http.post("/v1/meshes", json=small(label="other"), headers=key)
    assert (other.status_code, other.json()["type"]) == (422, "/problems/idempotency-key-reused")
    assert len(http.get("/v1/meshes?label=k").json()["items"]) == 1


def test_cancel_while_running_ends_every_wait(http: httpx.Client) -> None:
    mesh = post(http, SLOW).json()
    until(lambda: http.get(mesh["links"]["self"]).json()["progress"]["phase"])
    waiter: list[dict[str, Any]] = []
    thread = threading.Thread(target=lambda: waiter.append(http.get(mesh["links"]["self"] + "?wait=300").json()))
    thread.start()
    answer = http.post(mesh["links"]["cancel"])
    thread.join()
    assert (answer.status_code, answer.json()["status"]) == (200, "canceled")
    assert waiter[0]["status"] == "canceled"
    again = http.post(mesh["links"]["cancel"])
    assert again.status_code == 200
    assert http.get(mesh["links"]["file"]).json()["type"] == "/problems/canceled"
    assert post(http, small(), **WAIT).json()["status"] == "succeeded"


def test_cancel_while_queued_is_at_once(http: httpx.Client) -> None:
    running = [post(http, SLOW).json() for _ in range(2)]
    until(lambda: all(http.get(mesh["links"]["self"]).json()["status"] == "running" for mesh in running))
    waiting = post(http, small()).json()
    assert waiting["status"] == "queued"
    assert http.get(waiting["links"]["file"]).json()["type"] == "/problems/not-finished"
    assert http.post(waiting["links"]["cancel"]).json()["status"] == "canceled"
    for mesh in running:
        assert http.delete(mesh["links"]["self"]).status_code == 204
    assert post(http, small(), **WAIT).json()["status"] == "succeeded"


def test_what_is_finished_cannot_be_canceled(http: httpx.Client, finished: dict[str, Any]) -> None:
    answer = http.post(finished["links"]["cancel"])
    assert (answer.status_code, answer.json()["type"]) == (409, "/problems/conflict")


def test_a_tolerance_that_is_not_reached_fails_and_leaves_the_partial_mesh(http: httpx.Client) -> None:
    schwarz = {"transmission": {"kind": "classical"}, "ordering": "parallel", "overlap": 2, "max_iterations": 2}
    no_file = post(http, small(schwarz=schwarz), "?format=vtu", **WAIT)
    assert (no_file.status_code, no_file.json()["type"]) == (409, "/problems/not-converged")
    assert http.get(no_file.headers["Location"]).json()["status"] == "failed"
    answer = post(http, small(schwarz=schwarz), **WAIT)
    assert answer.status_code == 201
    mesh = answer.json()
    assert (mesh["status"], mesh["error"]["type"], mesh["partial"]) == ("failed", "/problems/not-converged", True)
    assert mesh["quality"]["q_eq"]["max"] > 1.0
    refused = http.get(mesh["links"]["file"])
    assert (refused.status_code, refused.json()["type"]) == (409, "/problems/not-converged")
    assert "partial=true" in refused.json()["remedy"]
    assert "use the optimized transmission condition" in refused.json()["remedy"]
    assert http.get(mesh["links"]["file"], params={"partial": True}).status_code == 200
    assert len(http.get(mesh["links"]["convergence"]).json()["iterations"]) == 3
    completed = post(http, small(schwarz={**schwarz, "tolerance": None}), **WAIT).json()
    assert (completed["status"], completed["convergence"]["iterations"]) == ("succeeded", 2)


@pytest.mark.parametrize(
    "query", ["limit=0", "limit=1000", "limit=x", "status=done", "cursor=zzz", f"cursor={'f' * 40}"]
)
def test_bad_queries_name_the_parameter(http: httpx.Client, query: str) -> None:
    answer = http.get(f"/v1/meshes?{query}")
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["parameter"] == query.partition("=")[0]


@pytest.mark.parametrize("key", ["", "k" * 256])
def test_bad_keys_are_refused(http: httpx.Client, key: str) -> None:
    answer = http.post("/v1/meshes", json=small(), headers={"Idempotency-Key": key})
    assert answer.status_code == 400
    assert answer.json()["type"] == "/problems/malformed-header"


@pytest.mark.parametrize(
    ("method", "path", "parameter", "near"),
    [
        ("POST", "/v1/meshes?formt=vtu", "formt", "format"),
        ("GET", "/v1/meshes?limt=3", "limt", "limit"),
        ("GET", "/v1/meshes/m-1?Wait=3", "Wait", "wait"),
        ("GET", "/v1/samples/s-1?xyz=3", "xyz", ""),
        ("POST", "/v1/expressions/check?format=3", "format", ""),
    ],
)
def test_an_unknown_parameter_is_refused(http: httpx.Client, method: str, path: str, parameter: str, near: str) -> None:
    answer = http.request(method, path, json={})
    assert answer.status_code == 422
    (error,) = answer.json()["errors"]
    assert error["parameter"] == parameter
    assert "no such parameter" in error["message"]
    assert (f"did you mean '{near}'" in error["message"]) is bool(near)


def test_who_asks_to_wait_by_a_parameter_is_told_the_header(http: httpx.Client) -> None:
    answer = http.post("/v1/meshes?wait=30", json=small())
    assert answer.status_code == 422
    assert "send the header Prefer: wait=30" in answer.json()["errors"][0]["message"]


def test_a_path_with_a_slash_too_many_is_a_problem(http: httpx.Client) -> None:
    answer = http.post("/v1/meshes/", json=small())
    assert (answer.status_code, answer.json()["type"]) == (404, "/problems/not-found")


def test_near_words_are_named(http: httpx.Client, finished: dict[str, Any]) -> None:
    answer = http.get(finished["links"]["file"], params={"format": "vtuu"})
    assert (answer.status_code, "did you mean 'vtu'?" in answer.json()["detail"]) == (406, True)
    answer = http.get("/v1/meshes", params={"status": "suceeded"})
    assert "did you mean 'succeeded'?" in answer.json()["errors"][0]["message"]


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
    assert {entry["name"] for entry in able["domains"]} == {d["kind"] for d in DOMAINS.values()} | {
        "blocks",
        "fixed_rectangle",
        "mesh",
    }
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
