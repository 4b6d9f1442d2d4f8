"""The files of a mesh until they are published, in parts, in other formats, and as drawings."""

from __future__ import annotations

import io
import json
import threading
import time
import zipfile
from contextlib import ExitStack
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import equimesh
import equimesh as em
from equimesh.io.write import FORMATS
from equimesh.quality import compare_with_uniform
from equimesh_cluster import ClusterError, NoSchedulerError
from equimesh_cluster.mesh_part import cut
from equimesh_cluster.part_files.parted_mesh import read_parts
from equimesh_service.errors import WorkerLostError
from equimesh_service.files.folder import FolderFiles
from equimesh_service.files.port import digest_of
from equimesh_service.problems.problem import Problem
from equimesh_service.store.blobs import MAX_ROW_BYTES, BlobFiles
from equimesh_service.store.rows import Artifact
from equimesh_service.store.store import Store
from equimesh_service.worker import in_parts, solve
from equimesh_service.worker.drawing import arrays_of, document_of, norm_of, pack
from equimesh_service.worker.in_parts import PartsLayout, convert_part_file, write_head_file, write_part_file
from equimesh_service.worker.job import MESH, PICTURES, PLOTS, file_name, plot_name
from equimesh_service.worker.part_formats import HEADED, PART_FORMATS, WRITTEN
from equimesh_service.worker.solve import Output
from equimesh_service.worker.summary import summary_of
from service.parts import CUTS, SHAPE, bent_mesh, u_of

NONE: Any = None


@pytest.fixture
def files(tmp_path: Path) -> BlobFiles:
    store = Store(f"sqlite:///{tmp_path / 'a.sqlite3'}")
    store.prepare()
    files = BlobFiles(store.database, FolderFiles(tmp_path / "files"))
    files.prepare(alone=True)
    return files


def left(folder: Path) -> list[Path]:
    return [path for path in (folder / "files").rglob("*") if path.is_file()]


@pytest.mark.parametrize("in_threads", [False, True])
def test_files_are_there_in_their_order_once_they_are_published(
    files: BlobFiles, in_threads: bool, tmp_path: Path
) -> None:
    problem = em.Problem(monitor=em.ArcLength(u=em.Expression("x*y")), grid=em.Grid(n_xi=5, n_eta=4))
    data = em.solve(problem).data()
    with ExitStack() as stack:
        output = Output(files, stack, in_threads=in_threads)
        output.mesh("one", data, format="npz")
        output.mesh("two", data, format="vtu", cells="triangle")
        output.json("three", {"a": 1})
        output.json("large", "x" * MAX_ROW_BYTES)
        artifacts, contents = output.artifacts(), output.small_contents()
        assert list(files.listing()) == []
        output.publish(lambda _: False)
    assert [file.name for file in artifacts] == ["one", "two", "three", "large"]
    assert set(contents) == {file.sha256 for file in artifacts[:3]}
    assert contents[artifacts[2].sha256] == b'{"a": 1}'
    for file in artifacts:
        with files.local(file.sha256) as path:
            assert Artifact(file.name, *vars(digest_of(path)).values()) == file
    assert len([path for path in left(tmp_path) if path.stat().st_size > MAX_ROW_BYTES]) == 1


