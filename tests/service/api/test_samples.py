"""Samples over HTTP: all ways to send them, and when they can be deleted."""

from __future__ import annotations

import io
import json
import threading
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import httpx
import numpy as np
import pytest

from equimesh_service import Settings
from equimesh_service.admission.admit import Admission
from equimesh_service.assembly.bodies import MAX_SHORT_BYTES
from service.conftest import SLOW, small
from service.requests import GRID, WAIT, npz, post, solved
from service.storages import stored_names

ONES = np.ones((5, 5))


def samples() -> dict[str, Any]:
    x = np.linspace(0, 1, 21)
    return {"x": x, "y": x, "values": np.outer(1 - np.exp(15 * (x - 1)), np.sin(np.pi * x))}


def test_samples_in_every_way_give_the_same_mesh(http: httpx.Client) -> None:
    data = npz(**samples())
    lists = {name: array.tolist() for name, array in samples().items()}
    stored = http.post("/v1/samples", files={"samples": ("u.npz", data)})
    assert stored.status_code == 201
    known = http.post("/v1/samples", content=data, headers={"Content-Type": "application/x-npz"})
    assert (known.status_code, known.json()["id"]) == (200, stored.json()["id"])
    named = http.post("/v1/samples?filename=u.json", content=json.dumps({"grid": lists}))
    assert named.json()["id"] == stored.json()["id"]
    info = http.get(stored.headers["location"]).json()
    assert (info["kind"], info["shape"]) == ("grid", [21, 21])
    file = http.get(stored.headers["location"], params={"format": "npz"})
    np.testing.assert_array_equal(np.load(io.BytesIO(file.content))["values"], samples()["values"])

    inline = post(http, small(monitor={"kind": "arc_length", "u": {"grid": lists}}), **WAIT)
    by_id = post(http, small(monitor={"kind": "arc_length", "u": {"samples": info["id"]}}), **WAIT)
    spec = json.dumps(small(monitor={"kind": "arc_length", "u": {"samples": "upload"}}))
    parts = {"spec": ("", spec, "application/json"), "samples": ("u.npz", data)}
    uploaded = http.post("/v1/meshes", files=parts, headers=WAIT)
    tags = set()
    for answer in (inline, by_id, uploaded):
        assert (answer.status_code, answer.json()["status"]) == (201, "succeeded"), answer.text
        tags.add(http.head(answer.json()["links"]["file"]).headers["etag"])
    assert len(tags) == 1
    returned = http.get(uploaded.json()["links"]["spec"]).json()
    assert returned["monitor"]["u"] == {"samples": info["id"]}


def test_a_column_of_a_table_is_chosen(http: httpx.Client) -> None:
    axis = np.linspace(0, 1, 5)
    rows = [f"{x},{y},{x * y},{x + 1}" for x in axis for y in axis]
    table = "\n".join(["Points:0,Points:1,T,p", *rows]).encode()
    headers = {"Content-Type": "text/csv"}
    asked = http.post("/v1/samples", content=table, headers=headers)
    assert asked.status_code == 422
    (error,) = asked.json()["errors"]
    assert error["columns"] == ["T", "p"]
    assert "choose u from T, p" in error["message"]
    chosen = http.post("/v1/samples?column=p", content=table, headers=headers)
    assert (chosen.status_code, chosen.json()["min"], chosen.json()["max"]) == (201, 1.0, 2.0)
    part = http.post("/v1/samples", params={"column": "T"}, files={"samples": ("flow.csv", table)})
    assert (part.status_code, part.json()["max"], part.json()["kind"]) == (201, 1.0, "grid")
    light = http.post("/v1/samples?column=p", files={"samples": ("u.npz", npz(x=axis, y=axis, p=ONES, T=0))})
    assert (light.status_code, light.json()["max"]) == (201, 1.0)
    matrix = b"1 2 3 4\n2 3 4 5\n3 4 5 6\n4 5 6 8\n"
    words = {"content": matrix, "headers": {"Content-Type": "text/plain"}}
    assert http.post("/v1/samples", **words).json()["errors"][0]["columns"] == ["3", "4", "matrix"]
    taken = http.post("/v1/samples?column=matrix", **words)
    assert (taken.status_code, taken.json()["shape"], taken.json()["max"]) == (201, [4, 4], 8.0)
    mesh = http.post("/v1/samples?kind=mesh&column=T&filename=a.msh", content=b"x")
    assert mesh.json()["errors"][0]["parameter"] == "column"


def test_samples_are_deleted_when_nobody_needs_them(http: httpx.Client) -> None:
    stored = http.post(
        "/v1/samples", content=b"x,y,u\n0,0,7\n0,1,1\n1,0,1\n1,1,2\n", headers={"Content-Type": "text/csv"}
    )
    url, here = stored.headers["location"], stored.json()["id"]
    busy = [post(http, SLOW).json() for _ in range(2)]
    mesh = post(http, small(monitor={"kind": "arc_length", "u": {"samples": here}})).json()
    assert http.delete(url).status_code == 409
    for slow in busy:
        http.delete(slow["links"]["self"])
    assert http.get(mesh["links"]["self"], params={"wait": 300}).json()["status"] == "succeeded"
    assert http.delete(url).status_code == 204
    assert http.get(url).status_code == 404
    assert http.delete(url).status_code == 404


