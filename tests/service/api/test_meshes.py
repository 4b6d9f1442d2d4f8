"""The HTTP interface, over a real server: meshes, files, samples, events, caching."""

from __future__ import annotations

import hashlib
import io
import json
import threading
import time
import xml.etree.ElementTree as ET
import zipfile
from typing import Any

import httpx
import numpy as np
import pytest

from equimesh.io.write import FORMATS
from equimesh_service.admission import admit
from service.conftest import SLOW, small, until

WAIT = {"Prefer": "wait=30"}


def post(http: httpx.Client, spec: dict[str, Any], query: str = "", **headers: str) -> httpx.Response:
    return http.post(f"/v1/meshes{query}", json=spec, headers=headers)


def test_without_a_wish_to_wait_the_mesh_is_accepted(http: httpx.Client) -> None:
    answer = post(http, small())
    assert answer.status_code == 202
    assert answer.headers["retry-after"] == "1"
    mesh = http.get(answer.headers["location"], params={"wait": 30}).json()
    assert (mesh["status"], mesh["id"]) == ("succeeded", answer.json()["id"])
    assert mesh["progress"]["fraction"] == 1.0


def test_one_round_trip(http: httpx.Client) -> None:
    answer = post(http, small(label="one"), Prefer="wait=600")
    assert answer.status_code == 201
    assert answer.headers["preference-applied"] == "wait=30"
    mesh = answer.json()
    assert (mesh["status"], mesh["label"], mesh["attempts"]) == ("succeeded", "one", 1)
    assert mesh["quality"]["q_eq"]["max"] > 1.0
    assert mesh["convergence"]["status"] == "converged"
    assert mesh["timings"]["total"] >= mesh["timings"]["solve"] > 0
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


def test_json_before_a_mesh_format_gives_json(http: httpx.Client) -> None:
    accept = f"application/json, {FORMATS['vtu'].media_type};q=0.5, */*;q=0.1"
    assert post(http, small(), Accept=accept, **WAIT).headers["content-type"] == "application/json"


@pytest.mark.parametrize("format", FORMATS)
@pytest.mark.parametrize("cells", ["quad", "triangle"])
def test_every_format(http: httpx.Client, finished: dict[str, Any], format: str, cells: str) -> None:
    answer = http.get(finished["links"]["file"], params={"format": format, "cells": cells})
    assert answer.status_code == 200
    form = FORMATS[format]
    assert answer.headers["content-type"] == form.media_type
    assert answer.headers["content-disposition"] == f'attachment; filename="equimesh-{finished["id"]}{form.suffix}"'
    by_accept = http.get(finished["links"]["file"], params={"cells": cells}, headers={"Accept": form.media_type})
    assert by_accept.content == answer.content
    if format == "npz":
        corners = np.load(io.BytesIO(answer.content))["cells"].shape[1]
        assert corners == {"quad": 4, "triangle": 3}[cells]
    elif format == "xdmf":
        names = zipfile.ZipFile(io.BytesIO(answer.content)).namelist()
        assert {"mesh.xdmf", "mesh.h5", "facets.xdmf", "facets.h5"} <= set(names)
    elif format in ("msh", "su2"):
        assert b"left" in answer.content


def test_files_can_be_cached_and_resumed(http: httpx.Client, finished: dict[str, Any]) -> None:
    url = finished["links"]["file"]
    whole = http.get(url)
    etag = whole.headers["etag"]
    assert etag == f'"{hashlib.sha256(whole.content).hexdigest()}"'
    assert whole.headers["vary"] == "Accept"
    for named in (etag, f'"other", W/{etag}', "*"):
        same = http.get(url, headers={"If-None-Match": named})
        assert (same.status_code, same.content, same.headers["etag"]) == (304, b"", etag)
    assert http.get(url, headers={"If-None-Match": '"other"'}).status_code == 200
    head = http.head(url)
    assert (head.status_code, head.content) == (200, b"")
    assert int(head.headers["content-length"]) == len(whole.content)
    part = http.get(url, headers={"Range": "bytes=10-19", "If-Range": etag})
    assert (part.status_code, part.content) == (206, whole.content[10:20])
    changed = http.get(url, headers={"Range": "bytes=10-19", "If-Range": '"other"'})
    assert (changed.status_code, changed.content) == (200, whole.content)


