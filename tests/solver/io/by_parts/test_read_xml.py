"""Pieces with raw appended data: what is not one is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from equimesh.io.by_parts.read_xml import Piece, StructuredParts, UnstructuredParts
from solver.io.by_parts.parted import ARRAYS, CUTS, written


def test_arrays_are_mapped_and_named(tmp_path: Path) -> None:
    written(tmp_path, "pvtu", CUTS[1])
    piece = Piece.of(tmp_path / "mesh" / "part-0002.vtu")
    assert piece.names("PointData") == ("u", "v", "node_groups", "GlobalNodeIds")
    rows = ARRAYS["u"][41:]
    found = piece.array("PointData", "u", rows.shape)
    assert isinstance(found, np.memmap)
    np.testing.assert_array_equal(found, rows)
    with pytest.raises(KeyError, match="w"):
        piece.array("PointData", "w", rows.shape)


def test_other_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.vtu"
    path.write_text('<VTKFile type="UnstructuredGrid"><UnstructuredGrid/></VTKFile>')
    with pytest.raises(ValueError, match="no raw appended data"):
        Piece.of(path)
    with pytest.raises(ValueError, match="no PStructuredGrid"):
        StructuredParts.of(path)
    with pytest.raises(IndexError):
        UnstructuredParts.of(path)
