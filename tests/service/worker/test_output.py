"""The files of a mesh until they are published, written one after the other or each in a thread of its own."""

import threading
import time
from contextlib import ExitStack
from pathlib import Path

import pytest

from equimesh_service.files.folder import FolderFiles
from equimesh_service.files.port import digest_of
from equimesh_service.store.rows import Artifact
from equimesh_service.worker.solve import Output


@pytest.fixture
def files(tmp_path: Path) -> FolderFiles:
    files = FolderFiles(tmp_path)
    files.prepare(alone=True)
    return files


@pytest.mark.parametrize("in_threads", [False, True])
def test_files_are_there_in_their_order_once_they_are_published(files: FolderFiles, in_threads: bool) -> None:
    """With threads the first is ready last, and the order must not depend on that."""
    second = threading.Event()
    with ExitStack() as stack:
        output = Output(files, stack, in_threads=in_threads)
        output.write("one", ".txt", lambda path: (second.wait(30.0 if in_threads else 0.0), path.write_text("first")))
        output.write("two", ".txt", lambda path: (path.write_text("the second"), second.set()))
        output.json("three", {"a": 1})
        artifacts = output.artifacts()
        assert list(files.listing()) == []
        output.publish(lambda _: False)
    assert [(file.name, file.size) for file in artifacts] == [("one", 5), ("two", 10), ("three", 8)]
    for file in artifacts:
        with files.local(file.sha256) as path:
            assert Artifact(file.name, *vars(digest_of(path)).values()) == file


@pytest.mark.parametrize("in_threads", [False, True])
def test_a_file_that_cannot_be_written_leaves_nothing(files: FolderFiles, tmp_path: Path, in_threads: bool) -> None:
    """Also none that a thread is still writing, since a failure waits for the thread."""
    ended = threading.Event()

    def late(path: Path) -> None:
        time.sleep(0.2)
        path.write_text("late")
        ended.set()

    def full(path: Path) -> None:
        path.write_text("half")
        raise OSError(28, "No space left on device")

    def written() -> None:
        with ExitStack() as stack:
            output = Output(files, stack, in_threads=in_threads)
            output.write("full", ".txt", full)
            output.write("late", ".txt", late)
            output.artifacts()

    with pytest.raises(OSError, match="No space left"):
        written()
    assert ended.is_set() == in_threads
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []
