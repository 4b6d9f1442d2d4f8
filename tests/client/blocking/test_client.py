"""The client against a service that misbehaves: both twins, the same tests."""

from __future__ import annotations

import hashlib
import io
import socket
import time
from typing import Any

import numpy as np
import pytest

from client.fake_service import parts_of
from equimesh_client import (
    BadArgument,
    Conflict,
    DeadlineExceeded,
    DownloadDamaged,
    Forbidden,
    Gone,
    InvalidInput,
    MeshCanceled,
    MeshFailed,
    NotFound,
    ProblemError,
    QuotaExceeded,
    RateLimited,
    RetryPolicy,
    Schwarz,
    ServerError,
    ServiceUnreachable,
    StorageFull,
    Unauthorized,
)


def spec(**more: Any) -> dict[str, Any]:
    return {"monitor": {"u": {"expression": "x"}}, "grid": {"n_xi": 5, "n_eta": 4}, **more}


def test_generate_gives_arrays_measures_and_pictures(connect: Any, service: Any, tmp_path: Any) -> None:
    mesh = connect(service.url).generate("x*y", (5, 4), schwarz=Schwarz(overlap=2))
    assert mesh.status == "succeeded"
    assert mesh.x.shape == mesh.y.shape == mesh.u.shape == (5, 4)
    assert mesh.points.shape == (20, 2)
    assert mesh.cells.shape == (12, 4)
    assert {side: len(edges) for side, edges in mesh.boundary.items()} == {
        "left": 3,
        "right": 3,
        "bottom": 4,
        "top": 4,
    }
    assert mesh.quality.q_eq.max == 1.5
    assert mesh.convergence.rate == 0.5
    assert mesh.spec()["schwarz"]["overlap"] == 2
    assert mesh.plot()._repr_svg_() == "<svg/>"
    picture = mesh.plot(tmp_path / "mesh.png", "quality")
    assert picture._repr_png_() == (tmp_path / "mesh.png").read_bytes() == b"\x89PNG"
    assert picture._repr_svg_() is None


def test_arrays_quality_and_convergence_are_fetched_once(connect: Any, service: Any) -> None:
    mesh = connect(service.url).generate("x*y", 5)
    for _ in range(2):
        assert [len(mesh.points), mesh.x.size] == [25, 25]
        assert mesh.quality.min_jacobian < mesh.convergence.rate
    assert [len(service.seen("GET", part)) for part in ("file", "quality", "convergence")] == [1, 1, 1]


@pytest.mark.parametrize("action", ["drop", "lose", "status"])
def test_a_create_that_is_repeated_makes_one_mesh(connect: Any, service: Any, fault: Any, action: str) -> None:
    service.faults = [fault("POST /v1/meshes", action, times=2)]
    mesh = connect(service.url).generate("x*y", 5)
    sent = service.seen("POST", "meshes")
    assert len(sent) == 3
    assert len({request.headers["idempotency-key"] for request in sent}) == 1
    assert len({request.body for request in sent}) == 1
    assert list(service.meshes) == [mesh.id]


def test_a_create_with_samples_is_repeated_with_the_same_bytes_and_key(connect: Any, service: Any, fault: Any) -> None:
    client = connect(service.url)
    service.faults = [fault("POST /v1/samples", "lose"), fault("POST /v1/samples", "status")]
    stored = client.samples.upload(np.ones((60, 60)))
    assert list(service.samples) == [stored.id]
    service.faults = [fault("POST /v1/meshes", "lose"), fault("POST /v1/meshes", "status", status=429)]
    client.generate(np.ones((60, 60)), 5)
    sent = service.seen("POST", "meshes")
    assert len(sent) == 3
    assert len({(request.headers["idempotency-key"], request.body) for request in sent}) == 1
    assert sent[0].headers["content-type"].startswith("multipart/")
    assert len(service.meshes) == 1


def test_reuse_can_be_declined(connect: Any, service: Any) -> None:
    client = connect(service.url)
    client.generate("x", 5)
    client.generate("x", 5, reuse=False)
    client.meshes.create(spec(), reuse=False)
    assert [r.query for r in service.seen("POST", "meshes$")] == [{}, {"reuse": "false"}, {"reuse": "false"}]


def test_two_creates_are_two_meshes(connect: Any, service: Any) -> None:
    client = connect(service.url)
    assert client.generate("x", 5).id != client.generate("x", 5).id


