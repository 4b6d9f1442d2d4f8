"""A mesh at the service: arrays, waiting, files; for both clients."""

from __future__ import annotations

from typing import Any

import pytest

from equimesh_client import BadArgument, DeadlineExceeded, InputProblem, ProblemError, Schwarz
from equimesh_client.errors import caret
from equimesh_client.progress_bar import Watch


def spec(**more: Any) -> dict[str, Any]:
    return {"monitor": {"u": {"expression": "x"}}, "grid": {"n_xi": 5, "n_eta": 4}, **more}


def test_generate_gives_arrays_measures_and_pictures(connect: Any, service: Any, tmp_path: Any) -> None:
    mesh = connect(service.url).generate("x*y", (5, 4), schwarz=Schwarz(overlap=2))
    assert mesh.status == "succeeded"
    assert mesh.x.shape == mesh.y.shape == mesh.u.shape == (5, 4)
    assert mesh.points.shape == (20, 2)
    assert mesh.cells.shape == (12, 4)
    assert mesh.sides is mesh.boundary
    assert {side: len(edges) for side, edges in mesh.sides.items()} == {"left": 3, "right": 3, "bottom": 4, "top": 4}
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
    assert mesh.wait(deadline=300).status == "succeeded"
    assert mesh.progress.fraction == 1.0
    assert mesh.label == "slow"


def test_wait_survives_dropped_connections(connect: Any, service: Any, fault: Any) -> None:
    mesh = connect(service.url).meshes.create(spec(label="slow"))
    service.faults = [fault("GET /v1/meshes/m0$", times=2), fault("GET /v1/meshes/m0$", "half", times=1)]
    assert mesh.wait(deadline=300).status == "succeeded"


def test_wait_has_a_deadline_and_leaves_the_mesh_alone(connect: Any, service: Any) -> None:
    mesh = connect(service.url).meshes.create(spec(label="hang"))
    with pytest.raises(DeadlineExceeded, match=r"m0.* deadline of 0\.4 s") as caught:
        mesh.wait(deadline=0.4)
    assert caught.value.mesh.id == "m0"
    assert service.meshes["m0"]["status"] == "running"


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


RECORD = {
    "status": "running",
    "progress": {
        "stage": "single_domain",
        "phase": "sweeping the 65 x 65 grid",
        "iteration": 3,
        "residual": 1.5e-4,
        "fraction": 0.5,
    },
}


def test_it_shows_percentage_phase_and_figures(capsys: pytest.CaptureFixture[str]) -> None:
    with Watch(True) as watch:
        watch.update(RECORD)
        watch.update({"status": "succeeded", "progress": {"stage": "done"}})
    shown = capsys.readouterr().err
    for words in (" 50%", "sweeping the 65 x 65 grid, residual 1.5e-04", "done", "100%"):
        assert words in shown, words


def test_of_a_descent_it_shows_the_gain(capsys: pytest.CaptureFixture[str]) -> None:
    descent = {
        "stage": "least_error",
        "phase": "descending, step 4 of 45",
        "iteration": 4,
        "residual": None,
        "gain": 3.26,
        "fraction": 0.25,
    }
    with Watch(True) as watch:
        watch.update({"status": "running", "progress": descent})
    shown = capsys.readouterr().err
    assert "descending, step 4 of 45, error 3.3 times smaller" in shown
    assert "residual" not in shown


@pytest.mark.parametrize("progress", [False, None])
def test_without_a_terminal_it_shows_nothing_unless_requested(
    progress: bool | None, capsys: pytest.CaptureFixture[str]
) -> None:
    with Watch(progress) as watch:
        assert not watch.shown
        watch.update(RECORD)
    assert capsys.readouterr().err == ""


def test_it_never_runs_backwards(capsys: pytest.CaptureFixture[str]) -> None:
    with Watch(True) as watch:
        watch.update(RECORD)
        watch.update({**RECORD, "progress": {"fraction": 0.1}})
        assert capsys.readouterr().err.rstrip().split("\r")[-1].split("|")[0] == " 50% "
    assert capsys.readouterr().err.rstrip().split("\r")[-1].split("|")[0] == "100% "


def test_where_nobody_knows_the_work_ahead_it_shows_no_percentage(capsys: pytest.CaptureFixture[str]) -> None:
    with Watch(True) as watch:
        watch.update({"status": "queued", "progress": {"stage": "queued", "fraction": 0.0}})
        watch.update({"status": "running", "progress": {"phase": "relaxing, step 12", "fraction": None}})
    shown = capsys.readouterr().err
    assert "queued" in shown
    assert "relaxing, step 12" in shown
    assert "%" not in shown


def test_the_caret_knows_lines_tabs_and_the_end() -> None:
    assert caret("a\n\tb + c", line=2, column=4) == "    \tb + c\n    \t  ^"
    assert caret("ab", line=1, column=3) == "    ab\n      ^"
    for line, column in ((3, 1), (1, 0), (0, 1)):
        assert caret("ab", line=line, column=column) == ""
    assert str(InputProblem(pointer="", message="m")) == "m"
