"""A zarr group of all parts: chunks that several parts share, and what it says to xarray and Dask."""

from __future__ import annotations

import pickle
import sys
from pathlib import Path

import dask.array as da
import numpy as np
import pytest
import zarr

from cluster_package.part_files.parted import ARRAYS, CUTS, DATA, N_ETA, N_XI, data_of, parts_of, subdomains, written
from equimesh.errors import InputError
from equimesh_cluster import write_head, write_part
from equimesh_cluster.part_files import zarr_parts
from equimesh_cluster.part_files.zarr_parts import CHUNK_ROWS, Chunks, unfinished


@pytest.mark.parametrize("cuts", [*CUTS, (32, 64), (1, 2, 3, 31, 33, 95, 96)], ids=str)
def test_zarr_reads_one_group(tmp_path: Path, cuts: tuple[int, ...]) -> None:
    """Parts end where chunks end, inside of them, and several within one chunk."""
    head = written(tmp_path, "zarr", cuts)
    group = zarr.open_group(head, mode="r")
    for name, values in {**ARRAYS, "subdomain": subdomains(cuts)}.items():
        np.testing.assert_array_equal(group[name][:], values)
        in_cells = name in ("Q_eq", "subdomain")
        assert group[name].metadata.dimension_names == (("xi_cell", "eta_cell") if in_cells else ("xi", "eta"))
    np.testing.assert_array_equal(group["xi"][:], np.linspace(0, 1, N_XI))
    np.testing.assert_array_equal(group["eta"][:], np.linspace(0, 1, N_ETA))
    assert group.attrs["sides"] == {"left": {"xi": 0}, "right": {"xi": -1}, "bottom": {"eta": 0}, "top": {"eta": -1}}
    np.testing.assert_array_equal(da.from_zarr(head, component="u").compute(), ARRAYS["u"])
    assert [*tmp_path.iterdir()] == [head]
    assert "seams" not in {path.name for path in head.iterdir()}


def test_parts_leave_only_rows_of_chunks_that_they_share(tmp_path: Path) -> None:
    head = tmp_path / "mesh.zarr"
    for part in parts_of(CUTS[2]):
        write_part(head, part, data_of(part))
    with np.load(unfinished(head) / "seams" / "part-0002.npz") as file:  # of the rows 33 to 65
        assert {name: len(file[name]) for name in file.files if name.startswith("x ")} == {
            "x 1": 2 * CHUNK_ROWS - 33,
            "x 2": 66 - 2 * CHUNK_ROWS,
        }


def test_parts_of_another_mesh_are_refused(tmp_path: Path) -> None:
    head, cuts = tmp_path / "mesh.zarr", CUTS[1]
    for part in parts_of(cuts):
        write_part(head, part, data_of(part))
    with pytest.raises(InputError, match="have other arrays"):
        write_head(head, grid=DATA.mesh.grid, cuts=cuts, nodes=("u",), cells=("Q_eq",))
    with pytest.raises(InputError, match=r"part 1 below .* has other rows"):
        write_head(head, grid=DATA.mesh.grid, cuts=(33, 50), nodes=("u", "v"), cells=("Q_eq",))


def test_a_missing_zarr_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "zarr", None)
    with pytest.raises(InputError, match=r"zarr is not installed: pip install 'equimesh\[dask\]'"):
        zarr_parts.write_part(tmp_path / "mesh.zarr", parts_of(())[0], data_of(parts_of(())[0]))


def test_rows_are_read_by_a_copy_in_another_process(tmp_path: Path) -> None:
    rows = Chunks.of(written(tmp_path, "zarr", CUTS[1]))
    copy = pickle.loads(pickle.dumps(rows))
    np.testing.assert_array_equal(copy.rows("y", 40, 42), ARRAYS["y"][40:42])
    assert copy.parted.cuts == CUTS[1]
