"""Folders and buckets keep the contract of the port for files, and their addresses."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from pydantic import SecretStr

from equimesh_service import Settings
from equimesh_service.errors import FilesError
from equimesh_service.files.address import FilesAddress, files_address
from equimesh_service.files.folder import FolderFiles
from equimesh_service.files.port import Files, StoredFile
from equimesh_service.files.s3 import Bucket, S3Files
from service.files.check_files import CHECKS, keep, read
from service.s3_server import SECRET_KEY, S3Server
from service.storages import bucket_of


def test_an_address_of_files(tmp_path: Path) -> None:
    def opened(url: str, **more: Any) -> Files:
        return FilesAddress(folder=tmp_path, url=url, **more).open()

    assert opened("") == FolderFiles(tmp_path)
    assert opened("file:///a%20b/c") == FolderFiles(Path("/a b/c"))
    assert opened("s3://bucket/a/b/") == S3Files(Bucket(name="bucket", prefix="a/b"), tmp_path)
    settings = Settings(data_dir=tmp_path, files_url="s3://bucket", s3_endpoint="http://x:1/", s3_region="eu")
    assert files_address(settings).open() == S3Files(
        Bucket(name="bucket", endpoint="http://x:1", region="eu"), tmp_path / "files"
    )
    for url, more, match in (
        ("ftp://x/y", {}, "it must be s3://bucket/prefix"),
        ("file://host/x", {}, "it must be"),
        ("s3:bucket", {}, "no name of a bucket"),
        ("s3://hidden:hidden@bucket/x", {}, r"'s3://…@bucket/x'"),
        ("s3://bucket", {"endpoint": "s3.example.org"}, "S3_ENDPOINT must be an address"),
        ("s3://bucket", {"access_key": SecretStr("hidden")}, "go together"),
    ):
        with pytest.raises(FilesError, match=match) as caught:
            opened(url, **more)
        assert "hidden" not in str(caught.value)


def test_s3_needs_its_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "obstore", None)
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    with pytest.raises(FilesError, match=r"pip install 'equimesh\[s3\]'"):
        FilesAddress(folder=tmp_path, url="s3://bucket").open()


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
def test_an_implementation_of_files(check: Callable[[Files, Path], None], files: Files, tmp_path: Path) -> None:
    check(files, tmp_path)


def test_publishing_in_s3_asks_nothing_unless_the_content_was_removed(tmp_path: Path) -> None:
    nobody = Bucket(name="nowhere", endpoint="http://127.0.0.1:9", access_key=SecretStr("a"), secret_key=SecretStr("b"))
    files, file = S3Files(nobody, tmp_path), StoredFile("0" * 64, 1)
    files.publish(tmp_path, file, lambda _: False)
    with pytest.raises(FilesError, match="does not answer"):
        files.publish(tmp_path, file, lambda sha256: sha256 == file.sha256)


def test_a_damaged_object_is_not_taken_for_a_mesh(s3: S3Server, tmp_path: Path) -> None:
    folder = s3.bucket("damaged")
    files = S3Files(bucket_of(s3, "damaged", prefix=""), tmp_path)
    files.prepare(alone=True)
    file = keep(files, b"right")
    (folder / file.sha256[:2] / file.sha256).write_bytes(b"wrong")
    with pytest.raises(FilesError, match="is damaged"):
        read(files, file.sha256)


@pytest.mark.parametrize(
    ("more", "match"),
    [
        ({"name": "nowhere"}, "there is no bucket s3://nowhere/a/b at http"),
        ({"secret_key": SecretStr("wrong")}, "does not take the key: see EQUIMESH_S3_ACCESS_KEY"),
        ({"access_key": SecretStr("wrong")}, "does not take the key"),
        ({"endpoint": "http://127.0.0.1:9"}, "does not answer as S3 storage does"),
    ],
)
def test_a_storage_that_cannot_be_used(s3: S3Server, tmp_path: Path, more: dict[str, Any], match: str) -> None:
    (s3.folder / "usable").mkdir(exist_ok=True)
    files = S3Files(bucket_of(s3, **{"name": "usable", **more}), tmp_path)
    with pytest.raises(FilesError, match=match) as caught:
        files.prepare(alone=True)
    assert SECRET_KEY not in str(caught.value)
    assert "wrong" not in str(caught.value)
