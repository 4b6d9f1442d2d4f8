"""Structured grids in parts: extents that share a row, i along xi, and the text of the head."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np

from equimesh.io.by_parts.read_xml import Piece
from solver.io.by_parts.parted import ARRAYS, CUTS, N_ETA, N_XI, written


def test_pieces_share_the_rows_between_them(tmp_path: Path) -> None:
    head = written(tmp_path, "pvts", CUTS[1])
    grid = ET.parse(head).getroot().find("PStructuredGrid")
    assert grid is not None
    assert grid.attrib["WholeExtent"] == f"0 {N_XI - 1} 0 {N_ETA - 1} 0 0"
    pieces = grid.findall("Piece")
    assert [piece.attrib["Source"] for piece in pieces] == [f"mesh/part-000{k}.vts" for k in range(3)]
    extents = [piece.attrib["Extent"] for piece in pieces]
    assert extents == [f"{a} {b} 0 {N_ETA - 1} 0 0" for a, b in ((0, 33), (33, 41), (41, N_XI - 1))]
    names = {section.tag: [array.attrib["Name"] for array in section] for section in grid if section.tag != "Piece"}
    assert names == {"PPointData": ["u", "v"], "PCellData": ["Q_eq", "subdomain"], "PPoints": ["Points"]}
    for extent, source in zip(extents, pieces, strict=True):
        piece = Piece.of(tmp_path / source.attrib["Source"])
        (found,) = piece.text.iterfind(".//Piece")
        assert found.attrib["Extent"] == extent


def test_i_runs_along_xi_and_fastest(tmp_path: Path) -> None:
    written(tmp_path, "pvts", CUTS[1])
    piece = Piece.of(tmp_path / "mesh" / "part-0001.vts")
    points = piece.array("Points", "Points", (N_ETA, 9, 3))
    np.testing.assert_array_equal(points[:, :, 0], ARRAYS["x"][33:42].T)
    np.testing.assert_array_equal(points[:, :, 1], ARRAYS["y"][33:42].T)
    assert not points[:, :, 2].any()
    np.testing.assert_array_equal(piece.array("PointData", "v", (N_ETA, 9)), ARRAYS["v"][33:42].T)
    np.testing.assert_array_equal(piece.array("CellData", "Q_eq", (N_ETA - 1, 8)), ARRAYS["Q_eq"][33:41].T)
    assert np.all(piece.array("CellData", "subdomain", (N_ETA - 1, 8)) == 1)
