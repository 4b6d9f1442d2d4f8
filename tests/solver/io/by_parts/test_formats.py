"""The table of formats, and the format that a name has."""

from __future__ import annotations

import pytest

from equimesh.errors import InputError
from equimesh.io import PARTED_FORMATS
from equimesh.io.by_parts.formats import parted_format


def test_every_format_has_a_name_of_its_own() -> None:
    assert [*PARTED_FORMATS] == ["pvts", "pvtu", "xdmf", "vtkhdf", "zarr"]
    for name, kind in PARTED_FORMATS.items():
        assert kind.name == name
        assert kind.readers
        assert kind.sides
        assert bool(kind.part_suffix) is bool(kind.part_media_type)
        assert parted_format(f"folder/mesh{kind.suffix}") is kind
        assert parted_format(f"mesh{kind.suffix}", name) is kind
    of_parts = [kind.part_suffix for kind in PARTED_FORMATS.values()]
    assert len({*of_parts}) == len(of_parts)  # in one folder


def test_other_names_are_refused() -> None:
    for path, name in (
        ("mesh.vts", None),
        (".zarr", None),
        ("mesh", None),
        ("mesh.pvts", "pvtu"),
        ("mesh.pvts", "npz"),
    ):
        with pytest.raises(InputError):
            parted_format(path, name)
