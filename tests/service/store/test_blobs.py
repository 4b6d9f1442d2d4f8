"""Small files as rows: they are named and written, or removed, in one transaction."""

from __future__ import annotations

from contextlib import suppress
from functools import partial
from pathlib import Path

import pytest
from sqlalchemy import func, select

from equimesh_service.files.folder import FolderFiles
from equimesh_service.files.port import StoredFile
from equimesh_service.store.blobs import MAX_ROW_BYTES, BlobFiles
from equimesh_service.store.rows import Artifact
from equimesh_service.store.schema import blobs
from equimesh_service.store.store import Store
from service.store.stores import add


@pytest.fixture
def files(store: Store, tmp_path: Path) -> BlobFiles:
    files = BlobFiles(store.database, FolderFiles(tmp_path))
    files.prepare(alone=True)
    return files


def rows(store: Store) -> int:
    with store.database.read() as connection:
        return int(connection.execute(select(func.count()).select_from(blobs)).scalar_one())


def keep(files: BlobFiles, content: bytes) -> StoredFile:
    with files.unfinished(".bin") as path:
        path.write_bytes(content)
        file = files.seal(path)
        files.publish(path, file, lambda _: False)
    return file


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
    with files.local(file.sha256) as path:
        assert path.read_bytes() == b"earlier"
    files.remove(file.sha256)
    assert not files.holds(file)


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