@pytest.mark.parametrize("header", ["bytes=5-2", "bytes=abc", "bytes=", "items=0-1", "bytes=--5", "bytes=1-,x"])
def test_a_range_that_is_none_is_ignored(http: httpx.Client, finished: dict[str, Any], header: str) -> None:
    url = finished["links"]["file"]
    answer = http.get(url, headers={"Range": header})
    assert (answer.status_code, answer.content) == (200, http.get(url).content)


@pytest.mark.parametrize("header", ["bytes=99999999-", "bytes=-0", f"bytes={'9' * 6000}-", "bytes=99999998-,-0"])
def test_a_range_past_the_end_is_a_problem(http: httpx.Client, finished: dict[str, Any], header: str) -> None:
    url = finished["links"]["file"]
    answer = http.get(url, headers={"Range": header})
    size = len(http.get(url).content)
    assert (answer.status_code, answer.headers["content-range"]) == (416, f"bytes */{size}")
    assert answer.headers["content-type"] == "application/problem+json"
    assert (answer.json()["type"], answer.json()["detail"]) == (
        "/problems/range-not-satisfiable",
        f"The file has {size} bytes.",
    )
    assert http.get(url, headers={"Range": f"{header},0-1"}).content == http.get(url).content[:2]


def test_formats_that_are_not_there(http: httpx.Client, finished: dict[str, Any]) -> None:
    url = finished["links"]["file"]
    for answer in (
        http.get(url, params={"format": "stl"}),
        http.get(url, headers={"Accept": "image/gif"}),
        http.get(url, headers={"Accept": "application/vnd.vtk.vtu+xml;q=0"}),
        post(http, small(), "?format=stl"),
        http.get(finished["links"]["plot"], headers={"Accept": "image/gif"}),
        http.get(finished["links"]["convergence"], headers={"Accept": "image/gif"}),
        http.get(finished["links"]["events"], headers={"Accept": "image/gif"}),
    ):
        assert answer.status_code == 406
        assert answer.headers["content-type"] == "application/problem+json"


def test_quality_and_its_arrays(http: httpx.Client, finished: dict[str, Any]) -> None:
    quality = http.get(finished["links"]["quality"]).json()
    assert quality == finished["quality"]
    arrays = http.get(finished["links"]["quality"], params={"arrays": True}).json()
    cells = np.array(arrays["q_eq"]["cells"])
    assert cells.shape == (7, 8)
    assert cells.max() == pytest.approx(quality["q_eq"]["max"], rel=1e-14)


def test_convergence_as_json_and_csv(http: httpx.Client, finished: dict[str, Any]) -> None:
    url = finished["links"]["convergence"]
    convergence = http.get(url).json()
    assert convergence["iterations"][0]["iteration"] == 0
    assert convergence["iterations"][-1]["iteration"] == finished["convergence"]["iterations"]
    rows = http.get(url, headers={"Accept": "text/csv"}).text.splitlines()
    columns = rows[0].split(",")
    first = convergence["iterations"][0]
    assert set(columns) == {*first, *first["subdomains"][0]} - {"subdomains"}
    assert len(rows) == 1 + 2 * len(convergence["iterations"])


@pytest.mark.parametrize("kind", ["mesh", "convergence", "quality"])
def test_pictures(http: httpx.Client, finished: dict[str, Any], kind: str) -> None:
    svg = http.get(finished["links"]["plot"], params={"kind": kind})
    assert svg.headers["content-type"].startswith("image/svg+xml")
    assert ET.fromstring(svg.content).tag.endswith("svg")
    assert (b"mismatch of the subdomains" in svg.content) == (kind == "convergence")
    png = http.get(finished["links"]["plot"], params={"kind": kind}, headers={"Accept": "image/png"})
    assert (png.status_code, png.content[:4]) == (200, b"\x89PNG")


def test_the_spec_comes_back_complete_and_gives_the_same_mesh(http: httpx.Client, finished: dict[str, Any]) -> None:
    spec = http.get(finished["links"]["spec"]).json()
    assert spec["schwarz"]["transmission"] == {"kind": "optimized", "data": "line_sums"}
    assert (spec["boundary"], spec["initial"], spec["label"]) == ("trace", "nested", "finished")
    again = post(http, spec, **WAIT).json()
    assert again["id"] != finished["id"]
    first, second = (http.get(mesh["links"]["file"], params={"format": "npz"}) for mesh in (finished, again))
    assert first.headers["etag"] == second.headers["etag"]


