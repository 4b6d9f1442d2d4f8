"""Unstructured grids in parts: cells by the nodes of their part, numbers in the whole mesh, and the sides."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from equimesh.io.by_parts.pvtu import corners
from equimesh.io.by_parts.read_xml import Piece
from equimesh.io.write import node_groups
from solver.io.by_parts.parted import CUTS, DATA, N_ETA, parts_of, written


@pytest.mark.parametrize("cuts", CUTS, ids=str)
def test_cells_join_to_the_whole_mesh(tmp_path: Path, cuts: tuple[int, ...]) -> None:
    written(tmp_path, "pvtu", cuts)
    found = []
    for part in parts_of(cuts):
        piece = Piece.of(tmp_path / "mesh" / f"part-000{part.number}.vtu")
        count = len(part.cells)
        (attributes,) = (element.attrib for element in piece.text.iterfind(".//Piece"))
        assert attributes == {"NumberOfPoints": str(part.x.size), "NumberOfCells": str(count)}
        ids = piece.array("PointData", "GlobalNodeIds", (part.x.size,))
        cells = piece.array("Cells", "connectivity", (count, 4))
        np.testing.assert_array_equal(cells, part.cells)
        np.testing.assert_array_equal(piece.array("Cells", "offsets", (count,)), 4 * np.arange(1, count + 1))
        assert np.all(piece.array("Cells", "types", (count,)) == 9)
        np.testing.assert_array_equal(piece.array("Points", "Points", (part.x.size, 3))[:, :2], DATA.mesh.points[ids])
        np.testing.assert_array_equal(piece.array("PointData", "node_groups", ids.shape), node_groups(DATA)[ids])
        found.append(ids[cells])
    np.testing.assert_array_equal(np.concatenate(found), DATA.mesh.cells)


def test_corners_are_counter_clockwise() -> None:
    assert corners(1, 2, N_ETA, np.int32)[0].tolist() == [N_ETA, 2 * N_ETA, 2 * N_ETA + 1, N_ETA + 1]
    assert corners(0, 0, N_ETA, np.int64).shape == (0, 4)