def test_big_samples_travel_as_npz_and_small_ones_inline(connect: Any, service: Any) -> None:
    client = connect(service.url)
    client.generate(np.ones((3, 3)), 5)
    assert service.seen("POST", "meshes")[-1].headers["content-type"] == "application/json"
    client.generate(lambda x, y: x + 2 * y, 5, n_samples=65)
    sent = service.seen("POST", "meshes")[-1]
    assert sent.headers["content-type"].startswith("multipart/form-data; boundary=")
    name, data = parts_of(sent)["samples"]
    assert name == "samples.npz"
    with np.load(io.BytesIO(data), allow_pickle=False) as file:
        x, y = np.meshgrid(file["x"], file["y"], indexing="ij")
        assert np.array_equal(file["values"], x + 2 * y)


def test_retry_after_is_honoured(connect: Any, service: Any, fault: Any) -> None:
    service.faults = [fault("capabilities", "status", status=429, headers={"Retry-After": "1"})]
    start = time.monotonic()
    assert connect(service.url).capabilities() == {"formats": ["vtu", "npz"]}
    assert time.monotonic() - start > 0.95


def test_a_long_retry_after_is_the_callers_to_wait_for(connect: Any, service: Any, fault: Any) -> None:
    service.faults = [fault("capabilities", "status", status=429, headers={"Retry-After": "3600"})]
    with pytest.raises(RateLimited) as caught:
        connect(service.url).capabilities()
    assert caught.value.retry_after == 3600
    assert len(service.requests) == 1


def test_a_service_that_keeps_failing_is_given_up(connect: Any, service: Any, fault: Any) -> None:
    service.faults = [fault("capabilities", "status", status=502, times=99)]
    with pytest.raises(ServerError) as caught:
        connect(service.url).capabilities()
    assert caught.value.status == 502
    assert len(service.requests) == 4


def test_an_internal_error_is_not_repeated(connect: Any, service: Any, fault: Any) -> None:
    service.faults = [fault("capabilities", "status", status=500)]
    with pytest.raises(ServerError):
        connect(service.url).capabilities()
    assert len(service.requests) == 1


@pytest.mark.parametrize(("status", "kind"), [(401, Unauthorized), (403, Forbidden), (410, Gone), (507, StorageFull)])
def test_what_does_not_get_better_is_not_repeated(
    connect: Any, service: Any, fault: Any, status: int, kind: type[ProblemError]
) -> None:
    service.faults = [fault("POST", "status", status=status, headers={"Retry-After": "1"})]
    with pytest.raises(kind):
        connect(service.url).generate("x", 5)
    assert len(service.requests) == 1


def test_a_quota_is_waited_for_as_long_as_it_is_short(connect: Any, service: Any, fault: Any) -> None:
    body = {"type": "/problems/quota-exceeded", "title": "Too much at a time"}
    service.faults = [fault("POST", "status", status=429, body=body, times=4)]
    with pytest.raises(QuotaExceeded):
        connect(service.url).generate("x", 5)
    assert len(service.requests) == 4


def test_nobody_there(connect: Any) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        url = f"http://127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(ServiceUnreachable, match="equimesh serve"):
            connect(url, retries=1).capabilities()


def test_somebody_else_there(connect: Any, service: Any, fault: Any) -> None:
    service.faults = [fault("capabilities", "status", status=200, body=["nothing"])]  # type: ignore[arg-type]
    with pytest.raises(ServiceUnreachable, match="not as an equimesh service"):
        connect(service.url).capabilities()


@pytest.mark.parametrize("url", ["127.0.0.1:8000", "ftp://x", "http://", "nonsense", "http://[::1"])
def test_a_url_that_is_none(connect: Any, url: str) -> None:
    with pytest.raises(BadArgument):
        connect(url)


def test_wait_follows_a_slow_mesh(connect: Any, service: Any) -> None:
    mesh = connect(service.url).meshes.create(spec(label="slow"))
    assert mesh.status == "queued"
    assert not mesh.is_finished
    assert mesh.wait(deadline=10).status == "succeeded"
    assert mesh.progress.fraction == 1.0
    assert mesh.label == "slow"


def test_wait_survives_dropped_connections(connect: Any, service: Any, fault: Any) -> None:
    mesh = connect(service.url).meshes.create(spec(label="slow"))
    service.faults = [fault("GET /v1/meshes/m0$", times=2), fault("GET /v1/meshes/m0$", "half", times=1)]
    assert mesh.wait(deadline=10).status == "succeeded"


