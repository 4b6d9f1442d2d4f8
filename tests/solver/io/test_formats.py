"""The table of mesh formats."""

from __future__ import annotations

import re

import pytest

import equimesh.io
from equimesh.io.formats import FORMATS
from equimesh_schema.mesh import SUFFIXES


def test_each_format_is_described() -> None:
    spectral = ["hohqmesh", "re2", "nmsh", "specfem"]
    older = ["vtu", "vtk", "vts", "vtm", "hdf", "xdmf", "msh", "medit", "su2", "abaqus"]
    assert list(FORMATS) == [*older, *spectral, "p3d", "foam", "npz"]
    for name, known in FORMATS.items():
        assert known.name == name
        assert known.suffix.startswith(".")
        assert re.fullmatch(r"[a-z]+/[a-z0-9.+-]+", known.media_type)
        assert len(known.description) > 20
    assert len({known.media_type for known in FORMATS.values()}) == len(FORMATS)


def test_clients_know_each_format_by_its_suffix() -> None:
    assert {known.suffix: name for name, known in FORMATS.items()}.items() <= SUFFIXES.items()
    assert {*SUFFIXES.values()} == {*FORMATS}


def test_names_of_files_in_parts_say_where_they_are() -> None:
    with pytest.raises(ImportError, match=r"equimesh\.io\.write_part is equimesh_cluster\.write_part now"):
        from equimesh.io import write_part  # noqa: F401
    with pytest.raises(AttributeError, match="no attribute 'write_parts'"):
        _ = equimesh.io.write_parts
