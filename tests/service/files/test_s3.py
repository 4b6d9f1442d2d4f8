"""Files in S3: what is not asked for, what is damaged, what cannot be used."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from pydantic import SecretStr

from equimesh_service.errors import FilesError
from equimesh_service.files.port import StoredFile
from equimesh_service.files.s3 import Bucket, S3Files
from service.files.check_files import keep, read
from service.s3_server import SECRET_KEY, S3Server
from service.storages import bucket_of


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
