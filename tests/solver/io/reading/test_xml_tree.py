"""XML that somebody sends: no entities, and bounds on elements, depth and attributes."""

from __future__ import annotations

import pytest

from solver.upload.bombs import check_bomb_is_refused
from solver.upload.files import refused


def test_entities_are_refused() -> None:
    laughs = b'<!DOCTYPE a [<!ENTITY b "bbbb">]><VTKFile>&b;</VTKFile>'
    refused(laughs, "u.vtu", "entities")


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_entities_are_refused_in_any_encoding(encoding: str) -> None:
    head = f"<?xml version='1.0' encoding='{encoding}'?>"
    laughs = f'{head}<!DOCTYPE a [<!ENTITY b "bbbb">]><VTKFile>&b;</VTKFile>'
    refused(laughs.encode(encoding), "u.vtu", "entities")


BOMBS = {
    "deep": (b"<VTKFile>" + b"<a>" * 1_000_000 + b"</a>" * 1_000_000 + b"</VTKFile>", "more than 100000"),
    "not quite as deep": (b"<VTKFile>" + b"<a>" * 40_000 + b"</a>" * 40_000 + b"</VTKFile>", "levels deep"),
    "wide": (b"<VTKFile>" + b"<a/>" * 1_000_000 + b"</VTKFile>", "more than 100000 elements"),
    "many attributes": (b"<VTKFile " + b"".join(b"a%d='' " % k for k in range(500_000)) + b"/>", "attributes"),
    "entities": (b'<!DOCTYPE a [<!ENTITY b "c">]><VTKFile>&b;</VTKFile>', "or entities: save it again"),
}


@pytest.mark.parametrize("name", BOMBS)
def test_a_bomb_is_refused(name: str) -> None:
    data, match = BOMBS[name]
    check_bomb_is_refused(data, "u.vtu", match)
