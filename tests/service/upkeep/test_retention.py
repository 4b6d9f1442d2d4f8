"""Only expired meshes and samples, and unnamed files, are removed."""

from __future__ import annotations

import errno
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from equimesh_service.files.folder import FolderFiles
from equimesh_service.files.port import StoredFile
from equimesh_service.store.rows import Artifact, NewMesh, Outcome, SamplesRow
from equimesh_service.store.store import Store
from equimesh_service.upkeep.retention import Retention, Swept
from service.store.stores import SPEC, Clock, claimed

DAY = 86_400.0


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def store(database_url: str, clock: Clock) -> Iterator[Store]:
    store = Store(database_url, clock=clock)
    store.prepare()
    yield store
    store.close()


@pytest.fixture
def files(tmp_path: Path) -> FolderFiles:
    files = FolderFiles(tmp_path / "files")
    files.prepare(alone=True)
    return files


def keep(files: FolderFiles, content: bytes, *, hours: float = 0.0) -> StoredFile:
    """A published file that was written this many hours ago."""
    with files.unfinished(".bin") as path:
        path.write_bytes(content)
        sealed = files.seal(path)
        files.publish(path, sealed, lambda _: False)
    written = time.time() - 3600.0 * hours
    os.utime(files.path(sealed.sha256), (written, written))
    return sealed


def finished(store: Store, file: StoredFile, mesh_id: str, **more: Any) -> None:
    store.meshes.add(NewMesh(id=mesh_id, spec=SPEC, **more))
    assert store.queue.finish(
        claimed(store, key_id=more.get("key_id", "")),
        Outcome(result={}, files=[Artifact("mesh", file.sha256, file.size)]),
    )


def test_finished_meshes_and_unused_samples_go_after_their_time(store: Store, clock: Clock, files: FolderFiles) -> None:
    sweep = Retention(store, files, days=30.0).sweep
    mesh, uploaded = keep(files, b"mesh"), keep(files, b"samples")
    store.samples.add(SamplesRow("s-1", uploaded.sha256, uploaded.size, {}, clock()), key_id="key")
    finished(store, mesh, "m-old", key_id="key")
    store.meshes.add(NewMesh(id="m-waits", spec=SPEC, samples=("s-1",), key_id="key"))
    clock.now += 15 * DAY
    store.queue.cancel("m-waits")
    finished(store, mesh, "m-young")
    store.meshes.add(NewMesh(id="m-needs", spec=SPEC, samples=("s-1",), key_id="key"))
    assert sweep() == Swept(meshes=0, samples=0, orphans=0)
    clock.now += 15 * DAY + 1
    assert sweep() == Swept(meshes=1, samples=0, orphans=0)
    assert [row.id for row in store.meshes.page()] == ["m-needs", "m-young", "m-waits"]
    assert store.retention.has_removed("m-old", "key")
    assert store.retention.has_removed("m-old", None)
    assert not store.retention.has_removed("m-old", "other")
    assert not store.retention.has_removed("m-young", None)
    assert files.path(mesh.sha256).exists()  # of m-young
    clock.now += 100 * DAY
    assert sweep() == Swept(meshes=2, samples=0, orphans=0)
    assert [row.id for row in store.meshes.page()] == ["m-needs"]  # waits, and so do its samples
    assert not files.path(mesh.sha256).exists()
    store.queue.cancel("m-needs")
    clock.now += 31 * DAY
    assert sweep() == Swept(meshes=1, samples=1, orphans=0)
    assert not files.path(uploaded.sha256).exists()
    assert store.retention.has_removed("s-1", "key")
    assert not store.retention.has_removed("s-1", "")
    # Samples that are uploaded again are there; when they expire again, that is recorded again.
    store.samples.add(SamplesRow("s-1", uploaded.sha256, uploaded.size, {}, clock()), key_id="key")
    assert not store.retention.has_removed("s-1", "key")
    clock.now += 301 * DAY
    assert sweep().samples == 1
    assert not store.retention.has_removed("m-old", "key")
    assert store.retention.has_removed("s-1", "key")


