"""Small files, samples and keys in the store: named and written, or removed, in one transaction."""

from __future__ import annotations

import re
import sqlite3
from contextlib import suppress
from functools import partial
from pathlib import Path

import pytest
from sqlalchemy import func, select

from equimesh_service import Settings
from equimesh_service.errors import SamplesGoneError
from equimesh_service.files.folder import FolderFiles
from equimesh_service.store.blobs import MAX_ROW_BYTES, BlobFiles
from equimesh_service.store.rows import Artifact, NewMesh, Outcome, SamplesRow
from equimesh_service.store.schema import blobs
from equimesh_service.store.store import Store
from service.files.check_files import keep
from service.store.stores import SPEC, add, claimed


def test_samples_that_a_waiting_mesh_needs_stay(store: Store) -> None:
    row = SamplesRow("s-1", "3" * 64, 10, {"kind": "grid"}, 1.0)
    assert store.samples.add(row)
    assert not store.samples.add(row)
    store.meshes.add(NewMesh(id="a", spec=SPEC, samples=("s-1",)))
    removed: list[str] = []
    assert store.samples.delete("s-1", removed.append) is False
    store.queue.cancel("a")
    assert store.samples.delete("s-1", removed.append) is True
    assert removed == ["3" * 64]
    assert store.samples.delete("s-1", removed.append) is None
    with pytest.raises(SamplesGoneError):
        store.meshes.add(NewMesh(id="b", spec=SPEC, samples=("s-1",)))


def test_every_sample_of_a_mesh_is_kept_until_it_is_finished(store: Store) -> None:
    for name in ("s-1", "s-2"):
        store.samples.add(SamplesRow(name, name, 1, {}, 0.0))
    store.meshes.add(NewMesh(id="a", spec=SPEC, samples=("s-1", "s-2")))
    gone: list[str] = []
    assert [store.samples.delete(name, gone.append) for name in ("s-1", "s-2")] == [False] * 2
    store.queue.cancel("a")
    assert store.samples.delete("s-2", gone.append) is True
    assert store.meshes.delete("a", gone.append)
    assert store.samples.delete("s-1", gone.append) is True
    assert gone == ["s-2", "s-1"]


def test_samples_of_two_keys_are_stored_once_and_are_each_ones_own(store: Store) -> None:
    row, later = SamplesRow("s-1", "3" * 64, 10, {}, 1.0), SamplesRow("s-1", "3" * 64, 10, {}, 2.0)
    published: list[str] = []
    assert store.samples.add(row, lambda _: published.append("a"), key_id="a")
    assert store.samples.get("s-1", "b") is None
    assert store.samples.add(later, lambda _: published.append("b"), key_id="b")
    assert published == ["a"]
    assert (store.samples.get("s-1", "a"), store.samples.get("s-1", "b")) == (row, later)
    assert store.samples.get("s-1") == row
    gone: list[str] = []
    store.meshes.add(NewMesh(id="m", spec=SPEC, samples=("s-1",), key_id="a"))
    assert store.samples.delete("s-1", gone.append, "c") is None
    assert store.samples.delete("s-1", gone.append, "a") is False
    assert store.samples.delete("s-1", gone.append, "b") is True
    assert store.samples.get("s-1", "b") is None
    assert store.samples.delete("s-1", gone.append, "a") is False
    store.queue.cancel("m")
    assert gone == []
    assert store.samples.delete("s-1", gone.append) is True
    assert gone == ["3" * 64]


def test_a_file_goes_with_the_last_mesh_that_has_it(store: Store) -> None:
    shared, own = "1" * 64, "2" * 64
    for mesh_id, files in (("a", [Artifact("mesh", shared, 1), Artifact("quality", own, 1)]), ("b", [])):
        add(store, mesh_id)
        store.queue.finish(claimed(store), Outcome(files=[*files, Artifact("convergence", shared, 1)]))
    removed: list[str] = []
    assert store.meshes.delete("a", removed.append)
    assert removed == [own]
    assert store.meshes.delete("b", removed.append)
    assert removed == [own, shared]
    assert not store.meshes.delete("b", removed.append)