@pytest.mark.parametrize("in_threads", [False, True])
def test_a_file_that_cannot_be_written_leaves_nothing(
    files: BlobFiles, tmp_path: Path, in_threads: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also none that a thread is still writing, since a failure waits for the thread."""
    before, ended = left(tmp_path), threading.Event()

    def write(path: Path, *_: Any, format: str, **__: Any) -> None:
        if format == "npz":
            path.write_text("half")
            raise OSError(28, "No space left on device")
        time.sleep(0.2)
        path.write_text("late")
        ended.set()

    def make(*_: Any, **__: Any) -> bytes:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(solve, "write_mesh", write)
    monkeypatch.setattr(solve, "mesh_bytes", make)

    def written() -> None:
        with ExitStack() as stack:
            output = Output(files, stack, in_threads=in_threads)
            output.mesh("full", NONE, format="npz")
            output.mesh("late", NONE, format="vtu")
            output.artifacts()

    with pytest.raises(OSError, match="No space left"):
        written()
    assert ended.is_set() == in_threads
    assert left(tmp_path) == before


LAYOUT = PartsLayout(name="m-1", grid=equimesh.Grid(n_xi=SHAPE[0], n_eta=SHAPE[1]), firsts=(0, *CUTS), nodes=("u",))


def written(folder: Path) -> list[Path]:
    files = []
    for part in cut(bent_mesh(), CUTS):
        files.append(folder / f"{part.number}.vtu")
        write_part_file(files[-1], part, {"u": u_of}, WRITTEN)
    return files


def test_a_layout_is_what_its_record_says() -> None:
    assert LAYOUT.record() == {"name": "m-1", "rows": [[0, 6], [6, 12], [12, 17]], "nodes": ["u"]}
    assert PartsLayout.of(LAYOUT.record(), LAYOUT.grid) == LAYOUT


@pytest.mark.parametrize("format", HEADED)
def test_parts_in_every_format_open_as_one_mesh(tmp_path: Path, format: str) -> None:
    mesh, form = bent_mesh(), PART_FORMATS[format]
    (tmp_path / "m-1").mkdir()
    for number, source in enumerate(written(tmp_path)):
        convert_part_file(source, tmp_path / form.path_of_part("m-1", number), LAYOUT, number, format)
    write_head_file(tmp_path / form.head_name("m-1"), LAYOUT, format)
    found = read_parts(tmp_path / form.head_name("m-1"))
    assert found.cuts == CUTS
    for name, values in (("x", mesh.x), ("y", mesh.y), ("u", u_of(mesh.x, mesh.y))):
        np.testing.assert_array_equal(found.rows(name, 0, SHAPE[0]), values)


def test_a_part_in_the_format_of_the_first_writing_is_the_same_file(tmp_path: Path) -> None:
    source = written(tmp_path)[1]
    convert_part_file(source, tmp_path / "again.vtu", LAYOUT, 1, WRITTEN)
    assert (tmp_path / "again.vtu").read_bytes() == source.read_bytes()


def test_the_arrays_of_a_part(tmp_path: Path) -> None:
    convert_part_file(written(tmp_path)[1], tmp_path / "1.npz", LAYOUT, 1, "npz")
    mesh = bent_mesh()
    with np.load(tmp_path / "1.npz") as file:
        np.testing.assert_array_equal(file["x"], mesh.x[6:13])
        np.testing.assert_array_equal(file["u"], u_of(mesh.x, mesh.y)[6:13])


def solve_with(error: Exception, monkeypatch: pytest.MonkeyPatch) -> None:
    """Solve a mesh whose computation raises ``error``."""

    def fail(*_: Any) -> None:
        raise error

    monkeypatch.setattr(in_parts, "_compute", fail)
    job: Any = SimpleNamespace(claim=SimpleNamespace(mesh_id="m"))
    store: Any = SimpleNamespace(queue=SimpleNamespace(progress=print))
    in_parts.solve_in_parts(job, SimpleNamespace(), store, None)  # type: ignore[arg-type]


def test_a_scheduler_out_of_reach_ends_the_attempt_and_not_the_mesh(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(WorkerLostError, match="lost the cluster"):
        solve_with(NoSchedulerError("no scheduler answers at tcp://10.0.0.7:8786"), monkeypatch)


@pytest.mark.parametrize(
    ("told", "shown"),
    [
        ("the worker tcp://10.0.0.7:4501 has 1 GB left", "a worker has 1 GB left"),
        ("the machine 10.0.0.7 has 1 GB free", "a machine has 1 GB free"),
        ("versions differ: tls://[fe80::1]:4501 has numpy 2.1", "versions differ: a worker has numpy 2.1"),
    ],
)
def test_a_refusal_names_no_address(told: str, shown: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(Problem) as refused:
        solve_with(ClusterError(told), monkeypatch)
    assert refused.value.name == "cluster-refused"
    assert refused.value.body()["detail"] == f"{shown}."


def test_each_file_and_picture_has_a_name_of_its_own() -> None:
    files = [file_name(*of) for of in product(FORMATS, ("quad", "triangle"), (1, 2))]
    pictures = [plot_name(kind, format) for kind, format in product(PLOTS, PICTURES)]
    assert len({*files, *pictures}) == len(files) + len(pictures)
    assert file_name("npz", "quad") == MESH  # the mesh as it was computed is no export


SPEC: dict[str, Any] = {"monitor": {"kind": "arc_length"}, "target": None}
U = em.Expression("tanh(9*(x - y))")


def solution() -> em.Solution:
    return em.solve(em.Problem(monitor=em.ArcLength(u=U), grid=em.Grid(n_xi=9, n_eta=8)), em.Schwarz(overlap=2))


def test_an_archive_is_read_by_numpy_and_not_compressed() -> None:
    arrays = {"x": np.arange(6.0).reshape(2, 3).T, "u": np.ones((2, 2), dtype=np.float32)}
    content = pack({"text": "ξ", "none": None}, arrays)
    with np.load(io.BytesIO(content), allow_pickle=False) as found:
        assert json.loads(found["document"].tobytes()) == {"text": "ξ", "none": None}
        for name, values in arrays.items():
            assert np.array_equal(found[name], values)
            assert found[name].dtype == values.dtype
            assert found[name].flags.c_contiguous
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        assert {entry.compress_type for entry in archive.infolist()} == {zipfile.ZIP_STORED}
    assert content == pack({"text": "ξ", "none": None}, arrays)


def test_a_folded_mesh_leaves_the_uniform_one() -> None:
    mesh = em.Mesh.uniform(em.Grid(n_xi=6, n_eta=5))
    mesh.x[2, 2] = 0.9
    monitor = em.Problem(monitor=em.ArcLength(u=U), grid=mesh.grid).monitor
    compared = compare_with_uniform(mesh, monitor)
    names = {"x", "y", "u", "q_eq", "error"}
    assert arrays_of(compared, is_folded=True).keys() == {f"uniform_{name}" for name in names}
    assert arrays_of(compared, is_folded=False).keys() == names | {f"uniform_{name}" for name in names}


def test_a_document_is_plain_json_also_where_a_solve_failed() -> None:
    solved = solution()
    error = {"title": "Mesh folded", "detail": "A cell is inverted.", "remedy": "Add points."}
    result = {"solution": summary_of(solved), "certificate": solved.certificate.summary(), "quality": None}
    mesh, parts = solved.mesh, solved.decomposition
    spec = {**SPEC, "schwarz": {"ordering": "parallel"}}
    document = document_of(spec, result, error=error, convergence=None, decomposition=parts, mesh=mesh)
    assert json.loads(json.dumps(document, allow_nan=False))["status"] == "failed"
    assert document["sentences"][0]["tone"] == "bad"
    assert document["subdomains"] == [{"xi": [0, 5], "eta": [0, 7]}, {"xi": [4, 8], "eta": [0, 7]}]
    plain = document_of(SPEC, result, error=None, convergence=None, decomposition=None, mesh=mesh)
    assert (plain["status"], plain["subdomains"], plain["ordering"]) == ("succeeded", None, None)


def test_the_norm_is_that_of_the_target_or_of_the_monitor() -> None:
    monitor = {"kind": "curvature", "norm": "h1"}
    assert norm_of({"monitor": monitor}) == "h1"
    assert norm_of({"monitor": monitor, "target": {"norm": "l2"}}) == "l2"
    assert norm_of({"monitor": {"kind": "weight"}, "target": None}) == "l2"
