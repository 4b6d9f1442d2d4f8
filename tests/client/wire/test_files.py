"""Files that appear whole or not at all."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from equimesh_client import BadArgument
from equimesh_client.wire.downloads import write_atomically


def test_a_file_is_replaced_and_nothing_else_is_left(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"old")
    assert write_atomically(tmp_path / "a", b"new") == tmp_path / "a"
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {"a": b"new"}


def test_a_failure_keeps_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    (tmp_path / "a").write_bytes(b"old")
    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(BadArgument, match="No space left"):
        write_atomically(tmp_path / "a", b"new")
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {"a": b"old"}


def test_a_folder_is_no_file(tmp_path: Path) -> None:
    with pytest.raises(BadArgument, match="is a folder"):
        write_atomically(tmp_path, b"")
    with pytest.raises(BadArgument, match="No such file"):
        write_atomically(tmp_path / "no" / "where", b"")
