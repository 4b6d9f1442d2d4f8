"""Medit files, read back by meshio."""

from __future__ import annotations

from pathlib import Path

import meshio
import numpy as np
import pytest

from equimesh.io.write import Cells
from equimesh.meshes.mesh import SIDES
from solver.io.files import DATA, KINDS, N_ETA, N_XI, check_cells, check_edges, per_cell, written


@pytest.mark.parametrize("kind", KINDS)
def test_medit(tmp_path: Path, kind: Cells) -> None:
    path = written(tmp_path, "medit", kind)
    found = meshio.medit.read(path)
    np.testing.assert_array_equal(found.points, DATA.mesh.points)
    assert [block.type for block in found.cells] == ["line", kind]
    edges, labels = found.cells[0].data, found.cell_data["medit:ref"][0]
    for number, side in enumerate(SIDES, start=1):
        check_edges(found.points, edges[labels == number], side)
    check_cells(found.points, found.cells[1].data, kind)
    np.testing.assert_array_equal(found.cell_data["medit:ref"][1], 1 + per_cell(DATA.subdomain, kind))
    inside = found.point_data["medit:ref"].reshape(N_XI, N_ETA)[1:-1, 1:-1]
    assert not inside.any()
    assert np.count_nonzero(found.point_data["medit:ref"]) == N_XI * N_ETA - inside.size
    assert "float64" not in path.read_text(encoding="ascii")
