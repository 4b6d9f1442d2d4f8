"""The four files of an XDMF mesh."""

from __future__ import annotations

from typing import Any


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
