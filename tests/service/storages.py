"""Fixtures of files in a folder and in S3, and a content to store."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import pytest
from pydantic import SecretStr

from equimesh_service import Settings
from equimesh_service.files.folder import FolderFiles
from equimesh_service.files.port import Files
from equimesh_service.files.s3 import Bucket, S3Files
from equimesh_service.store.blobs import BlobFiles
from equimesh_service.store.store import Store
from service.s3_server import ACCESS_KEY, SECRET_KEY, S3Server, serving

CONTENT = bytes(range(256)) * 40
_numbers = itertools.count()


@pytest.fixture(scope="session")
def s3(tmp_path_factory: pytest.TempPathFactory) -> Iterator[S3Server]:
    """A server of the S3 protocol."""
    with serving(tmp_path_factory.mktemp("s3")) as server:
        yield server


def bucket_of(s3: S3Server, name: str, **more: Any) -> Bucket:
    """The address and the key of a bucket."""
    keys = {"access_key": SecretStr(ACCESS_KEY), "secret_key": SecretStr(SECRET_KEY)}
    return Bucket(**{"name": name, "prefix": "a/b", "endpoint": s3.endpoint, **keys, **more})


@pytest.fixture(params=["folder", "s3", "rows"])
def files(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Files]:
    """Files of each kind, prepared; their temporary files are in ``tmp_path``."""
    with ExitStack() as stack:
        found = _made(request, tmp_path, stack)
        found.prepare(alone=True)
        yield found


def _made(request: pytest.FixtureRequest, tmp_path: Path, stack: ExitStack) -> Files:
    if request.param == "folder":
        found: Files = FolderFiles(tmp_path)
    elif request.param == "rows":
        store = stack.enter_context(closing(Store(f"sqlite:///{tmp_path / 'rows.sqlite3'}")))
        store.prepare()
        found = BlobFiles(store.database, FolderFiles(tmp_path))
    else:
        server: S3Server = request.getfixturevalue("s3")
        name = f"bucket-{next(_numbers)}"
        server.bucket(name)
        found = S3Files(bucket_of(server, name), tmp_path)
    return found


def stored_names(settings: Settings) -> set[str]:
    """The names of all files that a service keeps, in rows and in its folder."""
    with closing(Store(settings.database)) as store:
        files = BlobFiles(store.database, FolderFiles(settings.data_dir / "files"))
        return {file.sha256 for file in files.listing()}