def test_wait_has_a_deadline_and_leaves_the_mesh_alone(connect: Any, service: Any) -> None:
    mesh = connect(service.url).meshes.create(spec(label="hang"))
    start = time.monotonic()
    with pytest.raises(DeadlineExceeded, match=r"m0.* deadline of 0\.4 s") as caught:
        mesh.wait(deadline=0.4)
    assert time.monotonic() - start < 2.0
    assert caught.value.mesh is not None
    assert caught.value.mesh.id == "m0"
    assert service.meshes["m0"]["status"] == "running"


def test_generate_cancels_what_nobody_waits_for(connect: Any, service: Any) -> None:
    with pytest.raises(DeadlineExceeded):
        connect(service.url).generate("x", 5, label="hang", deadline=0.4)
    assert service.meshes["m0"]["status"] == "canceled"


def test_generate_cancels_a_mesh_whose_id_never_arrived(connect: Any, service: Any, fault: Any) -> None:
    service.faults = [fault("POST /v1/meshes$", "late")]
    with pytest.raises(DeadlineExceeded):
        connect(service.url).generate("x", 5, label="hang", deadline=0.4)
    assert list(service.meshes) == ["m0"]
    assert service.meshes["m0"]["status"] == "canceled"


def test_a_deadline_ends_retries(connect: Any, service: Any, fault: Any) -> None:
    service.faults = [fault("POST /v1/meshes", times=999)]
    start = time.monotonic()
    patient = RetryPolicy(retries=999, first=0.05, longest=0.05)
    with pytest.raises(DeadlineExceeded):
        connect(service.url, retries=patient).generate("x", 5, deadline=0.5)
    assert time.monotonic() - start < 5.0


@pytest.mark.parametrize("deadline", [0, -1, float("nan")])
def test_a_deadline_is_positive(connect: Any, service: Any, deadline: float) -> None:
    with pytest.raises(BadArgument, match="deadline"):
        connect(service.url).generate("x", 5, deadline=deadline)


def test_a_failed_mesh_says_why(connect: Any, service: Any) -> None:
    with pytest.raises(MeshFailed) as caught:
        connect(service.url).generate("x", 5, label="fail")
    assert str(caught.value) == "mesh m0 failed: The mesh folded. At cell 3. Lower a"
    assert caught.value.mesh.status == "failed"


def test_a_canceled_mesh_is_not_waited_for(connect: Any, service: Any) -> None:
    mesh = connect(service.url).meshes.create(spec(label="hang"))
    assert mesh.cancel().status == "canceled"
    with pytest.raises(MeshCanceled):
        mesh.wait()


def test_a_cancel_whose_answer_was_lost(connect: Any, service: Any, fault: Any) -> None:
    mesh = connect(service.url).meshes.create(spec(label="hang"))
    service.faults = [fault("POST .*/cancel", "lose")]
    assert mesh.cancel().status == "canceled"
    assert len(service.seen("POST", "cancel")) == 2


def test_a_finished_mesh_cannot_be_canceled(connect: Any, service: Any) -> None:
    mesh = connect(service.url).generate("x", 5)
    with pytest.raises(Conflict):
        mesh.cancel()


def test_a_delete_whose_answer_was_lost(connect: Any, service: Any, fault: Any) -> None:
    mesh = connect(service.url).generate("x", 5)
    service.faults = [fault("DELETE", "lose")]
    mesh.delete()
    with pytest.raises(NotFound):
        mesh.delete()
    with pytest.raises(NotFound):
        mesh.refresh()


def test_bad_input_is_shown_with_a_caret(connect: Any, service: Any) -> None:
    with pytest.raises(InvalidInput) as caught:
        connect(service.url).generate("1 + foo*x", 5)
    assert str(caught.value).splitlines() == [
        "The input cannot be used (HTTP 422)",
        "  /monitor/u/expression: unknown name 'foo'",
        "      1 + foo*x",
        "          ^",
    ]
    with pytest.raises(InvalidInput) as caught:
        connect(service.url).check("foo")
    assert str(caught.value).endswith("      foo\n      ^")


def test_events_come_once_each_over_dropped_connections(connect: Any, service: Any) -> None:
    mesh = connect(service.url).generate("x", 5)
    service.cuts = [100, 130, 40]
    events = list(mesh.events(deadline=10))
    assert [event.id for event in events] == [1, 2, 3, 4, 5]
    assert [event.kind for event in events] == [kind for kind, _ in service.events]
    assert [event.data for event in events] == [data for _, data in service.events]
    asked = [request.headers.get("last-event-id") for request in service.seen("GET", "events")]
    assert asked[0] is None
    assert len(asked) == 4