def test_the_same_file_of_two_meshes_survives_the_first(http: httpx.Client) -> None:
    first, second = (post(http, small(grid={"n_xi": 7, "n_eta": 7}), **WAIT).json() for _ in range(2))
    assert http.delete(first["links"]["self"]).status_code == 204
    assert http.get(first["links"]["self"]).status_code == 404
    assert http.get(first["links"]["file"]).status_code == 404
    assert http.get(second["links"]["file"], params={"format": "npz"}).status_code == 200


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
        http.get(f"/v1/meshes/{mesh_id}?wait=30")
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


def test_a_retry_may_meet_a_newer_release(monkeypatch: pytest.MonkeyPatch) -> None:
    admitted = admit.Admitted({"label": None, "cells": "quad"}, {}, "digest")
    request, points = admitted.fingerprint("vtu"), admitted.points_fingerprint
    monkeypatch.setattr(admit, "_VERSION", "next")
    assert admitted.fingerprint("vtu") == request
    assert admitted.points_fingerprint != points  # its points may be other ones


def test_events_stream_to_the_end(http: httpx.Client) -> None:
    settings = {**SLOW["schwarz"], "max_iterations": 30}  # some tenths of a second
    mesh = post(http, {**SLOW, "grid": {"n_xi": 20, "n_eta": 20}, "schwarz": settings}).json()
    with http.stream("GET", mesh["links"]["events"]) as stream:
        assert stream.headers["content-type"].startswith("text/event-stream")
        blocks = "".join(stream.iter_text()).strip().split("\n\n")
    events = [dict(line.split(": ", 1) for line in block.splitlines()) for block in blocks[1:]]
    assert blocks[0].startswith("retry:")
    assert [int(event["id"]) for event in events] == list(range(1, len(events) + 1))
    kinds = [event["event"] for event in events]
    assert kinds[0] == "status"
    assert "progress" in kinds
    assert kinds[-1] == "done"
    fractions = [json.loads(event["data"])["fraction"] for event in events if event["event"] == "progress"]
    assert fractions == sorted(fractions)
    assert json.loads(events[-1]["data"]) == {"status": "succeeded"}
    with http.stream("GET", mesh["links"]["events"], headers={"Last-Event-ID": "2"}) as stream:
        assert "id: 3\n" in (rest := "".join(stream.iter_text()))
        assert "id: 2\n" not in rest
    rows = http.get(mesh["links"]["events"], params={"after": 2}, headers={"Accept": "application/json"}).json()
    assert [row["id"] for row in rows["items"]] == list(range(3, len(events) + 1))
    assert rows["done"]
    over = http.get(mesh["links"]["events"], headers={"Last-Event-ID": str(len(events))})
    assert over.status_code == 204


def test_events_come_while_the_mesh_is_computed(http: httpx.Client) -> None:
    mesh = post(http, SLOW).json()
    try:
        with http.stream("GET", mesh["links"]["events"]) as stream:
            lines = stream.iter_lines()
            assert any(line == "event: progress" for line in lines)
            assert http.get(mesh["links"]["self"]).json()["status"] == "running"
            http.post(mesh["links"]["cancel"])
            assert list(lines)[-4:][0] == "event: done"
    finally:
        http.delete(mesh["links"]["self"])


def test_cancel_while_running_takes_less_than_a_second(http: httpx.Client) -> None:
    mesh = post(http, SLOW).json()
    until(lambda: http.get(mesh["links"]["self"]).json()["progress"]["fraction"] > 0)
    waiter: list[dict[str, Any]] = []
    thread = threading.Thread(target=lambda: waiter.append(http.get(mesh["links"]["self"] + "?wait=30").json()))
    thread.start()
    began = time.monotonic()
    answer = http.post(mesh["links"]["cancel"])
    thread.join()
    assert time.monotonic() - began < 1.0
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


def test_the_errors_of_the_paper_come_when_asked_for(http: httpx.Client) -> None:
    spec = small(schwarz={"overlap": 2, "compare_single_domain": True})
    mesh = post(http, spec, **WAIT).json()
    last = http.get(mesh["links"]["convergence"]).json()["iterations"][-1]
    assert last["error"] < 1e-9
    assert last["subdomains"][0]["error_x"] < 1e-9


