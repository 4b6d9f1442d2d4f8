"""Addresses of files."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest
from pydantic import SecretStr

from equimesh_service import Settings
from equimesh_service.errors import FilesError
from equimesh_service.files.address import FilesAddress, files_address
from equimesh_service.files.folder import FolderFiles
from equimesh_service.files.port import Files
from equimesh_service.files.s3 import Bucket, S3Files


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
