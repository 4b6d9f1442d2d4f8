"""Descriptions from files: JSON and blockMeshDict, by the name of the file."""

from __future__ import annotations

from pathlib import Path

import pytest

from equimesh.errors import InputError
from equimesh.io.reading.read import description_format, read_description


@pytest.mark.parametrize(
    ("name", "format"),
    [
        ("a/l.json", "json"),
        ("L.JSON", "json"),
        ("system/blockMeshDict", "blockMeshDict"),
        ("blockMeshDict.2", "blockMeshDict"),
        ("x.msh", None),
    ],
)
def test_the_name_tells_the_format(name: str, format: str | None) -> None:
    assert description_format(name) == format


def test_the_object_of_a_json(tmp_path: Path) -> None:
    (tmp_path / "l.json").write_text('{"blocks": [{"cells": [1, 2]}]}')
    assert read_description(tmp_path / "l.json", "json") == {"blocks": [{"cells": [1, 2]}]}


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (b'{"a": 1,\n "b": }', "line 2: Expecting value: this is no JSON"),
        (b"[1]", "the JSON is no object"),
        (b"[" * 100_000, "the JSON cannot be read"),
        (b"\xff\xfe", "l.json is no text in UTF-8"),
    ],
)
def test_what_is_no_description_is_refused(tmp_path: Path, content: bytes, told: str) -> None:
    (tmp_path / "l.json").write_bytes(content)
    with pytest.raises(InputError) as caught:
        read_description(tmp_path / "l.json", "json")
    assert told in caught.value.message
    with pytest.raises(InputError, match=r"none.json cannot be read"):
        read_description(tmp_path / "none.json", "json")
