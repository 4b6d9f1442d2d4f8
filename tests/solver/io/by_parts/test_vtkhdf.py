"""VTKHDF by virtual datasets: one grid with every node once, cells by the numbers of the whole mesh."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

from equimesh.io.write import node_groups
from solver.io.by_parts.parted import ARRAYS, CUTS, DATA, subdomains, written


@pytest.mark.parametrize("cuts", CUTS, ids=str)
def test_h5py_reads_one_grid(tmp_path: Path, cuts: tuple[int, ...]) -> None:
    with h5py.File(written(tmp_path, "vtkhdf", cuts)) as file:
        root = file["VTKHDF"]
        assert (root.attrs["Type"], root.attrs["Version"].tolist()) == (b"UnstructuredGrid", [1, 0])
        grid = DATA.mesh.grid
        counts = [root[f"NumberOf{name}"][:].tolist() for name in ("Points", "Cells", "ConnectivityIds")]
        assert counts == [[grid.points], [grid.cells], [4 * grid.cells]]
        np.testing.assert_array_equal(root["Points"][:, :2], DATA.mesh.points)
        assert not root["Points"][:, 2].any()
        np.testing.assert_array_equal(root["Connectivity"][:].reshape(-1, 4), DATA.mesh.cells)
        np.testing.assert_array_equal(root["Offsets"][:], 4 * np.arange(grid.cells + 1))
        assert np.all(root["Types"][:] == 9)
        for name in ("u", "v"):
            np.testing.assert_array_equal(root[f"PointData/{name}"][:], ARRAYS[name].ravel())
        np.testing.assert_array_equal(root["PointData/node_groups"][:], node_groups(DATA))
        np.testing.assert_array_equal(root["CellData/Q_eq"][:], ARRAYS["Q_eq"].ravel())
        np.testing.assert_array_equal(root["CellData/subdomain"][:], subdomains(cuts).ravel())
