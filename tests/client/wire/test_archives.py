"""The four files of an XDMF mesh, and the five of an OpenFOAM mesh."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from typing import Any

import pytest

from equimesh_client import DownloadDamaged
from equimesh_client.wire.downloads import FOAM_FILES, unpack_foam, unpack_xdmf


def archive(*names: str) -> bytes:
    """A zip of these files, each with a reference to the heavy data of its part."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as made:
        for name in names:
            made.writestr(name, f"{name.partition('.')[0]}.h5:/0")
    return file.getvalue()


def test_xdmf_is_unpacked_under_its_own_name(connect: Any, service: Any, tmp_path: Any) -> None:
    mesh = connect(service.url).generate("x", 5)
    assert mesh.download(tmp_path / "a.xdmf") == tmp_path / "a.xdmf"
    assert {p.name: p.read_text() for p in tmp_path.iterdir()} == {
        "a.xdmf": "<DataItem>a.h5:/data0</DataItem>",
        "a.h5": "mesh",
        "a_facets.xdmf": "<DataItem>a_facets.h5:/data0</DataItem>",
        "a_facets.h5": "facets",
    }
    assert mesh.download(tmp_path / "a.xdmf.zip").read_bytes()[:2] == b"PK"


@pytest.mark.parametrize("data", [b"", b"no zip", archive("mesh.h5", "mesh.xdmf")])
def test_an_archive_without_its_files_writes_nothing(data: bytes, tmp_path: Path) -> None:
    with pytest.raises(DownloadDamaged, match="XDMF archive"):
        unpack_xdmf(data, tmp_path / "m.xdmf")
    assert list(tmp_path.iterdir()) == []


def test_references_follow_the_new_name(tmp_path: Path) -> None:
    data = archive("mesh.h5", "mesh.xdmf", "facets.h5", "facets.xdmf")
    assert unpack_xdmf(data, tmp_path / "m.xdmf") == tmp_path / "m.xdmf"
    names = {
        "m.h5": "mesh.h5:/0",
        "m.xdmf": "m.h5:/0",
        "m_facets.h5": "facets.h5:/0",
        "m_facets.xdmf": "m_facets.h5:/0",
    }
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == names


def test_foam_is_unpacked_into_a_case_whose_other_files_stay(connect: Any, service: Any, tmp_path: Path) -> None:
    (tmp_path / "system").mkdir()
    (tmp_path / "system" / "controlDict").write_text("mine")
    mesh = connect(service.url).generate("x", 5)
    assert mesh.download(tmp_path) == mesh.download(tmp_path, "foam") == tmp_path
    found = {path.relative_to(tmp_path).as_posix(): path.read_text() for path in tmp_path.rglob("*") if path.is_file()}
    assert found.pop("system/controlDict") == "mine"
    assert found == {name: name for name in FOAM_FILES}
    assert mesh.download(tmp_path / "a.foam.zip").read_bytes()[:2] == b"PK"


@pytest.mark.parametrize("data", [b"no zip", archive(*FOAM_FILES[1:])])
def test_an_incomplete_foam_mesh_writes_nothing(data: bytes, tmp_path: Path) -> None:
    with pytest.raises(DownloadDamaged, match="OpenFOAM archive"):
        unpack_foam(data, tmp_path)
    assert list(tmp_path.iterdir()) == []
