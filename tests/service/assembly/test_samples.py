"""Samples of a spec: on the box of the domain, alone, stored, uploaded, scattered."""

from __future__ import annotations

import io
import json

import httpx
import numpy as np

from service.assembly.specs import DOMAINS, TENSOR
from service.conftest import small
from service.requests import WAIT, arrays, npz, solved


def test_samples_cover_the_box_of_the_domain(http: httpx.Client) -> None:
    x, y = np.linspace(-1, 1, 21), np.linspace(0, 3, 31)
    values = np.tanh(4 * (x[:, None] - y))
    lists = {"x": x.tolist(), "y": y.tolist(), "values": values.tolist()}
    domain = DOMAINS["rectangle"]
    inline = solved(http, small(monitor={"kind": "arc_length", "u": {"grid": lists}}, domain=domain))
    stored = http.post("/v1/samples", files={"samples": ("u.npz", npz(x=x, y=y, values=values))})
    assert stored.status_code == 201, stored.text
    named = solved(http, small(monitor={"kind": "arc_length", "u": {"samples": stored.json()["id"]}}, domain=domain))
    parts = {
        "spec": (None, json.dumps(small(monitor={"kind": "arc_length", "u": {"samples": "upload"}}, domain=domain))),
        "samples": ("u.npz", npz(x=x, y=y, values=values)),
    }
    uploaded = http.post("/v1/meshes", files=parts, headers=WAIT).json()
    etags = {http.head(mesh["links"]["file"]).headers["etag"] for mesh in (inline, named, uploaded)}
    assert len(etags) == 1
    solved(
        http,
        small(
            monitor={"kind": "arc_length", "u": {"samples": stored.json()["id"]}},
            domain={"x": [-0.9, 1], "y": [0.1, 2.9]},
        ),
    )
    wide = {"kind": "rectangle", "x": [-1, 2]}
    refused = http.post(
        "/v1/meshes", json=small(monitor={"kind": "arc_length", "u": {"samples": stored.json()["id"]}}, domain=wide)
    )
    assert refused.status_code == 422
    assert refused.json()["errors"][0]["pointer"] == "/monitor/u/samples/x"
    assert "cover" in refused.json()["errors"][0]["message"]


def test_values_alone_lie_on_the_box_of_the_domain(http: httpx.Client) -> None:
    buffer = io.BytesIO()
    np.save(buffer, np.tanh(4 * (np.linspace(-1, 1, 21)[:, None] - np.linspace(0, 3, 31))))
    domain = DOMAINS["rectangle"]
    stored = http.post("/v1/samples?filename=u.npy", content=buffer.getvalue()).json()
    assert stored["shape"] == [21, 31]
    mesh = solved(http, small(monitor={"kind": "arc_length", "u": {"samples": stored["id"]}}, domain=domain))
    exact = solved(http, small(monitor={"kind": "arc_length", "u": {"expression": "tanh(4*(x - y))"}}, domain=domain))
    np.testing.assert_allclose(arrays(http, mesh)["x"], arrays(http, exact)["x"], atol=0.02)


def test_one_upload_and_stored_samples_in_one_monitor(http: httpx.Client) -> None:
    axis = np.linspace(0, 1, 9)
    first = http.post("/v1/samples", files={"samples": ("a.npz", npz(x=axis, y=axis, values=1 + np.outer(axis, axis)))})
    here = first.json()["id"]
    upload = {"samples": "upload"}
    monitor = {
        "kind": "intersection",
        "monitors": [
            {"kind": "tensor", "m11": upload, "m12": {"expression": "0"}, "m22": upload},
            {"kind": "weight", "rho": {"samples": here}, "u": upload},
        ],
    }
    parts = {
        "spec": (None, json.dumps(small(monitor=monitor))),
        "samples": ("b.npz", npz(x=axis, y=axis, values=2 + axis[:, None] + 0 * axis)),
    }
    answer = http.post("/v1/meshes", files=parts, headers=WAIT)
    assert answer.status_code == 201, answer.text
    mesh = answer.json()
    assert mesh["status"] == "succeeded", mesh["error"]
    members = http.get(mesh["links"]["spec"]).json()["monitor"]["monitors"]
    new = members[0]["m11"]["samples"]
    assert new.startswith("s-")
    assert new != here
    assert [members[0]["m22"], members[1]["u"], members[1]["rho"]] == [{"samples": s} for s in (new, new, here)]
    assert solved(http, http.get(mesh["links"]["spec"]).json())["status"] == "succeeded"
    for name in (here, new):
        assert http.delete(f"/v1/samples/{name}").status_code == 204
    gone = http.post("/v1/meshes", json=http.get(mesh["links"]["spec"]).json())
    assert (gone.status_code, gone.json()["errors"][0]["pointer"]) == (422, "/monitor/monitors/0/m11/samples")


def test_scattered_samples_of_a_tensor(http: httpx.Client) -> None:
    rng = np.random.default_rng(3)
    points = np.vstack([rng.random((300, 2)), [[0, 0], [1, 0], [0, 1], [1, 1]]])
    scattered = {"scattered": {"points": points.tolist(), "values": (1 + points[:, 0]).tolist()}}
    solved(http, small(monitor={**TENSOR, "m22": scattered}))
    negative = {"scattered": {"points": points.tolist(), "values": (-1 - points[:, 0]).tolist()}}
    refused = http.post("/v1/meshes", json=small(monitor={**TENSOR, "m22": negative}))
    assert (refused.status_code, refused.json()["errors"][0]["pointer"]) == (422, "/monitor/m22")
