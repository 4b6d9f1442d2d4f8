"""Previews and meshes of store=false over HTTP: they are solved at once, and nothing of them is kept."""

from __future__ import annotations

import io
import json
from typing import Any

import httpx
import numpy as np
import pytest

import equimesh as em
from equimesh_service import Settings
from service.conftest import SLOW, small
from service.requests import CURVED, FRONT, npz, post, solved
from service.storages import stored_names

NODES = {"x", "y", "u"}
CELLS = {"q_eq", "error"}
MULTIPART = {
    "samples": ("u.csv", b"x,y,u\n" + b"".join(b"%d,%d,%d\n" % (x, y, x * x + y) for x in range(9) for y in range(9)))
}


def drawn(answer: httpx.Response) -> tuple[dict[str, Any], dict[str, Any]]:
    """The arrays of a drawing without its document, and the document."""
    assert answer.status_code == 200, answer.text
    assert answer.headers["content-type"] == "application/x-npz"
    with np.load(io.BytesIO(answer.content), allow_pickle=False) as archive:
        arrays = dict(archive)
    return arrays, json.loads(arrays.pop("document").tobytes())


def preview(http: httpx.Client, spec: dict[str, Any], **query: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    return drawn(http.post("/v1/previews", json=spec, params=query))


@pytest.mark.parametrize(
    "spec", [FRONT, small(domain=CURVED), small(monitor={"u": "tanh(9*(x - y))"}, cells="triangle")]
)
def test_a_drawing_has_the_mesh_and_the_uniform_one_of_its_size(http: httpx.Client, spec: dict[str, Any]) -> None:
    arrays, document = preview(http, spec)
    solution = em.specs.build(spec).solve()
    compared, n = solution.against_uniform, solution.problem.grid.shape
    cells = (n[0] - 1, n[1] - 1)
    assert {name: values.shape for name, values in arrays.items()} == {
        prefix + name: n if name in NODES else cells for prefix in ("", "uniform_") for name in NODES | CELLS
    }
    for prefix, mesh in (("", compared.adapted), ("uniform_", compared.uniform)):
        assert arrays[f"{prefix}x"] == pytest.approx(mesh.mesh.x, abs=1e-12)
        assert arrays[f"{prefix}y"] == pytest.approx(mesh.mesh.y, abs=1e-12)
        for name in ("u", *CELLS):
            assert arrays[prefix + name].dtype == np.float32
            assert arrays[prefix + name] == pytest.approx(getattr(mesh, name), rel=1e-5, abs=1e-6)
    certificate, quality = solution.certificate.summary(), solution.quality.summary()
    assert document["certificate"].keys() == certificate.keys()
    assert document["certificate"]["interpolation_gain"] == pytest.approx(certificate["interpolation_gain"])
    assert document["quality"]["q_eq"] == pytest.approx(quality["q_eq"])
    assert (document["status"], document["error"], document["subdomains"]) == ("succeeded", None, None)


def test_a_drawing_says_what_the_resource_of_the_mesh_says(http: httpx.Client) -> None:
    spec = small(schwarz={"overlap": 3, "ordering": "alternating"}, label="looked at")
    (arrays, document), mesh = preview(http, spec), solved(http, spec)
    assert document["spec"] == http.get(mesh["links"]["spec"]).json()
    assert document["solution"]["status"] == mesh["convergence"]["status"]
    assert document["convergence"] == http.get(mesh["links"]["convergence"]).json()
    assert document["ordering"] == "alternating"
    assert document["subdomains"] == [{"xi": [0, 5], "eta": [0, 8]}, {"xi": [3, 7], "eta": [0, 8]}]
    stored, kept = drawn(http.get(f"/v1/meshes/{mesh['id']}/drawing"))
    assert all(np.array_equal(stored[name], arrays[name]) for name in arrays.keys() | stored.keys())
    assert {**kept, "seconds": None} == {**document, "seconds": None}


def test_the_drawing_of_a_chosen_monitor_is_that_of_its_preview(http: httpx.Client) -> None:
    """Q_eq is that of the monitor which was chosen."""
    spec = small(monitor={"u": "tanh(9*(x - y))"})
    (arrays, _), mesh = preview(http, spec), solved(http, spec)
    answer = http.get(f"/v1/meshes/{mesh['id']}/drawing")
    stored, _ = drawn(answer)
    assert all(np.array_equal(stored[name], arrays[name]) for name in arrays.keys() | stored.keys())
    again = http.get(f"/v1/meshes/{mesh['id']}/drawing", headers={"If-None-Match": answer.headers["etag"]})
    assert again.status_code == 304


def test_the_frames_are_the_meshes_of_the_iteration(http: httpx.Client) -> None:
    spec = small(schwarz={"transmission": {"kind": "classical"}, "overlap": 2})
    arrays, document = preview(http, spec, frames=True)
    records = document["convergence"]["iterations"]
    assert document["frames"] == [record["iteration"] for record in records] == list(range(len(records)))
    assert arrays["frames_x"].shape == arrays["frames_y"].shape == (len(records), 8, 9)
    assert np.array_equal(arrays["frames_x"][-1], arrays["x"].astype(np.float32))
    moves = [max(np.abs(np.diff(arrays[name], axis=0)[k]).max() for name in ("frames_x", "frames_y")) for k in range(3)]
    assert moves == pytest.approx([record["change"] for record in records[1:4]], abs=1e-6)
    for arrays, document in (preview(http, spec), preview(http, small(), frames=True)):
        assert document["frames"] is None
        assert "frames_x" not in arrays


def test_a_solve_that_fails_is_drawn_and_says_why(http: httpx.Client) -> None:
    schwarz = {"transmission": {"kind": "classical"}, "max_iterations": 2, "tolerance": 1e-10, "fallback": False}
    arrays, document = preview(http, small(schwarz=schwarz))
    assert (document["status"], document["error"]["type"]) == ("failed", "/problems/not-converged")
    assert "download" not in document["error"]["remedy"]
    assert arrays["x"].shape == (8, 9)
    first = document["sentences"][0]
    assert first["tone"] == "bad"
    assert document["error"]["detail"] in first["text"]


@pytest.mark.parametrize("kind", ["arc_length", "curvature"])  # checked by the service, and by the worker
def test_a_wrong_expression_is_refused_at_its_column(http: httpx.Client, kind: str) -> None:
    more = {} if kind == "arc_length" else {"smoothing": 0.1}
    answer = http.post("/v1/previews", json=small(monitor={"kind": kind, "u": "sqrt(x - 2)", **more}))
    assert answer.status_code == 422
    (entry,) = answer.json()["errors"]
    assert entry["pointer"] == "/monitor/u"
    assert entry["position"]["column"] == 1


def test_larger_meshes_have_to_be_requested(http: httpx.Client, settings: Settings) -> None:
    limit = http.get("/v1/capabilities").json()["limits"]["max_preview_points"]
    assert limit == min(settings.max_points, settings.max_preview_points) == 20_000
    for grid, pointer in (({"n_xi": 200, "n_eta": 101}, "/grid"), ({"n_xi": 10**6, "n_eta": 4}, "/grid/n_xi")):
        answer = http.post("/v1/previews", json=small(grid=grid))
        assert answer.status_code == 422
        (entry,) = answer.json()["errors"]
        assert entry["pointer"] == pointer
        assert "a preview has at most 20000" in entry["message"]
        assert "POST /v1/meshes" in entry["message"]


def test_a_target_has_a_preview(http: httpx.Client) -> None:
    spec = {"monitor": {"u": "x*x + y"}, "target": {"norm": "l2", "error": 0.01}}
    arrays, document = preview(http, spec)
    assert list(arrays["x"].shape) == document["certificate"]["target"]["grid"]
    assert any("0.01 was requested" in sentence["text"] for sentence in document["sentences"])
    too_much = http.post("/v1/previews", json={**spec, "target": {"norm": "l2", "error": 0.01, "max_points": 10**6}})
    assert too_much.json()["errors"][0]["pointer"] == "/target/max_points"


def test_a_weight_is_drawn_without_u(http: httpx.Client) -> None:
    arrays, document = preview(http, small(monitor={"kind": "weight", "rho": "1 + x"}))
    assert {*arrays} == {prefix + name for prefix in ("", "uniform_") for name in ("x", "y", "q_eq")}
    assert document["sentences"][0]["tone"] == "note"


def test_nothing_is_kept(http: httpx.Client, settings: Settings) -> None:
    """Neither meshes nor samples nor files, also of samples that the service reads in a worker."""

    def state() -> tuple[Any, set[str]]:
        newest = http.get("/v1/meshes", params={"limit": 1}).json()["items"]
        left = {path.name for path in settings.data_dir.rglob("*") if "sqlite" not in path.name}
        return newest, left | stored_names(settings)

    uploaded = {"kind": "arc_length", "u": {"samples": "upload"}}
    spec = {
        "monitor": uploaded,
        "domain": {"kind": "rectangle", "x": [0, 8], "y": [0, 8]},
        "grid": {"n_xi": 9, "n_eta": 9},
    }
    axis = np.linspace(0.0, 8.0, 9)
    values = np.add.outer(axis**2, axis)
    before = state()
    by_csv, document = drawn(http.post("/v1/previews", files=MULTIPART, data={"spec": json.dumps(spec)}))
    by_npz, _ = drawn(
        http.post(
            "/v1/previews",
            content=npz(spec=json.dumps(spec), x=axis, y=axis, values=values),
            headers={"Content-Type": "application/x-npz"},
        )
    )
    long = {"x": [0, 8], "y": [0, 8], "values": [[0, 8], [64, 72]]}
    padded = json.dumps({**spec, "monitor": {**uploaded, "u": {"grid": long}}}) + " " * 300_000
    assert http.post("/v1/previews", content=padded, headers={"Content-Type": "application/json"}).status_code == 200
    name = document["spec"]["monitor"]["u"]["samples"]
    assert http.get(f"/v1/samples/{name}").status_code == 404
    query = {**UNSTORED, "format": "vtu"}
    assert http.post("/v1/meshes", params=query, files=MULTIPART, data={"spec": json.dumps(spec)}).status_code == 200
    assert state() == before
    mesh = solved(
        http,
        {
            **spec,
            "monitor": {**uploaded, "u": {"grid": {"x": axis.tolist(), "y": axis.tolist(), "values": values.tolist()}}},
        },
    )
    points, _ = drawn(http.get(f"/v1/meshes/{mesh['id']}/drawing"))
    assert np.array_equal(points["x"], by_npz["x"])
    assert by_csv["u"] == pytest.approx(by_npz["u"], abs=0.5)  # scattered samples are interpolated in another way


def test_stored_samples_are_found_and_missing_ones_are_refused(http: httpx.Client) -> None:
    stored = http.post("/v1/samples", files=MULTIPART).json()["id"]
    spec = small(
        monitor={"kind": "arc_length", "u": {"samples": stored}}, domain={"kind": "rectangle", "x": [0, 8], "y": [0, 8]}
    )
    arrays, _ = preview(http, spec)
    assert arrays["u"].max() == pytest.approx(72.0, rel=1e-3)
    missing = http.post("/v1/previews", json=small(monitor={"kind": "arc_length", "u": {"samples": "s-0"}}))
    assert (missing.status_code, missing.json()["errors"][0]["pointer"]) == (422, "/monitor/u/samples")


def test_a_mesh_that_is_not_finished_has_no_drawing(http: httpx.Client) -> None:
    mesh = post(http, SLOW).json()
    answer = http.get(f"/v1/meshes/{mesh['id']}/drawing")
    assert answer.json()["type"] == "/problems/not-finished"
    http.delete(mesh["links"]["self"])


UNSTORED = {"store": "false"}


def unstored(http: httpx.Client, spec: dict[str, Any], **query: Any) -> httpx.Response:
    return http.post("/v1/meshes", json=spec, params={**UNSTORED, **query})


@pytest.mark.parametrize("format", ["foam", "npz", "vtu", "xdmf"])
def test_a_mesh_that_is_not_kept_has_the_file_of_one_that_is(http: httpx.Client, format: str) -> None:
    answer, mesh = unstored(http, small(), format=format), solved(http, small())
    assert answer.status_code == 200, answer.text
    assert (answer.headers["cache-control"], answer.headers.get("location")) == ("no-store", None)
    kept = http.get(f"/v1/meshes/{mesh['id']}/file", params={"format": format})
    assert answer.headers["content-type"] == kept.headers["content-type"]
    if not format.startswith(("xdmf", "npz")):  # their containers store times, and where members are aligned
        assert answer.content == kept.content
    assert json.loads(answer.headers["equimesh-certificate"]) == mesh["certificate"]


def test_without_a_format_the_answer_is_what_the_mesh_says(http: httpx.Client) -> None:
    spec = small(schwarz={"overlap": 3})
    answer, mesh = unstored(http, spec), solved(http, spec)
    said = answer.json()
    assert (answer.status_code, said["status"]) == (200, "succeeded")
    assert (said["certificate"], said["quality"]) == (mesh["certificate"], mesh["quality"])
    assert said["spec"] == http.get(mesh["links"]["spec"]).json()
    accepted = http.post("/v1/meshes", json=spec, params=UNSTORED, headers={"Accept": "model/mesh"})
    assert accepted.headers["content-type"] == "model/mesh"


def test_what_is_refused_of_a_mesh_that_is_not_kept(http: httpx.Client) -> None:
    key = http.post("/v1/meshes", json=small(), params=UNSTORED, headers={"Idempotency-Key": "a"})
    assert (key.status_code, key.json()["type"]) == (400, "/problems/malformed-header")
    assert "store=false" in key.json()["detail"]
    wrong = unstored(http, small(monitor={"u": "sin("}))
    assert (wrong.status_code, wrong.json()["errors"][0]["pointer"]) == (422, "/monitor/u")
    parts = unstored(http, small(parts=2))
    assert (parts.status_code, parts.json()["errors"][0]["pointer"]) == (422, "/parts")
    triangles = unstored(http, small(cells="triangle"), format="vts")
    assert (triangles.status_code, triangles.json()["type"]) == (406, "/problems/not-acceptable")
    head = unstored(http, small(), format="pvtu")
    assert (head.status_code, head.json()["type"]) == (406, "/problems/not-acceptable")
    many = unstored(http, small(grid={"n_xi": 200, "n_eta": 101}))
    assert "a mesh of this service has at most 20000" in many.json()["errors"][0]["message"]
    kind = http.post("/v1/meshes", content=b"x", params=UNSTORED, headers={"Content-Type": "text/html"})
    assert kind.status_code == 415
