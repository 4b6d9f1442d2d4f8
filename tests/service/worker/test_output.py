"""The files of a mesh until they are published, in memory, or written each in a thread of its own."""

import threading
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

import equimesh as em
from equimesh_service.files.folder import FolderFiles
from equimesh_service.files.port import digest_of
from equimesh_service.store.blobs import MAX_ROW_BYTES, BlobFiles
from equimesh_service.store.rows import Artifact
from equimesh_service.store.store import Store
from equimesh_service.worker import solve
from equimesh_service.worker.solve import Output

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
