"""SU2 files, read back by meshio and by a plain reading of their text."""

from __future__ import annotations

import re
from pathlib import Path

import meshio
import numpy as np
import pytest

from equimesh.io.write import Cells
from equimesh.meshes.mesh import SIDES
from solver.io.files import DATA, EDGES, KINDS, check_cells, check_edges, written


@pytest.mark.parametrize("kind", KINDS)
def test_su2(tmp_path: Path, kind: Cells) -> None:
    text = written(tmp_path, "su2", kind).read_text(encoding="ascii")
    found = meshio.su2.read(tmp_path / "mesh.su2")
    np.testing.assert_array_equal(found.points, DATA.mesh.points)
    cells = next(block.data for block in found.cells if block.type == kind)
    check_cells(found.points, cells, kind)
    markers = dict(re.findall(r"^MARKER_TAG= (\w+)\nMARKER_ELEMS= (\d+)$", text, re.MULTILINE))
    assert {side: int(count) for side, count in markers.items()} == EDGES
    for side in SIDES:
        body = text.split(f"MARKER_TAG= {side}\n")[1].split("\n", 1)[1].split("MARKER_TAG")[0]
        rows = np.array([line.split() for line in body.splitlines()], dtype=int)
        assert np.all(rows[:, 0] == 3)
        check_edges(DATA.mesh.points, rows[:, 1:], side)
    assert text.startswith("NDIME= 2\nNELEM= ")
    assert "float64" not in text
