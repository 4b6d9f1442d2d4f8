"""Every monitor, domain and mode of the spec over a real server, and the certificate that comes back."""

from __future__ import annotations

import io
import json
from typing import Any

import httpx
import jsonschema
import numpy as np
import pytest

from service.conftest import small
from service.spec.test_mesh import CURVED

WAIT = {"Prefer": "wait=30"}
FRONT = {"expression": "tanh(8*(x - y))"}
ARC: dict[str, Any] = {"kind": "arc_length", "u": FRONT}
CURVATURE: dict[str, Any] = {"kind": "curvature", "u": FRONT, "norm": "h1"}
WEIGHT: dict[str, Any] = {"kind": "weight", "rho": {"expression": "1 + x*x + y"}}
TENSOR: dict[str, Any] = {
    "kind": "tensor",
    "m11": {"expression": "1 + x*x"},
    "m12": {"expression": "0.1"},
    "m22": {"expression": "2"},
}
MONITORS: dict[str, dict[str, Any]] = {
    "arc_length": ARC,
    "smooth arc_length": {**ARC, "smoothing": 0.1},
    "curvature": CURVATURE,
    "isotropic curvature": {"kind": "curvature", "u": FRONT, "isotropic": True, "smoothing": 0.02},
    "weight": WEIGHT,
    "weight with u": {**WEIGHT, "u": FRONT},
    "tensor": TENSOR,
    "intersection": {
        "kind": "intersection",
        "monitors": [ARC, WEIGHT, {**TENSOR, "smoothing": 0.1}],
        "smoothing": 0.05,
    },
}
DOMAINS: dict[str, dict[str, Any]] = {
    "unit square": {"kind": "rectangle"},
    "rectangle": {"kind": "rectangle", "x": [-1, 1], "y": [0, 3]},
    "annulus_sector": {"kind": "annulus_sector", "radii": [0.5, 1.5], "angles": [-20, 100]},
    "quadrilateral": CURVED,
}


def solved(http: httpx.Client, spec: dict[str, Any], **more: Any) -> dict[str, Any]:
    answer = http.post("/v1/meshes", **({"json": spec} | more), headers=WAIT)
    assert answer.status_code in (201, 202), answer.text
    mesh: dict[str, Any] = http.get(answer.headers["Location"], params={"wait": 30}).json()
    assert mesh["status"] == "succeeded", mesh["error"]
    return mesh


def arrays(http: httpx.Client, mesh: dict[str, Any]) -> Any:
    return np.load(io.BytesIO(http.get(mesh["links"]["file"], params={"format": "npz"}).content))


@pytest.mark.parametrize("domain", DOMAINS)
@pytest.mark.parametrize("monitor", MONITORS)
def test_every_monitor_on_every_domain(http: httpx.Client, monitor: str, domain: str) -> None:
    spec = small(monitor=MONITORS[monitor], domain=DOMAINS[domain], grid={"n_xi": 13, "n_eta": 12})
    mesh = solved(http, spec)
    certificate = mesh["certificate"]
    assert certificate["status"] == mesh["convergence"]["status"]
    assert certificate["min_jacobian"] > 0
    assert certificate["mode"] == "discretization"
    has_u = "u" in MONITORS[monitor] or monitor == "intersection"
    assert (certificate["interpolation_gain"] is not None) == has_u
    assert (mesh["quality"]["interpolation_error"] is not None) == has_u
    file = arrays(http, mesh)
    x, y = file["x"], file["y"]
    (x_up, x_down), (y_up, y_down) = ((c[1:, 1:] - c[:-1, :-1], c[:-1, 1:] - c[1:, :-1]) for c in (x, y))
    assert (x_up * y_down - y_up * x_down).min() > 0  # twice the areas, of the diagonals
    if domain == "annulus_sector":
        radius, angle = np.hypot(x, y), np.degrees(np.arctan2(y, x))
        np.testing.assert_allclose(radius[0], 0.5, rtol=1e-12)
        np.testing.assert_allclose(radius[-1], 1.5, rtol=1e-12)
        np.testing.assert_allclose(angle[:, [0, -1]], np.broadcast_to([-20, 100], (13, 2)), atol=1e-9)
    elif domain == "rectangle":
        assert [(c.min(), c.max()) for c in (x, y)] == [(-1, 1), (0, 3)]
    elif domain == "quadrilateral":
        np.testing.assert_allclose(y[:, 0], 0.2 * np.sin(np.pi * x[:, 0]), atol=1e-12)
    assert http.get(mesh["links"]["file"], params={"format": "vtu"}).status_code == 200
    # the canonical spec is complete, and gives the same mesh
    canonical = http.get(mesh["links"]["spec"]).json()
    assert canonical["monitor"]["smoothing"] == MONITORS[monitor].get("smoothing", 0)
    again = solved(http, canonical)
    assert http.get(again["links"]["spec"]).json() == canonical
    np.testing.assert_array_equal(arrays(http, again)["x"], x)
    with_arrays = http.get(mesh["links"]["quality"], params={"arrays": True}).json()
    assert with_arrays["q_eq"]["max"] == pytest.approx(mesh["quality"]["q_eq"]["max"], rel=1e-12)
    assert with_arrays["interpolation_error"] == mesh["quality"]["interpolation_error"]


