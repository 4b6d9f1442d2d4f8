"""What a worker of a cluster reaches, and recognises."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from equimesh_service.files.address import FilesAddress
from equimesh_service.worker import reach as module
from equimesh_service.worker.job import Storage
from equimesh_service.worker.reach import Reach


@pytest.fixture
def storage(tmp_path: Path, database_url: str) -> Storage:
    """A storage that a service has prepared."""
    found = Storage(database_url, FilesAddress(folder=tmp_path / "files"))
    store = found.store()
    store.prepare()
    store.close()
    found.files().prepare(alone=True)
    return found


def test_the_same_storage_is_recognised(storage: Storage) -> None:
    assert not Reach.of(storage, mark=False).is_marked
    reach = Reach.of(storage)
    assert reach == Reach.of(storage)
    assert reach.is_marked
    assert reach.describe_faults() == ""


def test_another_folder_of_the_same_name_is_not(storage: Storage) -> None:
    reach = Reach.of(storage)
    (storage.address.folder / module.MARK).write_text("another")
    assert reach.describe_faults() == f"it does not see the folder of the service's files, {storage.address.folder}"


@pytest.mark.parametrize("database_url", ["sqlite"], indirect=True)
def test_sqlite_needs_the_machine_and_the_file_of_the_service(storage: Storage) -> None:
    reach = Reach.of(storage)
    elsewhere = replace(reach, machine="another")
    assert "SQLite needs one machine, PostgreSQL does not" in elsewhere.describe_faults()
    assert reach.file is not None
    other = replace(reach, file=(reach.file[0], reach.file[1] + 1))
    assert "it does not see the database of the service" in other.describe_faults()


def test_a_database_that_does_not_answer_or_is_another_is_told_without_its_address(storage: Storage) -> None:
    down = "postgresql+psycopg://user:secret@127.0.0.1:1/none"
    reach = replace(Reach.of(storage), storage=replace(storage, database_url=down))
    assert reach.describe_faults() == "it cannot reach the database of the service (OperationalError)"


@pytest.mark.parametrize("database_url", ["postgresql"], indirect=True)
def test_a_database_without_the_tables_is_another(tmp_path: Path, database_url: str) -> None:
    storage = Storage(database_url, FilesAddress(folder=tmp_path / "files"))
    storage.files().prepare(alone=True)
    assert Reach.of(storage).describe_faults() == "it reaches another database than the service, without its tables"


def test_files_that_cannot_be_written_are_told(storage: Storage, monkeypatch: pytest.MonkeyPatch) -> None:
    from equimesh_service.files.folder import FolderFiles

    def full(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    reach = Reach.of(storage)
    monkeypatch.setattr(FolderFiles, "prepare", full)
    assert reach.describe_faults() == "it cannot use the files of the service: Permission denied"
