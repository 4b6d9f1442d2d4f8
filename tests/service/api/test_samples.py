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

from equimesh_service.admission.admit import Admission
from service.conftest import SLOW, small
from service.requests import WAIT, npz, post


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


def test_scattered_samples(http: httpx.Client) -> None:
    points = np.vstack([np.random.default_rng(1).random((500, 2)), [[0, 0], [1, 0], [0, 1], [1, 1]]])
    values = np.tanh(5 * (points[:, 0] - 0.5))
    spec = small(
        monitor={"kind": "arc_length", "u": {"scattered": {"points": points.tolist(), "values": values.tolist()}}}
    )
    mesh = post(http, spec, **WAIT).json()
    assert mesh["status"] == "succeeded", mesh["error"]


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
    assert http.get(mesh["links"]["self"], params={"wait": 30}).json()["status"] == "succeeded"
    assert http.delete(url).status_code == 204
    assert http.get(url).status_code == 404
    assert http.delete(url).status_code == 404


def test_samples_that_are_read_do_not_hold_up_the_service(http: httpx.Client, monkeypatch: pytest.MonkeyPatch) -> None:
    answered, keep = threading.Event(), Admission.keep

    def late(admission: Admission, *arguments: Any) -> Any:
        assert answered.wait(60.0), "no other request was answered while samples were read"
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


UPLOADS: dict[str, tuple[str, bytes]] = {
    "empty": ("a.npz", b""),
    "not a zip": ("a.npz", b"PK\x03\x04 no"),
    "no suffix": ("samples", b"1,2,3"),
    "executable": ("a.exe", b"MZ"),
    "pickle": ("a.npy", b"\x80\x04\x95K\x01."),
    "text in csv": ("a.csv", b"x,y,u\n0,0,zero\n"),
    "nan in csv": ("a.csv", b"x,y,u\n0,0,nan\n0,1,1\n1,0,1\n1,1,1\n"),
    "not xml": ("a.vtu", b"<VTKFile"),
    "entity bomb": ("a.vtu", b'<?xml version="1.0"?><!DOCTYPE x [<!ENTITY a "aaaa">]><VTKFile>&a;</VTKFile>'),
    "broken vtk": ("a.vtk", b"# vtk DataFile Version 4.2\n"),
    "json list": ("a.json", b"[1, 2]"),
}


@pytest.mark.parametrize("name", UPLOADS)
def test_bad_uploads_are_refused(http: httpx.Client, name: str) -> None:
    filename, data = UPLOADS[name]
    answer = http.post("/v1/samples", files={"samples": (filename, data)})
    assert answer.status_code == 422, answer.text
    assert answer.json()["errors"][0]["message"]
    spec = json.dumps(small(monitor={"kind": "arc_length", "u": {"samples": "upload"}}))
    answer = http.post("/v1/meshes", files={"spec": (None, spec), "samples": (filename, data)})
    assert answer.status_code == 422, answer.text
    assert answer.json()["errors"][0]["pointer"].startswith("/monitor/u/samples")


def test_an_upload_that_the_spec_does_not_use_is_refused(http: httpx.Client) -> None:
    answer = http.post("/v1/meshes", files={"spec": (None, json.dumps(small())), "samples": ("a.csv", b"x,y,u\n")})
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["pointer"] == "/monitor/u"