def test_a_weight_gathers_the_cells(http: httpx.Client) -> None:
    spec = small(monitor={"kind": "weight", "rho": {"expression": "(1 + 3*x)**2"}}, mode="tight")
    x = arrays(http, solved(http, {**spec, "grid": {"n_xi": 65, "n_eta": 5}}))["x"][:, 2]
    exact = (np.sqrt(1 + 15 * np.linspace(0, 1, 65)) - 1) / 3  # equal parts of x + 3/2 x^2
    np.testing.assert_allclose(x, exact, atol=1e-3)


def test_modes(http: httpx.Client) -> None:
    loose, tight = (solved(http, small(monitor=ARC, mode=mode)) for mode in ("discretization", "tight"))
    assert tight["certificate"]["mode"] == "tight"
    assert tight["certificate"]["equation_residual"] < 1e-8
    assert tight["certificate"]["equation_residual"] <= loose["certificate"]["equation_residual"]


# Too steep for its grid: without relaxing it, there is no valid mesh.
HARD = {
    "monitor": {"u": {"expression": "tanh(200*((x-0.5)**2 + (y-0.5)**2 - 0.09))"}, "a": 1.0, "b": 0.0},
    "grid": {"n_xi": 16, "n_eta": 16},
}


def test_a_relaxed_mesh_succeeds_and_says_so(http: httpx.Client, document: dict[str, Any]) -> None:
    mesh = solved(http, HARD)
    certificate = mesh["certificate"]
    assert certificate["status"] == mesh["convergence"]["status"] == "relaxed"
    assert certificate["relaxed"]
    assert all(part["asked"] != part["reached"] for part in certificate["relaxed"])
    assert certificate["warnings"]
    assert http.get(mesh["links"]["file"]).status_code == 200
    schema = {"$ref": "#/components/schemas/MeshResource", "components": document["components"]}
    jsonschema.Draft202012Validator(schema).validate(mesh)


def test_relaxing_can_be_forbidden(http: httpx.Client) -> None:
    answer = http.post("/v1/meshes", json={**HARD, "allow_relaxed": False}, headers=WAIT)
    mesh = answer.json()
    assert (answer.status_code, mesh["status"]) == (201, "failed")
    assert (mesh["error"]["type"], mesh["partial"]) == ("/problems/newton-failed", True)
    assert mesh["certificate"]["status"] == "newton_failed"
    assert mesh["certificate"]["relaxed"]
    assert "A relaxed mesh was found, and refused because allow_relaxed is false." in mesh["error"]["detail"]
    assert http.get(mesh["links"]["file"]).status_code == 409
    assert http.get(mesh["links"]["file"], params={"partial": True}).status_code == 200


def npz(**values: Any) -> bytes:
    buffer = io.BytesIO()
    np.savez(buffer, **values)
    return buffer.getvalue()


def test_samples_cover_the_box_of_the_domain(http: httpx.Client) -> None:
    x, y = np.linspace(-1, 1, 21), np.linspace(0, 3, 31)
    values = np.tanh(4 * (x[:, None] - y))
    lists = {"x": x.tolist(), "y": y.tolist(), "values": values.tolist()}
    domain = DOMAINS["rectangle"]
    inline = solved(http, small(monitor={"u": {"grid": lists}}, domain=domain))
    stored = http.post("/v1/samples", files={"samples": ("u.npz", npz(x=x, y=y, values=values))})
    assert stored.status_code == 201, stored.text
    named = solved(http, small(monitor={"u": {"samples": stored.json()["id"]}}, domain=domain))
    parts = {
        "spec": (None, json.dumps(small(monitor={"u": {"samples": "upload"}}, domain=domain))),
        "samples": ("u.npz", npz(x=x, y=y, values=values)),
    }
    uploaded = http.post("/v1/meshes", files=parts, headers=WAIT).json()
    etags = {http.head(mesh["links"]["file"]).headers["etag"] for mesh in (inline, named, uploaded)}
    assert len(etags) == 1
    solved(http, small(monitor={"u": {"samples": stored.json()["id"]}}, domain={"x": [-0.9, 1], "y": [0.1, 2.9]}))
    wide = {"kind": "rectangle", "x": [-1, 2]}
    refused = http.post("/v1/meshes", json=small(monitor={"u": {"samples": stored.json()["id"]}}, domain=wide))
    assert refused.status_code == 422
    assert refused.json()["errors"][0]["pointer"] == "/monitor/u/samples/x"
    assert "cover" in refused.json()["errors"][0]["message"]


def test_values_alone_lie_on_the_box_of_the_domain(http: httpx.Client) -> None:
    buffer = io.BytesIO()
    np.save(buffer, np.tanh(4 * (np.linspace(-1, 1, 21)[:, None] - np.linspace(0, 3, 31))))
    domain = DOMAINS["rectangle"]
    stored = http.post("/v1/samples?filename=u.npy", content=buffer.getvalue()).json()
    assert stored["shape"] == [21, 31]
    mesh = solved(http, small(monitor={"u": {"samples": stored["id"]}}, domain=domain))
    exact = solved(http, small(monitor={"u": {"expression": "tanh(4*(x - y))"}}, domain=domain))
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
    assert {entry["name"] for entry in able["monitors"]} == {m["kind"] for m in MONITORS.values()}
    assert {entry["name"] for entry in able["domains"]} == {d["kind"] for d in DOMAINS.values()}
    assert {entry["name"] for entry in able["modes"]} == {"discretization", "tight"}
    assert all(entry["when_to_use"].endswith(".") for key in ("monitors", "domains", "modes") for entry in able[key])