def test_samples_that_are_read_do_not_hold_up_the_service(http: httpx.Client, monkeypatch: pytest.MonkeyPatch) -> None:
    answered, keep = threading.Event(), Admission.keep

    def late(admission: Admission, *arguments: Any) -> Any:
        assert answered.wait(300.0), "no other request was answered while samples were read"
        return keep(admission, *arguments)

    monkeypatch.setattr(Admission, "keep", late)
    rng = np.random.default_rng(2)
    points = np.vstack([rng.random((9000, 2)), [[0, 0], [1, 0], [0, 1], [1, 1]]])
    data = npz(points=points, values=np.tanh(5 * (points[:, 0] - 0.5)))
    with ThreadPoolExecutor(1) as pool:
        upload = pool.submit(http.post, "/v1/samples", files={"samples": ("u.npz", data)})
        assert http.get("/v1/meshes?limit=1").status_code == 200
        answered.set()
        assert (upload.result().status_code, upload.result().json()["shape"]) == (201, [9004])


def test_an_upload_that_the_spec_does_not_use_is_refused(http: httpx.Client) -> None:
    answer = http.post("/v1/meshes", files={"spec": (None, json.dumps(small())), "samples": ("a.csv", b"x,y,u\n")})
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["pointer"] == "/monitor/u"


def answered(http: httpx.Client, headers: dict[str, str] | None = None, **body: Any) -> dict[str, Any]:
    """The finished mesh of a request."""
    answer = http.post("/v1/meshes", **body, headers={**WAIT, **(headers or {})})
    assert (answer.status_code, answer.json()["status"]) == (201, "succeeded"), answer.text
    mesh: dict[str, Any] = answer.json()
    return mesh


def test_a_long_spec_gives_the_mesh_of_a_short_one(http: httpx.Client) -> None:
    grid = {"grid": {"x": [0, 1], "y": [0, 1], "values": [[1, 2], [3, 6.5]]}}
    monitor = {"kind": "intersection", "monitors": [{"u": grid}, {"kind": "weight", "rho": grid}]}
    short = json.dumps(small(monitor=monitor)).encode()
    long = short.replace(b" ", b" " * 10_000)
    assert len(short) < MAX_SHORT_BYTES < len(long)
    headers = {"Content-Type": "application/json"}
    meshes = [answered(http, content=body, headers=headers) for body in (short, long)]
    files = [http.get(mesh["links"]["file"], params={"format": "npz"}).content for mesh in meshes]
    assert files[0] == files[1]
    first, second = http.get(meshes[1]["links"]["spec"]).json()["monitor"]["monitors"]
    assert first["u"] == second["rho"]  # the same samples
    stored = http.get(f"/v1/samples/{first['u']['samples']}", params={"format": "npz"})
    assert np.load(io.BytesIO(stored.content))["values"].tolist() == grid["grid"]["values"]
    again = solved(http, http.get(meshes[1]["links"]["spec"]).json())
    assert http.get(again["links"]["file"], params={"format": "npz"}).content == files[0]


def test_a_long_spec_that_is_refused_leaves_no_samples(http: httpx.Client, settings: Settings) -> None:
    grid = {"grid": {**GRID["grid"], "values": [[0.25, 1.25], [2.25, 5.25]]}}
    before = stored_names(settings)
    for more in ({"schwarz": {"overlap": 1}}, {"grid": {"n_xi": 3}}, {"monitor": {"u": grid, "a": 1}}):
        spec = {"monitor": {"u": grid}, **more}
        body = json.dumps(spec).encode() + b" " * MAX_SHORT_BYTES
        answer = http.post("/v1/meshes", content=body, headers={"Content-Type": "application/json"})
        assert answer.status_code == 422, answer.text
    assert stored_names(settings) == before


def test_a_long_spec_comes_with_an_upload(http: httpx.Client) -> None:
    monitor = {"kind": "weight", "rho": "1 + x", "u": GRID}
    spec = json.dumps(small(monitor={"kind": "intersection", "monitors": [monitor, {"u": {"samples": "upload"}}]}))
    parts = {
        "spec": (None, spec + " " * MAX_SHORT_BYTES, "application/json"),
        "samples": ("u.npz", npz(**GRID["grid"])),
    }
    mesh = answered(http, files=parts)
    first, second = http.get(mesh["links"]["spec"]).json()["monitor"]["monitors"]
    assert first["u"] == second["u"]


def test_a_file_with_too_many_samples_is_refused_in_a_sentence(http: httpx.Client, settings: Settings) -> None:
    row, most = b"0.1,0.2,0.3\n", settings.max_samples
    answer = http.post("/v1/samples", files={"samples": ("u.csv", 10 * most * row)})
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["message"] == f"the file has more than {most} samples, the limit: send fewer"
