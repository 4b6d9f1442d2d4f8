"""A mesh in parts is read back to the last bit, in every format, whole and row by row."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest

from cluster_package.part_files.parted import ARRAYS, CUTS, DATA, N_XI, parts_of, subdomains, written
from equimesh.errors import InputError
from equimesh_cluster import PARTED_FORMATS, read_parts
from equimesh_cluster.part_files.formats import part_path


@pytest.mark.parametrize("name", PARTED_FORMATS)
@pytest.mark.parametrize("cuts", CUTS, ids=lambda cuts: f"{len(cuts) + 1} parts")
def test_what_was_written_is_read(tmp_path: Path, name: str, cuts: tuple[int, ...]) -> None:
    mesh = read_parts(written(tmp_path, name, cuts))
    assert (mesh.grid, mesh.cuts, mesh.nodes, sorted(mesh.cells)) == (
        DATA.mesh.grid,
        cuts,
        ("u", "v"),
        ["Q_eq", "subdomain"],
    )
    for array, values in {**ARRAYS, "subdomain": subdomains(cuts)}.items():
        np.testing.assert_array_equal(mesh.rows(array, 0, len(values)), values)
        np.testing.assert_array_equal(mesh.rows(array, 30, 70), values[30:70])  # over several cuts
        assert mesh.rows(array, 5, 5).shape == (0, values.shape[1])
        for first, rows in mesh.blocks(array):
            np.testing.assert_array_equal(rows, values[first : first + len(rows)])
    copy = pickle.loads(pickle.dumps(mesh))  # as another process gets it
    np.testing.assert_array_equal(copy.rows("y", 40, 42), ARRAYS["y"][40:42])
    for number, expected in enumerate(parts_of(cuts)):
        part = mesh.part(number)
        assert (part.first, part.last, part.count) == (expected.first, expected.last, expected.count)
        np.testing.assert_array_equal(part.x, expected.x)
        np.testing.assert_array_equal(part.y, expected.y)


def test_blocks_are_parts_of_the_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = read_parts(written(tmp_path, "pvtu", CUTS[1]))
    monkeypatch.setattr("equimesh_cluster.part_files.parted_mesh.READ_NUMBERS", 10 * DATA.mesh.grid.n_eta)
    firsts = [first for first, _ in mesh.blocks("x")]
    assert firsts == [*range(0, N_XI, 10)]


@pytest.mark.parametrize("name", [name for name, kind in PARTED_FORMATS.items() if kind.part_suffix])
def test_a_missing_part_is_named(tmp_path: Path, name: str) -> None:
    head = written(tmp_path, name, CUTS[1])
    part_path(head, 1, PARTED_FORMATS[name]).unlink()
    with pytest.raises(InputError, match=r"part-0001|part 1 is not at"):
        read_parts(head)


def test_what_is_not_a_mesh_in_parts_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no file"):
        read_parts(tmp_path / "mesh.pvtu")
    for name, kind in PARTED_FORMATS.items():
        head = tmp_path / f"other{kind.suffix}"
        if name == "zarr":
            head.mkdir()
        else:
            head.write_text("<a/>")
        with pytest.raises(InputError, match="is not a mesh in parts"):
            read_parts(head)


def test_rows_that_there_are_not_are_refused(tmp_path: Path) -> None:
    mesh = read_parts(written(tmp_path, "vtkhdf", ()))
    for first, last in ((-1, 3), (3, 2), (0, N_XI + 1)):
        with pytest.raises(InputError, match="x has the rows 0 to 96"):
            mesh.rows("x", first, last)
    with pytest.raises(InputError, match="Q_eq has the rows 0 to 95"):
        mesh.rows("Q_eq", 0, N_XI)
    with pytest.raises(InputError, match="has no array 'w'; it has x, y, u, v, Q_eq, subdomain"):
        mesh.rows("w", 0, 1)