def test_all_of_many_meshes_go_in_one_sweep(store: Store, clock: Clock, files: FolderFiles) -> None:
    for number in range(60):
        store.meshes.add(NewMesh(id=f"m-{number}", spec=SPEC))
        store.queue.cancel(f"m-{number}")
    clock.now += DAY + 1
    assert Retention(store, files, days=1.0).sweep() == Swept(meshes=60, samples=0, orphans=0)


def test_without_a_time_all_is_kept(store: Store, clock: Clock, files: FolderFiles) -> None:
    finished(store, keep(files, b"mesh"), "m-1")
    clock.now += 10_000 * DAY
    assert Retention(store, files, days=0.0).sweep() == Swept(meshes=0, samples=0, orphans=0)


def test_files_without_an_owner_go_after_an_hour(store: Store, files: FolderFiles) -> None:
    named, uploaded = keep(files, b"named", hours=48.0), keep(files, b"samples", hours=48.0)
    finished(store, named, "m-1")
    store.samples.add(SamplesRow("s-1", uploaded.sha256, uploaded.size, {}, 0.0))
    left = [keep(files, f"left {number}".encode(), hours=1.1) for number in range(25)]
    young = keep(files, b"young", hours=0.9)
    assert Retention(store, files, days=30.0).sweep() == Swept(meshes=0, samples=0, orphans=25)
    there = {file.sha256 for file in files.listing()}
    assert there == {named.sha256, uploaded.sha256, young.sha256}
    assert not there.intersection(file.sha256 for file in left)


def test_a_file_that_cannot_be_removed_stops_nobody(
    store: Store, clock: Clock, files: FolderFiles, caplog: pytest.LogCaptureFixture
) -> None:
    for name in ("m-1", "m-2"):
        finished(store, keep(files, name.encode()), name)
    stuck = [files.path(keep(files, content, hours=2.0).sha256) for content in (b"m-1", b"orphan")]
    for path in stuck:  # folders in the place of files, which nobody can remove, not even root
        path.unlink()
        path.mkdir()
        os.utime(path, (0.0, 0.0))
    other = [keep(files, f"left {number}".encode(), hours=2.0) for number in range(5)]
    clock.now += 31 * DAY
    retention = Retention(store, files, days=30.0)
    assert retention.sweep() == Swept(meshes=2, samples=0, orphans=len(other))
    assert {file.sha256 for file in files.listing()} == {path.name for path in stuck}
    [said] = [record.getMessage() for record in caplog.records]
    assert said.startswith("2 files could not be removed, such as ")
    for path in stuck:
        path.rmdir()
    stuck[0].write_bytes(b"m-1")
    os.utime(stuck[0], (0.0, 0.0))
    assert retention.sweep() == Swept(meshes=0, samples=0, orphans=1)
    assert len(caplog.records) == 1


def test_a_storage_that_does_not_work_ends_the_sweep(
    store: Store, files: FolderFiles, monkeypatch: pytest.MonkeyPatch
) -> None:
    for number in range(30):
        keep(files, f"left {number}".encode(), hours=2.0)
    tried: list[str] = []

    def fail(_: FolderFiles, sha256: str) -> None:
        tried.append(sha256)
        raise OSError(errno.EIO, "broken")

    def down(_: FolderFiles) -> None:
        raise OSError(errno.EIO, "broken")

    monkeypatch.setattr(FolderFiles, "remove", fail)
    monkeypatch.setattr(FolderFiles, "check", down)
    with pytest.raises(OSError, match="broken"):
        Retention(store, files, days=30.0).sweep()
    assert len(tried) == 1


def test_a_file_that_finds_an_owner_meanwhile_stays(store: Store, files: FolderFiles) -> None:
    left = keep(files, b"left", hours=2.0)
    assert store.retention.find_unnamed([left.sha256]) == {left.sha256}
    finished(store, left, "m-1")
    store.retention.remove_unnamed([left.sha256], files.remove)
    assert files.path(left.sha256).exists()


def test_the_thread_sweeps_at_once_and_survives_a_failure(
    store: Store, files: FolderFiles, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    swept: list[int] = []

    def fail(_: Retention) -> Swept:
        swept.append(1)
        raise ValueError("broken")

    monkeypatch.setattr(Retention, "sweep", fail)
    retention = Retention(store, files, days=30.0)
    retention.start()
    while not swept:
        time.sleep(0.01)
    retention.stop()
    assert "the next one is in an hour" in caplog.text