@pytest.mark.parametrize("cut", range(0, 420, 29))
def test_events_survive_a_cut_anywhere(connect: Any, service: Any, cut: int) -> None:
    mesh = connect(service.url).meshes.create(spec())
    service.cuts = [cut]
    events = list(mesh.events(deadline=10))
    assert [event.id for event in events] == [1, 2, 3, 4, 5]
    assert [(event.kind, event.data) for event in events] == service.events


def test_events_start_where_asked(connect: Any, service: Any) -> None:
    mesh = connect(service.url).generate("x", 5)
    assert [event.id for event in mesh.events(after=3)] == [4, 5]
    assert list(mesh.events(after=5)) == []


def test_events_that_never_come_are_given_up(connect: Any, service: Any) -> None:
    mesh = connect(service.url).generate("x", 5)
    service.cuts = [0] * 99
    with pytest.raises(ServiceUnreachable, match="event stream"):
        list(mesh.events(deadline=10))


def test_events_have_a_deadline(connect: Any, service: Any) -> None:
    mesh = connect(service.url, retries=RetryPolicy(retries=99, first=0.1)).generate("x", 5)
    service.cuts = [0] * 99
    with pytest.raises(DeadlineExceeded):
        list(mesh.events(deadline=0.5))


def test_events_of_no_mesh(connect: Any, service: Any, fault: Any) -> None:
    mesh = connect(service.url).generate("x", 5)
    service.faults = [fault("events", "status", status=404), fault("events", "status", status=503)]
    with pytest.raises(NotFound):
        list(mesh.events())
    assert len(list(mesh.events())) == 5


def test_events_come_back_when_the_service_says_so(connect: Any, service: Any, fault: Any) -> None:
    mesh = connect(service.url).generate("x", 5)
    service.faults = [fault("events", "status", status=503, headers={"Retry-After": "1"})]
    start = time.monotonic()
    assert len(list(mesh.events(deadline=10))) == 5
    assert time.monotonic() - start > 0.95
    service.faults = [fault("events", "status", status=429, headers={"Retry-After": "3600"})]
    with pytest.raises(RateLimited):
        list(mesh.events(deadline=9999))
    service.faults = [fault("events", "status", status=429, headers={"Retry-After": "30"})]
    with pytest.raises(DeadlineExceeded):
        list(mesh.events(deadline=10))


def test_a_download_is_whole_or_absent(connect: Any, service: Any, fault: Any, tmp_path: Any) -> None:
    mesh = connect(service.url).generate("x", 5)
    service.faults = [fault("GET .*/file", "half"), fault("GET .*/file", "damage")]
    path = mesh.download(tmp_path / "mesh.npz")
    assert path.read_bytes()[:2] == b"PK"
    assert len(service.seen("GET", "file")) == 3
    assert [p.name for p in tmp_path.iterdir()] == ["mesh.npz"]
    service.faults = [fault("GET .*/file", "damage", times=99)]
    before = hashlib.sha256(path.read_bytes()).hexdigest()
    with pytest.raises(DownloadDamaged):
        mesh.download(path)
    with pytest.raises(DownloadDamaged):
        mesh.arrays()
    assert hashlib.sha256(path.read_bytes()).hexdigest() == before
    assert [p.name for p in tmp_path.iterdir()] == ["mesh.npz"]


def test_a_download_that_is_refused_leaves_nothing(connect: Any, service: Any, fault: Any, tmp_path: Any) -> None:
    mesh = connect(service.url).generate("x", 5)
    service.faults = [fault("GET .*/file", "status", status=406, body={"title": "No such format"})]
    with pytest.raises(ProblemError, match="No such format"):
        mesh.download(tmp_path / "mesh.vtu")
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(BadArgument, match="suffix"):
        mesh.download(tmp_path / "mesh.doc")
    with pytest.raises(BadArgument, match="cannot write"):
        mesh.download(tmp_path / "no" / "mesh.vtu")


def test_the_suffix_chooses_the_format(connect: Any, service: Any, tmp_path: Any) -> None:
    mesh = connect(service.url).generate("x", 5)
    for name in ("a.vtu", "b.VTK", "c.zip", "d.xdmf", "e.msh"):
        mesh.download(tmp_path / name)
    mesh.download(tmp_path / "f", "npz", partial=True)
    asked = [request.query for request in service.seen("GET", "file")]
    assert [query["format"] for query in asked] == ["vtu", "vtk", "xdmf", "xdmf", "msh", "npz"]
    assert asked[-1]["partial"] == "true"


