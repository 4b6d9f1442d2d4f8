"""A mesh at the service: arrays, waiting, files; for both clients."""

from __future__ import annotations

import hashlib
from typing import Any

import pytest

from equimesh_client import BadArgument, Conflict, DeadlineExceeded, DownloadDamaged, ProblemError, Schwarz


def spec(**more: Any) -> dict[str, Any]:
    return {"monitor": {"u": {"expression": "x"}}, "grid": {"n_xi": 5, "n_eta": 4}, **more}


def test_generate_gives_arrays_measures_and_pictures(connect: Any, service: Any, tmp_path: Any) -> None:
    mesh = connect(service.url).generate("x*y", (5, 4), schwarz=Schwarz(overlap=2))
    assert mesh.status == "succeeded"
    assert mesh.x.shape == mesh.y.shape == mesh.u.shape == (5, 4)
    assert mesh.points.shape == (20, 2)
    assert mesh.cells.shape == (12, 4)
    assert {side: len(edges) for side, edges in mesh.boundary.items()} == {"left": 3, "right": 3, "bottom": 4, "top": 4}
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
    with pytest.raises(DeadlineExceeded, match=r"m0.* deadline of 0\.4 s") as caught:
        mesh.wait(deadline=0.4)
    assert caught.value.mesh is not None
    assert caught.value.mesh.id == "m0"
    assert service.meshes["m0"]["status"] == "running"


def test_a_finished_mesh_cannot_be_canceled(connect: Any, service: Any) -> None:
    mesh = connect(service.url).generate("x", 5)
    with pytest.raises(Conflict):
        mesh.cancel()


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
    mesh.download(tmp_path / "second.inp", order=2)
    mesh.download(tmp_path / "f", "npz", partial=True)
    requested = [request.query for request in service.seen("GET", "file")]
    assert [query["format"] for query in requested] == ["vtu", "vtk", "xdmf", "xdmf", "msh", "abaqus", "npz"]
    assert [query.get("order") for query in requested][-3:] == [None, "2", None]
    assert requested[-1]["partial"] == "true"
