"""Sequences: meshes that follow a time-stepper over HTTP, one step after the other and never two at a time."""

from __future__ import annotations

import asyncio
import hashlib
import io
import json
import os
import threading
import time
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import httpx
import jsonschema
import numpy as np
import pytest

import equimesh as em
from equimesh_service import Settings, running
from equimesh_service.api import sequences
from equimesh_service.assembly.bodies import MAX_SHORT_BYTES
from equimesh_service.dispatch.dispatcher import Dispatcher
from equimesh_service.files.address import files_address
from equimesh_service.store.rows import Claim
from equimesh_service.store.store import Store
from equimesh_service.upkeep.retention import Retention
from service.conftest import small
from service.requests import FRONT, WAIT

NPZ = {"Content-Type": "application/x-npz", "Prefer": "wait=300"}


def front(x: Any, y: Any, moved: float = 0.0) -> Any:
    return np.tanh(20.0 * (x + y / 2 - 0.6 - moved))


def packed(**arrays: Any) -> bytes:
    body = io.BytesIO()
    np.savez(body, **arrays)
    return body.getvalue()


def unpacked(answer: httpx.Response) -> dict[str, Any]:
    assert answer.is_success, answer.text
    return dict(np.load(io.BytesIO(answer.content)))


def begin(http: httpx.Client, **more: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    """A new sequence and the arrays of its first mesh."""
    made = http.post("/v1/sequences", json={**FRONT, **more}, headers=WAIT)
    assert made.status_code == 201, made.text
    sequence: dict[str, Any] = made.json()
    assert made.headers["location"] == sequence["links"]["self"]
    return sequence, unpacked(http.get(sequence["links"]["file"]))


def test_a_mesh_follows_a_front_and_carries_fields(http: httpx.Client, document: dict[str, Any]) -> None:
    sequence, mesh = begin(http)
    components = {"$ref": "#/components/schemas/SequenceResource", "components": document["components"]}
    jsonschema.Draft202012Validator(components).validate(sequence)
    steps, places = sequence["links"]["steps"], []
    for number in range(3):
        u = front(mesh["x"], mesh["y"], 0.02 * (number + 1))
        body = packed(step=number, u=u, plane=mesh["x"] - 2 * mesh["y"])
        answer = http.post(f"{steps}?format=npz", content=body, headers=NPZ)
        mesh = unpacked(answer)
        assert (answer.status_code, answer.headers["equimesh-step"]) == (201, str(number + 1))
        assert np.abs(mesh["plane"] - (mesh["x"] - 2 * mesh["y"])).max() < 1e-5
        places.append(answer.headers["location"])
    by_formula = small(
        **{
            **FRONT,
            "monitor": {"kind": "arc_length", "scaled": False, "u": {"expression": "tanh(20*(x + y/2 - 0.66))"}},
        }
    )
    there = unpacked(http.post("/v1/meshes?format=npz", json=by_formula, headers=WAIT))
    assert np.abs(mesh["x"] - there["x"]).max() < 0.01
    assert np.abs(mesh["u"] - front(mesh["x"], mesh["y"], 0.06)).max() < 0.025
    assert http.get(places[0]).status_code == 404  # two are kept
    assert [http.get(place).json()["status"] for place in places[1:]] == ["succeeded"] * 2
    assert http.get(sequence["links"]["self"]).json()["mesh"]["links"]["self"] == places[-1]
    # A step is a mesh like any other: its spec gives it again, and its files have the fields.
    assert "plane" in http.get(f"{places[-1]}/file?format=vtu").text
    spec = http.get(f"{places[-1]}/spec").json()
    again = unpacked(http.post("/v1/meshes?format=npz", json=spec, headers=WAIT))
    assert np.abs(again["x"] - mesh["x"]).max() < 2e-3
    kept = spec["monitor"]["u"]["samples"]
    assert http.get(f"/v1/samples/{kept}").json()["kind"] == "nodal"
    assert http.delete(sequence["links"]["self"]).status_code == 204
    assert http.get(sequence["links"]["self"]).status_code == 404
    assert http.get(places[-1]).status_code == 404
    assert http.get(f"/v1/samples/{kept}").status_code == 200  # the mesh of the spec still needs them


def test_u_at_a_time_as_a_formula(http: httpx.Client) -> None:
    sequence, mesh = begin(http)
    step = {
        "step": 0,
        "u": {"expression": "tanh(20*(x + y/2 - 0.6 - t))", "t": 0.1},
        "fields": {"a": mesh["x"].tolist()},
    }
    made = http.post(sequence["links"]["steps"], json=step, headers=WAIT)
    assert (made.status_code, made.json()["step"], made.json()["mesh"]["status"]) == (201, 1, "succeeded")
    after = unpacked(http.get(made.json()["links"]["file"]))
    assert np.abs(after["a"] - after["x"]).max() < 1e-5
    assert np.abs(after["u"] - front(after["x"], after["y"], 0.1)).max() < 1e-12


def test_of_two_steps_at_once_one_is_taken(http: httpx.Client) -> None:
    sequence, mesh = begin(http)
    barrier, answers = threading.Barrier(2), []

    def ask(moved: float) -> None:
        body = packed(step=0, u=front(mesh["x"], mesh["y"], moved))
        barrier.wait()
        answers.append(http.post(sequence["links"]["steps"], content=body, headers=NPZ))

    threads = [threading.Thread(target=ask, args=(moved,)) for moved in (0.01, 0.02)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(answer.status_code for answer in answers) == [201, 409]
    refused = next(answer for answer in answers if answer.status_code == 409)
    assert refused.json()["type"] in ("/problems/conflict", "/problems/not-finished")
    late = http.post(sequence["links"]["steps"], json={"step": 0, "u": {"expression": "x"}})
    assert "at step 1, not 0" in late.json()["detail"]
    assert http.post(sequence["links"]["steps"], json={"step": 7, "u": {"expression": "x"}}).status_code == 409


def test_a_step_whose_worker_is_killed_is_the_same_step_while_another_sequence_takes_its_own(
    http: httpx.Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    give, taken, lock = Dispatcher.begin_request, list[str](), threading.Lock()

    def killed_once(self: Dispatcher, claim: Claim, function: Any, task: Any) -> Future[Any]:
        with lock:
            taken.append(task.place.sequence_id)
            dies = taken[-1] == doomed and taken.count(doomed) == 2
        return give(self, claim, os._exit, 1) if dies else give(self, claim, function, task)

    def follow(sequence: dict[str, Any], mesh: dict[str, Any], found: list[dict[str, Any]]) -> None:
        for number in range(3):
            u = front(mesh["x"], mesh["y"], 0.02 * (number + 1))
            body = packed(step=number, u=u, plane=mesh["x"] - 2 * mesh["y"])
            answer = http.post(f"{sequence['links']['steps']}?format=npz", content=body, headers=NPZ)
            mesh = unpacked(answer)
            assert answer.headers["equimesh-step"] == str(number + 1)
            found.append(mesh)

    begun = [begin(http) for _ in range(2)]
    doomed = begun[0][0]["links"]["self"].rpartition("/")[2]
    monkeypatch.setattr(Dispatcher, "begin_request", killed_once)
    meshes: list[list[dict[str, Any]]] = [[], []]
    threads = [threading.Thread(target=follow, args=(*at, found)) for at, found in zip(begun, meshes, strict=True)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert taken.count(doomed) >= 2, "one of its workers was killed"
    assert [len(found) for found in meshes] == [3, 3]
    for one, other in zip(*meshes, strict=True):
        for name in ("x", "y", "plane", "velocity"):
            np.testing.assert_array_equal(one[name], other[name])


def test_a_step_that_waits_is_checked_by_its_worker(http: httpx.Client, monkeypatch: pytest.MonkeyPatch) -> None:
    sequence, mesh = begin(http)
    x, steps = mesh["x"], sequence["links"]["steps"]

    checked, check = list[str](), sequences._check_step

    def note(service: Any, body: tuple[str, bytes], *more: Any) -> Any:
        checked.append(body[0])
        return check(service, body, *more)

    monkeypatch.setattr(sequences, "_check_step", note)
    for number, p in enumerate((x, np.dstack([x, x]))):
        answer = http.post(f"{steps}?format=npz", content=packed(step=number, u=x, p=p), headers=NPZ)
        assert (answer.status_code, answer.headers["equimesh-step"]) == (201, str(number + 1)), answer.text
    made = http.post(steps, json={"step": 2, "u": {"nodes": x.tolist()}}, headers=WAIT)
    assert made.json()["step"] == 3
    refused = http.post(steps, content=packed(step=3, u=x.T, p=x), headers=NPZ)
    assert refused.json()["errors"][0]["pointer"] == "/u/nodes"
    assert len(checked) < 4, "on a busy machine there may be no free worker, but not each time"


def test_a_repeated_step_is_the_same_step(http: httpx.Client) -> None:
    sequence, mesh = begin(http)
    headers = {**NPZ, "Idempotency-Key": f"step of {sequence['id']}"}
    body = packed(step=0, u=front(mesh["x"], mesh["y"], 0.01))
    first = http.post(f"{sequence['links']['steps']}?format=npz", content=body, headers=headers)
    second = http.post(f"{sequence['links']['steps']}?format=npz", content=body, headers=headers)
    assert (second.status_code, second.content) == (201, first.content)
    assert second.headers["location"] == first.headers["location"]
    assert second.headers["equimesh-step"] == "1"
    other = http.post(sequence["links"]["steps"], content=packed(step=1, u=mesh["x"]), headers=headers)
    assert other.json()["type"] == "/problems/idempotency-key-reused"
    key = {**WAIT, "Idempotency-Key": f"begin {sequence['id']}"}
    begun = [http.post("/v1/sequences", json=FRONT, headers=key).json()["id"] for _ in range(2)]
    assert begun[0] == begun[1]


def test_a_large_step_does_not_hold_up_the_service(http: httpx.Client, monkeypatch: pytest.MonkeyPatch) -> None:
    sequence, _ = begin(http)
    threads: list[bool] = []

    def digest(data: bytes) -> Any:
        threads.append(asyncio._get_running_loop() is None)
        return hashlib.sha256(data)

    monkeypatch.setattr(sequences, "sha256", digest)
    assert http.post(sequence["links"]["steps"], content=b"no npz", headers=NPZ).status_code == 422
    assert threads == []  # nothing is compared without a key
    keyed = {**NPZ, "Idempotency-Key": "large"}
    assert http.post(sequence["links"]["steps"], content=b"no npz", headers=keyed).status_code == 422
    assert threads == [True]


def test_what_is_wrong_with_a_step_is_told_where(http: httpx.Client) -> None:
    sequence, mesh = begin(http)
    steps, right = sequence["links"]["steps"], mesh["x"]
    bad = right.copy()
    bad[2, 3] = np.nan
    for body, pointer, words in (
        (packed(u=right), "/step", "needs an array step"),
        (packed(step=0.5, u=right), "/step", "single whole number"),
        (packed(step=0, u=right.T), "/u/nodes", "transpose"),
        (packed(step=0, u=bad), "/u/nodes", "u[2][3]"),
        (packed(step=0, u=right, xi=right), "/fields/xi", "none of"),
        (packed(step=0, u=right, p=bad), "/fields/p", "p[2][3]"),
        (b"no zip", "", "cannot be unpacked"),
    ):
        refused = http.post(steps, content=body, headers=NPZ)
        assert refused.status_code == 422, refused.text
        assert refused.json()["errors"][0]["pointer"] == pointer
        assert words in refused.json()["errors"][0]["message"]
    for step, pointer in (
        ({"u": {"expression": "x"}}, "/step"),
        ({"step": 0, "u": {"samples": "s-1"}}, "/u"),
        ({"step": 0, "u": {"nodes": [[1, None]]}}, "/u/nodes/0/1"),
        ({"step": 0, "u": {"expression": "x + z"}}, "/u/expression"),
        ({"step": 0, "u": {"expression": "x"}, "fields": {"a b": right.tolist()}}, "/fields/a b"),
        ({"step": 0, "u": {"expression": "x"}, "fields": {"file": right.tolist()}}, "/fields/file"),
    ):
        refused = http.post(steps, json=step)
        assert refused.status_code == 422, refused.text
        assert refused.json()["errors"][0]["pointer"] == pointer
    for more, pointer in (({"target": {"error": 0.1}}, "/target"), ({"grid": {"points": 99}}, "/grid/points")):
        refused = http.post("/v1/sequences", json={"monitor": {"u": "x*y"}, **more})
        assert refused.json()["errors"][0]["pointer"] == pointer
    assert http.post(steps, content=b"x", headers={"Content-Type": "text/csv"}).status_code == 415
    assert http.get(sequence["links"]["self"]).json()["step"] == 0


def test_a_step_that_fails_is_none(http: httpx.Client) -> None:
    schwarz = {"subdomains": [2, 1], "overlap": 2, "tolerance": 1e-14, "max_iterations": 1, "fallback": False,
               "transmission": {"kind": "classical"}}  # fmt: skip
    made = http.post("/v1/sequences", json={**FRONT, "schwarz": schwarz}, headers=WAIT).json()
    assert made["mesh"]["status"] == "failed"
    refused = http.post(made["links"]["steps"], json={"step": 0, "u": {"expression": "x"}})
    assert (refused.status_code, refused.json()["type"]) == (409, "/problems/not-converged")
    sequence, mesh = begin(http)
    steps = sequence["links"]["steps"]
    failed = http.post(steps, json={"step": 0, "u": {"expression": "tanh(20*x)"}})
    if http.post(f"{failed.json()['mesh']['links']['cancel']}").is_success:
        assert http.get(sequence["links"]["self"]).json()["step"] == 0
        again = http.post(steps, content=packed(step=0, u=front(mesh["x"], mesh["y"])), headers=NPZ)
        assert (again.status_code, again.json()["step"]) == (201, 1)


def test_a_sequence_outlives_the_service_and_ends_with_its_time(tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path, port=0, workers=1, log_level="warning")
    with running(settings) as url, httpx.Client(base_url=url, timeout=600.0) as http:
        sequence, mesh = begin(http)
    for number, status in ((0, 201), (1, 410)):
        with running(settings) as url, httpx.Client(base_url=url, timeout=600.0) as http:
            body = packed(step=number, u=front(mesh["x"], mesh["y"], 0.02))
            answer = http.post(sequence["links"]["steps"], content=body, headers=NPZ)
            assert answer.status_code == status, answer.text
        store = Store(settings.database, clock=lambda: time.time() + 40 * 86_400.0)
        Retention(store, files_address(settings).open(), 30.0).sweep()
        store.close()


@pytest.mark.parametrize("kind", ["least_error", pytest.param("auto", marks=pytest.mark.everything)])
def test_a_sequence_of_least_error_starts_from_the_mesh_before(http: httpx.Client, kind: str) -> None:
    spec = {"monitor": {"kind": kind, "u": "tanh(20*(x - 0.4))"}, "grid": {"n_xi": 17, "n_eta": 9}}
    sequence, _ = begin(http, **spec)
    made = http.post(sequence["links"]["steps"], json={"step": 0, "u": "tanh(20*(x - 0.45))"}, headers=WAIT)
    assert made.status_code == 201, made.text
    mesh = made.json()["mesh"]
    assert mesh["certificate"]["status"] == "completed"
    assert mesh["certificate"]["interpolation_gain"]["l2"] > 1.0
    steps = http.get(mesh["links"]["convergence"]).json()["descent"]
    assert steps[-1]["start"] == "given"
    refused = http.post(made.json()["links"]["steps"], json={"step": 1, "u": "tanh(20*(x - "})
    assert refused.json()["errors"][0]["pointer"] == "/u"


def test_a_long_step_is_that_of_a_short_one(http: httpx.Client) -> None:
    begun = [begin(http)[0], begin(http)[0]]
    x = unpacked(http.get(begun[0]["links"]["file"]))["x"]
    short = json.dumps({"step": 0, "u": {"nodes": (x * x).tolist()}, "fields": {"p": x.tolist()}})
    long = short + " " * MAX_SHORT_BYTES
    headers = {"Content-Type": "application/json", "Prefer": "wait=300"}
    moved = [
        http.post(sequence["links"]["steps"], params={"format": "npz"}, content=body, headers=headers)
        for sequence, body in zip(begun, (short, long), strict=True)
    ]
    assert moved[0].status_code == moved[1].status_code == 201, moved[1].text
    assert moved[0].content == moved[1].content
    wrong = json.dumps({"step": 1, "u": {"expression": "x"}, "fields": {"a b": x.tolist()}}) + " " * MAX_SHORT_BYTES
    refused = http.post(begun[0]["links"]["steps"], content=wrong, headers=headers)
    assert refused.json()["errors"][0]["pointer"] == "/fields/a b"


def test_a_step_says_how_good_its_mesh_is_and_how_far_its_nodes_moved(
    http: httpx.Client, document: dict[str, Any]
) -> None:
    sequence, mesh = begin(http)
    assert sequence["status"] == "succeeded"
    assert sequence["certificate"] == sequence["mesh"]["certificate"]
    assert sequence["velocity"] is None  # nothing has moved yet
    u = front(mesh["x"], mesh["y"], 0.02)
    answer = http.post(f"{sequence['links']['steps']}?format=npz", content=packed(step=0, u=u, p=u), headers=NPZ)
    moved = unpacked(answer)
    said = json.loads(moved["step_json"].tobytes())
    np.testing.assert_array_equal(moved["velocity"], np.dstack([moved["x"] - mesh["x"], moved["y"] - mesh["y"]]))
    assert np.abs(moved["velocity"]).max() > 1e-3
    assert (said["status"], said["velocity"]) == ("succeeded", "velocity")
    assert said["fields"] == {"p": {"transfer": "spline", "location": "nodes", "bounds": None}}
    shown = http.get(sequence["links"]["self"]).json()
    components = {"$ref": "#/components/schemas/SequenceResource", "components": document["components"]}
    jsonschema.Draft202012Validator(components).validate(shown)
    assert said["certificate"] == shown["certificate"] == shown["mesh"]["certificate"]
    assert said["warnings"] == shown["warnings"] == shown["certificate"]["warnings"]
    np.testing.assert_array_equal(shown["velocity"], moved["velocity"])
    file = http.get(f"{answer.headers['location']}/file", params={"format": "vtu", "cells": "triangle"})
    assert 'Name="velocity" NumberOfComponents="3"' in file.text


def test_vectors_and_a_field_called_velocity(http: httpx.Client) -> None:
    sequence, mesh = begin(http)
    vectors = np.dstack([mesh["x"], mesh["x"] - 2 * mesh["y"], mesh["y"], 1 + 0 * mesh["x"]])
    step = {"step": 0, "u": "tanh(20*(x + y/2 - 0.62))", "fields": {"velocity": {"values": vectors.tolist()}}}
    made = http.post(sequence["links"]["steps"], json=step, headers=WAIT)
    assert made.status_code == 201, made.text
    moved = unpacked(http.get(made.json()["links"]["file"]))
    x, y = moved["x"], moved["y"]
    assert np.abs(moved["velocity"] - np.dstack([x, x - 2 * y, y, 1 + 0 * x])).max() < 1e-5
    np.testing.assert_array_equal(moved["mesh_velocity"], np.dstack([x - mesh["x"], y - mesh["y"]]))
    np.testing.assert_array_equal(made.json()["velocity"], moved["mesh_velocity"])


def test_conservative_fields_keep_their_integrals_and_bounds(http: httpx.Client) -> None:
    spec = small(monitor={"kind": "arc_length", "u": "tanh(20*(x - 0.5))"}, grid={"n_xi": 17, "n_eta": 13})
    made = http.post("/v1/sequences", json=spec, headers=WAIT).json()
    mesh = unpacked(http.get(made["links"]["file"]))
    old = em.Mesh(mesh["x"], mesh["y"])
    nodal = np.where(mesh["x"] > 0.5, 1.0, 0.0)
    cells = np.dstack([nodal[1:, 1:], 2 - nodal[1:, 1:]])
    settings: dict[str, Any] = {"a": {"transfer": "conservative"}, "b": {"location": "cells", "bounds": [0, 2]}}
    body = packed(
        step=0, u=np.tanh(20 * (mesh["x"] - 0.55)), a=nodal, b=cells, settings=json.dumps({"fields": settings})
    )
    answer = http.post(f"{made['links']['steps']}?format=npz", content=body, headers=NPZ)
    moved = unpacked(answer)
    new = em.Mesh(moved["x"], moved["y"])
    assert new.distance(old) > 0.01
    assert em.integral(new, moved["a"]) == pytest.approx(em.integral(old, nodal), rel=1e-13)
    for k in range(2):
        before, after = (em.integral(m, b[:, :, k], "cells") for m, b in ((old, cells), (new, moved["b"])))
        assert after == pytest.approx(before, rel=1e-13)
    assert (moved["a"].min() >= 0.0, moved["a"].max() <= 1.0) == (True, True)
    assert (moved["b"].min() >= 0.0, moved["b"].max() <= 2.0) == (True, True)
    location = answer.headers["location"]
    assert 'Name="b" NumberOfComponents="3"' in http.get(f"{location}/file", params={"format": "vtu"}).text
    assert http.get(f"{location}/file", params={"format": "vts"}).status_code == 200


def test_a_step_changes_the_monitor(http: httpx.Client) -> None:
    sequence, mesh = begin(http)
    x, y = mesh["x"], mesh["y"]
    settings = {
        "monitor": {
            "kind": "intersection",
            "monitors": [
                {"kind": "curvature", "u": {"field": "a"}, "smoothing": 0.05},
                {"kind": "weight", "rho": {"nodes": "rho"}},
            ],
        }
    }
    body = packed(step=0, a=front(x, y, 0.02), rho=1 + x, settings=json.dumps(settings))
    moved = unpacked(http.post(f"{sequence['links']['steps']}?format=npz", content=body, headers=NPZ))
    assert "a" in moved
    assert "rho" not in moved  # a function of the monitor alone
    tensor = {"kind": "tensor", **{name: {"nodes": (1 + 0 * x).tolist()} for name in ("m11", "m22")}, "m12": "0"}
    made = http.post(sequence["links"]["steps"], json={"step": 1, "monitor": tensor}, headers=WAIT).json()
    assert made["mesh"]["status"] == "succeeded", made
    mapped = {"kind": "weight", "rho": "1 + x", "map": "gradient"}
    made = http.post(sequence["links"]["steps"], json={"step": 2, "monitor": mapped}, headers=WAIT).json()
    assert made["mesh"]["status"] == "succeeded", made
    for step, pointer, words in (
        ({"u": "x"}, "/u", "follow rho, not u"),
        ({"monitor": {"kind": "weight", "rho": {"nodes": (-x).tolist()}}}, "/monitor/rho", "must be positive"),
        ({"monitor": {"kind": "curvature"}}, "/monitor/u", "required"),
        ({"monitor": {"kind": "curvature"}, "u": "tanh(q)"}, "/u", "q"),
        ({"monitor": {"kind": "curvature", "u": {"field": "b"}}}, "/monitor/u/field", "no usable field 'b'"),
    ):
        refused = http.post(sequence["links"]["steps"], json={"step": 3, **step})
        assert refused.status_code == 422, refused.text
        assert refused.json()["errors"][0]["pointer"] == pointer
        assert words in refused.json()["errors"][0]["message"]
    kept = http.post(sequence["links"]["steps"], json={"step": 3, "monitor": {"kind": "weight"}}, headers=WAIT)
    assert kept.json()["step"] == 4, kept.text  # rho stays that of the step before


def test_sequences_are_listed_in_pages(http: httpx.Client, document: dict[str, Any]) -> None:
    begun = [begin(http)[0] for _ in range(3)]
    first = http.get("/v1/sequences", params={"limit": 2})
    components = {"$ref": "#/components/schemas/SequenceList", "components": document["components"]}
    jsonschema.Draft202012Validator(components).validate(first.json())
    assert [one["id"] for one in first.json()["items"]] == [begun[2]["id"], begun[1]["id"]]
    assert first.json()["items"][0]["mesh"] == begun[2]["mesh"]
    second = http.get(first.links["next"]["url"]).json()
    assert second["items"][0]["id"] == begun[0]["id"]
    assert http.get("/v1/sequences", params={"cursor": "none"}).status_code == 422


@pytest.mark.parametrize("form", ["json", "npz"])
def test_a_front_that_outruns_its_cells_is_refused_with_the_reason(http: httpx.Client, form: str) -> None:
    sequence, mesh = begin(http, domain={"kind": "rectangle"})
    steps, far = sequence["links"]["steps"], "tanh(20*(x + y/2 - 1.2))"
    settings = {"max_move": 0.5, "outrun": "refuse"}
    if form == "json":
        refused = http.post(f"{steps}?format=npz", json={"step": 0, "u": far, **settings}, headers=WAIT)
    else:
        body = packed(step=0, u=np.tanh(20 * (mesh["x"] + mesh["y"] / 2 - 1.2)), settings=json.dumps(settings))
        refused = http.post(f"{steps}?format=npz", content=body, headers=NPZ)
    assert (refused.status_code, refused.json()["type"]) == (422, "/problems/invalid-input")
    assert "more than max_move = 0.5: u has outrun its cells" in refused.json()["detail"]
    assert http.get(sequence["links"]["self"]).json()["step"] == 0
    near = {"step": 0, "u": "tanh(20*(x + y/2 - 0.605))", **settings}
    made = http.post(steps, json=near, headers=WAIT)
    assert made.json()["step"] == 1, made.text
    still = http.post(steps, json={"step": 1, "u": far}, headers=WAIT).json()  # the settings hold until they change
    assert "max_move = 0.5" in still["mesh"]["error"]["detail"]
    taken = http.post(steps, json={"step": 1, "u": far, "outrun": "substeps"}, headers=WAIT).json()
    assert (taken["step"], taken["status"]) == (2, "succeeded")
    for name, value in (("smoothing", 0.95), ("max_move", 0), ("outrun", "run")):
        wrong = http.post(steps, json={"step": 2, "u": far, name: value})
        assert wrong.json()["errors"][0]["pointer"] == f"/{name}"