def npz(**arrays: Any) -> bytes:
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


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

    inline = post(http, small(monitor={"u": {"grid": lists}}), **WAIT)
    by_id = post(http, small(monitor={"u": {"samples": info["id"]}}), **WAIT)
    spec = json.dumps(small(monitor={"u": {"samples": "upload"}}))
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
    spec = small(monitor={"u": {"scattered": {"points": points.tolist(), "values": values.tolist()}}})
    mesh = post(http, spec, **WAIT).json()
    assert mesh["status"] == "succeeded", mesh["error"]


def test_samples_are_deleted_when_nobody_needs_them(http: httpx.Client) -> None:
    stored = http.post(
        "/v1/samples", content=b"x,y,u\n0,0,7\n0,1,1\n1,0,1\n1,1,2\n", headers={"Content-Type": "text/csv"}
    )
    url, here = stored.headers["location"], stored.json()["id"]
    busy = [post(http, SLOW).json() for _ in range(2)]
    mesh = post(http, small(monitor={"u": {"samples": here}})).json()
    assert http.delete(url).status_code == 409
    for slow in busy:
        http.delete(slow["links"]["self"])
    assert http.get(mesh["links"]["self"], params={"wait": 30}).json()["status"] == "succeeded"
    assert http.delete(url).status_code == 204
    assert http.get(url).status_code == 404
    assert http.delete(url).status_code == 404


@pytest.mark.parametrize("path", ["", "/events", "/file", "/quality", "/convergence", "/plot", "/spec"])
def test_a_mesh_that_is_not_there(http: httpx.Client, path: str) -> None:
    for name in ("m-nothing", "%00", "%ff%fe", "a" * 500):
        answer = http.get(f"/v1/meshes/{name}{path}")
        assert (answer.status_code, answer.json()["type"]) == (404, "/problems/not-found")


def test_paths_and_methods_that_are_not_there(http: httpx.Client) -> None:
    for path in ("/v2/meshes", "/v1", "/docs/assets/other.js", "/problems/none", "/%2e%2e/etc/passwd"):
        answer = http.get(path)
        assert answer.status_code == 404
        assert answer.headers["content-type"] == "application/problem+json"
    refused = http.put("/v1/meshes", json={})
    assert (refused.status_code, refused.json()["type"]) == (405, "/problems/method-not-allowed")
    assert refused.headers["allow"] == "GET, POST"


def test_small_answers_are_sent_at_once(http: httpx.Client, finished: dict[str, Any]) -> None:
    times = []
    for _ in range(20):
        began = time.perf_counter()
        http.get(finished["links"]["self"])
        times.append(time.perf_counter() - began)
    assert min(times) < 0.03, "Nagle's algorithm holds answers back for 40 ms"


def test_the_same_expression_under_load(url: str) -> None:
    answers: list[httpx.Response] = []

    def ask() -> None:
        with httpx.Client(base_url=url, timeout=60.0) as client:
            answers.append(client.post("/v1/meshes?format=npz", json=small(), headers=WAIT))

    threads = [threading.Thread(target=ask) for _ in range(12)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert {answer.status_code for answer in answers} == {201}
    assert len({answer.headers["etag"] for answer in answers}) == 1


def test_many_scattered_samples_do_not_hold_up_the_service(http: httpx.Client) -> None:
    rng = np.random.default_rng(2)
    points = np.vstack([rng.random((9000, 2)), [[0, 0], [1, 0], [0, 1], [1, 1]]])
    data = npz(points=points, values=np.tanh(5 * (points[:, 0] - 0.5)))
    uploads: list[httpx.Response] = []
    thread = threading.Thread(
        target=lambda: uploads.append(http.post("/v1/samples", files={"samples": ("u.npz", data)}))
    )
    thread.start()
    slowest = 0.0
    while thread.is_alive():
        began = time.perf_counter()
        assert http.get("/v1/meshes?limit=1").status_code == 200
        slowest = max(slowest, time.perf_counter() - began)
    assert uploads[0].status_code == 201
    assert uploads[0].json()["shape"] == [9004]
    assert slowest < 0.5