@pytest.fixture
def files(store: Store, tmp_path: Path) -> BlobFiles:
    files = BlobFiles(store.database, FolderFiles(tmp_path))
    files.prepare(alone=True)
    return files


def rows(store: Store) -> int:
    with store.database.read() as connection:
        return int(connection.execute(select(func.count()).select_from(blobs)).scalar_one())


def test_files_up_to_a_mebibyte_are_rows_and_larger_ones_are_not(
    store: Store, files: BlobFiles, tmp_path: Path
) -> None:
    small, large = keep(files, bytes(MAX_ROW_BYTES)), keep(files, bytes(MAX_ROW_BYTES + 1))
    assert rows(store) == 1
    assert [path.name for path in tmp_path.glob("??/*")] == [large.sha256]
    assert {file.sha256: file.size for file in files.listing()} == {
        small.sha256: MAX_ROW_BYTES,
        large.sha256: MAX_ROW_BYTES + 1,
    }


def test_a_row_is_undone_with_the_transaction_that_names_it(store: Store, files: BlobFiles) -> None:
    with suppress(RuntimeError), store.database.write():
        keep(files, b"undone")
        raise RuntimeError
    assert rows(store) == 0


def test_a_row_goes_with_the_last_mesh_that_names_it(store: Store, files: BlobFiles) -> None:
    for name in ("a", "b"):
        add(store, name)
        with files.unfinished(".bin") as path:
            path.write_bytes(b"same")
            file = files.seal(path)
            publish = partial(files.publish, path, file)
            assert store.meshes.add_artifact(name, Artifact("mesh", file.sha256, file.size), publish)
    assert store.meshes.delete("a", files.remove)
    assert rows(store) == 1
    assert store.meshes.delete("b", files.remove)
    assert rows(store) == 0


def test_a_file_of_an_earlier_release_is_found_where_it_is(files: BlobFiles) -> None:
    with files.unfinished(".bin") as path:
        path.write_bytes(b"earlier")
        file = files.larger.seal(path)
        files.larger.publish(path, file, lambda _: False)
    assert files.holds(file)
    files.require(file.sha256)
    with files.local(file.sha256) as path:
        assert path.read_bytes() == b"earlier"
    files.remove(file.sha256)
    assert not files.holds(file)
    with pytest.raises(FileNotFoundError):
        files.require(file.sha256)


def test_a_listing_of_many_rows_has_each_once(files: BlobFiles, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("equimesh_service.store.blobs._LISTED_AT_ONCE", 3)
    kept = {keep(files, bytes([number])).sha256 for number in range(8)}
    listed = [file.sha256 for file in files.listing()]
    assert sorted(listed) == sorted(kept)


def test_a_write_inside_another_is_a_part_of_it(store: Store) -> None:
    with store.database.write():
        add(store, "a")
        with suppress(RuntimeError), store.database.write():
            add(store, "b")
            assert store.meshes.get("b") is not None
            raise RuntimeError
        add(store, "c")
        assert [store.meshes.get(name) is not None for name in "abc"] == [True, False, True]
    assert [row.id for row in store.meshes.page()] == ["c", "a"]


def test_the_secret_is_not_on_disk(tmp_path: Path) -> None:
    store = Store(Settings(data_dir=tmp_path).database)
    store.prepare()
    row, secret = store.keys.create("ada", ["read"])
    store.close()
    sqlite3.connect(tmp_path / "equimesh.sqlite3").execute("PRAGMA wal_checkpoint").close()
    assert all(secret[-43:].encode() not in file.read_bytes() for file in tmp_path.iterdir())
    assert re.fullmatch(r"[0-9a-f]{64}", row.sha256)


def test_a_scope_must_exist(tmp_path: Path) -> None:
    store = Store(Settings(data_dir=tmp_path).database)
    store.prepare()
    for scopes in ((), ("root",)):
        with pytest.raises(ValueError, match="scopes are read, write, admin"):
            store.keys.create("x", scopes)
    store.close()
