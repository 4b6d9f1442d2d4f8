"""VTKHDF by virtual datasets: one grid with every node once, cells by the numbers of the whole mesh."""

from __future__ import annotations

import pickle
from pathlib import Path

import h5py
import numpy as np
import pytest

from cluster_package.part_files.parted import ARRAYS, CUTS, DATA, subdomains, written
from equimesh.io.write import node_groups
from equimesh_cluster.part_files.vtkhdf import FlatDatasets, Source, add_virtual, create


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


def test_rows_of_several_files_are_one_dataset(tmp_path: Path) -> None:
    for number, rows in enumerate((2, 3)):
        with create(tmp_path / f"{number}.h5") as file:
            file["a/u"] = np.full((rows, 4), float(number))
    sources = [Source(file="0.h5", first=0, last=2), Source(file="1.h5", first=2, last=5)]
    with create(tmp_path / "head.h5") as file:
        add_virtual(file, "a/u", (5, 4), np.float64, sources)
    with h5py.File(tmp_path / "head.h5") as file:
        assert file["a/u"].is_virtual
        np.testing.assert_array_equal(file["a/u"][:, 1], [0, 0, 1, 1, 1])
    (tmp_path / "0.h5").unlink()
    with h5py.File(tmp_path / "head.h5") as file:
        np.testing.assert_array_equal(file["a/u"][:, 1], [np.nan, np.nan, 1, 1, 1])


def test_old_libraries_can_read_the_files(tmp_path: Path) -> None:
    with create(tmp_path / "a.h5") as file:
        assert file.libver == ("v110", "v110")


def test_rows_are_read_by_a_copy_in_another_process(tmp_path: Path) -> None:
    rows = FlatDatasets.of(written(tmp_path, "vtkhdf", CUTS[1]))
    copy = pickle.loads(pickle.dumps(rows))
    np.testing.assert_array_equal(copy.rows("y", 40, 42), ARRAYS["y"][40:42])
    assert copy.parted.cuts == CUTS[1]