def test_xdmf_is_unpacked_under_its_own_name(connect: Any, service: Any, tmp_path: Any) -> None:
    mesh = connect(service.url).generate("x", 5)
    assert mesh.download(tmp_path / "a.xdmf") == tmp_path / "a.xdmf"
    assert {p.name: p.read_text() for p in tmp_path.iterdir()} == {
        "a.xdmf": "<DataItem>a.h5:/data0</DataItem>",
        "a.h5": "mesh",
        "a_facets.xdmf": "<DataItem>a_facets.h5:/data0</DataItem>",
        "a_facets.h5": "facets",
    }
    assert mesh.download(tmp_path / "a.xdmf.zip").read_bytes()[:2] == b"PK"


def test_listing_goes_over_pages(connect: Any, service: Any) -> None:
    client = connect(service.url)
    for _ in range(5):
        client.meshes.create(spec())
    assert [mesh.id for mesh in client.meshes.list()] == ["m4", "m3", "m2", "m1", "m0"]
    assert [mesh.id for mesh in client.meshes.list(limit=3)] == ["m4", "m3", "m2"]
    assert list(client.meshes.list(limit=0)) == []
    assert client.meshes.get("m2").id == "m2"
    with pytest.raises(NotFound):
        client.meshes.get("../v1/capabilities")


def test_samples_are_stored_and_used(connect: Any, service: Any, tmp_path: Any) -> None:
    client = connect(service.url)
    stored = client.samples.upload(np.ones((3, 3)))
    assert stored.record["shape"] == [3, 3]
    client.generate(stored, 5)
    assert client.meshes.get("m0").spec()["monitor"]["u"] == {"samples": stored.id}
    client.samples.delete(stored)
    with pytest.raises(NotFound):
        client.samples.delete(stored.id)
    (tmp_path / "u.csv").write_text("x,y,u\n0,0,1\n")
    stored = client.samples.upload(tmp_path / "u.csv")
    assert service.samples[stored.id] == b"x,y,u\n0,0,1\n"


def test_samples_go_with_a_spec_that_wants_them(connect: Any, service: Any) -> None:
    client = connect(service.url)
    wanting = {**spec(), "monitor": {"u": {"samples": "upload"}}}
    client.meshes.create(wanting, samples=np.ones((3, 3)))
    with pytest.raises(BadArgument, match="samples go with"):
        client.meshes.create(wanting)
    with pytest.raises(BadArgument, match="samples go with"):
        client.meshes.create(spec(), samples=np.ones((3, 3)))


def test_headers_go_with_every_request(connect: Any, service: Any) -> None:
    connect(service.url, headers={"Authorization": "Bearer me"}).generate("x", 5).events()
    assert {request.headers["authorization"] for request in service.requests} == {"Bearer me"}


def test_the_key_goes_with_every_request_and_nowhere_else(
    connect: Any, service: Any, fault: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("EQUIMESH_KEY", " em_1_environment\n")
    connect(service.url).generate("x", 5)
    assert {request.headers["authorization"] for request in service.requests} == {"Bearer em_1_environment"}
    asked = [
        ({"key": "em_2_given"}, "Bearer em_2_given"),
        ({"key": ""}, None),
        ({"headers": {"authorization": "Basic me"}}, "Basic me"),
    ]
    for options, header in asked:
        connect(service.url, **options).capabilities()
        assert service.requests[-1].headers.get("authorization") == header
    for options in ({"key": "em_2", "headers": {"AUTHORIZATION": "x"}}, {"key": "em 2"}, {"key": "em_\u00e4"}):
        with pytest.raises(BadArgument) as caught:
            connect(service.url, **options)
        assert "em_" not in str(caught.value)
        assert "em 2" not in str(caught.value)
    # a redirect is not followed: the key is for this address
    other = f"{service.url}/v1/elsewhere"
    service.faults = [fault("capabilities", "status", status=307, headers={"Location": other})]
    with pytest.raises(ProblemError, match=other):
        connect(service.url).capabilities()
    assert service.seen("GET", "elsewhere") == []


def test_to_meshio_names_the_sides(connect: Any, service: Any) -> None:
    meshio = pytest.importorskip("meshio")
    made = connect(service.url).generate("x", (5, 4)).to_meshio()
    assert isinstance(made, meshio.Mesh)
    assert [(block.type, len(block.data)) for block in made.cells] == [
        ("quad", 12),
        ("line", 3),
        ("line", 3),
        ("line", 4),
        ("line", 4),
    ]
    assert set(made.cell_sets) == {"left", "right", "bottom", "top"}
    assert [len(part) for part in made.cell_sets["top"]] == [0, 0, 0, 0, 4]
