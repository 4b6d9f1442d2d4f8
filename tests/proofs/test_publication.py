"""No row names a file that is not there, whoever removes the same content meanwhile; storage far away, for which a
transaction does not wait, is no exception."""

from __future__ import annotations

import os
import shutil
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import pytest
from sqlalchemy import func, select

from equimesh_service.files.folder import FolderFiles
from equimesh_service.files.port import Files, Publish, Removed, StoredFile
from equimesh_service.store.blobs import BlobFiles
from equimesh_service.store.rows import Artifact, NewMesh, NewStep, Outcome, SamplesRow
from equimesh_service.store.schema import removals
from equimesh_service.store.store import Store
from service.store.stores import SPEC, Clock, claimed


@dataclass(frozen=True)
class Far(FolderFiles):
    """Files as in a bucket: sealing uploads them, and publishing checks them only if they may be gone again."""

    def seal(self, path: Path) -> StoredFile:
        file = super().seal(path)
        self._put(path, file)
        return file

    def publish(self, path: Path, file: StoredFile, removed: Removed) -> None:
        if removed(file.sha256) and not self.path(file.sha256).exists():
            self._put(path, file)

    def _put(self, path: Path, file: StoredFile) -> None:
        target = self.path(file.sha256)
        target.parent.mkdir(exist_ok=True)
        with self.unfinished(".put") as whole:
            shutil.copyfile(path, whole)
            os.replace(whole, target)


@pytest.fixture(params=["far", "rows"])
def files(request: pytest.FixtureRequest, tmp_path: Path, store: Store) -> Files:
    far = Far(tmp_path / "files")
    files: Files = far if request.param == "far" else BlobFiles(store.database, far)
    files.prepare(alone=True)
    return files


def is_there(files: Files, sha256: str) -> bool:
    try:
        with files.local(sha256) as path:
            return path.read_bytes() == b"same"
    except FileNotFoundError:
        return False


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def store(database_url: str, clock: Clock) -> Iterator[Store]:
    store = Store(database_url, clock=clock)
    store.prepare()
    yield store
    store.close()


def finish(store: Store, file: StoredFile, publish: Publish, name: str = "m") -> None:
    store.meshes.add(NewMesh(id=name, spec=SPEC))
    assert store.queue.finish(
        claimed(store), Outcome(files=[Artifact("mesh", file.sha256, file.size)], publish=publish)
    )


def export(store: Store, file: StoredFile, publish: Publish) -> None:
    store.meshes.add(NewMesh(id="m", spec=SPEC))
    assert store.meshes.add_artifact("m", Artifact("file:vtu:quad", file.sha256, file.size), publish)


def upload(store: Store, file: StoredFile, publish: Publish) -> None:
    assert store.samples.add(SamplesRow("s-1", file.sha256, file.size, {}, 0.0), publish)


def step(store: Store, file: StoredFile, publish: Publish) -> None:
    fields = Artifact("fields", file.sha256, file.size)
    taken = NewStep(sequence_id="q-1", number=0, keep=2, fingerprint="", fields=fields, publish=publish)
    store.meshes.add(NewMesh(id="m", spec=SPEC), step=taken)


def sweep(store: Store, file: StoredFile, _: Publish, files: Files) -> None:
    store.retention.remove_unnamed([file.sha256], files.remove)


def delete_mesh(store: Store, file: StoredFile, publish: Publish, files: Files) -> None:
    finish(store, file, publish, "other")
    assert store.meshes.delete("other", files.remove)


def retire_mesh(store: Store, file: StoredFile, publish: Publish, files: Files) -> None:
    finish(store, file, publish, "other")
    assert store.retention.retire_meshes(-1.0, files.remove) == 1


def delete_sequence(store: Store, file: StoredFile, publish: Publish, files: Files) -> None:
    step(store, file, publish)
    assert store.sequences.delete("q-1", files.remove)


def delete_samples(store: Store, file: StoredFile, publish: Publish, files: Files) -> None:
    upload(store, file, publish)
    assert store.samples.delete("s-1", files.remove)


def retire_samples(store: Store, file: StoredFile, publish: Publish, files: Files) -> None:
    upload(store, file, publish)
    assert store.retention.retire_samples(-1.0, files.remove) == 1


REMOVALS = (sweep, delete_mesh, retire_mesh, delete_sequence, delete_samples, retire_samples)


@pytest.mark.parametrize(("database_url", "files"), [("sqlite", "far"), ("postgresql", "rows")], indirect=True)
@pytest.mark.parametrize(
    ("remove", "name"), [(way, finish) for way in REMOVALS] + [(sweep, way) for way in (export, upload, step)]
)
def test_what_is_removed_between_sealing_and_naming_is_there(
    store: Store,
    files: Files,
    clock: Clock,
    remove: Callable[[Store, StoredFile, Publish, Files], None],
    name: Callable[[Store, StoredFile, Publish], None],
) -> None:
    with files.unfinished(".bin") as path:
        path.write_bytes(b"same")
        file = files.seal(path)
        publish = partial(files.publish, path, file)
        remove(store, file, publish, files)
        assert not is_there(files, file.sha256)
        clock.now += 80_000.0
        store.retention.forget(0.0)
        name(store, file, publish)
    assert is_there(files, file.sha256)
    clock.now += 80_000.0
    store.retention.forget(0.0)
    with store.database.read() as connection:
        assert connection.execute(select(func.count()).select_from(removals)).scalar() == 0


def test_whoever_names_a_file_finds_it_while_others_remove_it(store: Store, files: Files) -> None:
    end, missing, seen = time.monotonic() + 1.0, list[str](), list[str]()

    def act(who: int) -> None:
        while time.monotonic() < end:
            with files.unfinished(".bin") as path:
                path.write_bytes(b"same")
                file = files.seal(path)
                row = SamplesRow(f"s-{who}", file.sha256, file.size, {}, 0.0)
                store.samples.add(row, partial(files.publish, path, file))
            (seen if is_there(files, file.sha256) else missing).append(row.id)
            store.samples.delete(row.id, files.remove)

    def remove() -> None:
        while time.monotonic() < end:
            for file in files.listing():
                store.retention.remove_unnamed([file.sha256], files.remove)

    threads = [threading.Thread(target=act, args=(who,)) for who in range(3)] + [threading.Thread(target=remove)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert seen
    assert not missing
    assert not any(files.listing())
