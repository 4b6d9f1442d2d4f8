"""npz files: every array as it was, and refusals of what is no mesh."""

from __future__ import annotations

import zipfile
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from equimesh.errors import InputError
from equimesh.io import npz
from equimesh.io.npz import load_npz, npz_bytes, save_npz
from equimesh.io.write import Cells, write_mesh
from equimesh.meshes.mesh import SIDES
from solver.io.files import DATA, KINDS, check_cells, check_edges, per_cell, written


@pytest.mark.parametrize("kind", KINDS)
def test_npz(tmp_path: Path, kind: Cells) -> None:
    path = written(tmp_path, "npz", kind)
    with np.load(path, allow_pickle=False) as arrays:
        assert set(arrays) == {"x", "y", "u", "cells", "q_eq", "subdomain", *SIDES}
        check_cells(DATA.mesh.points, arrays["cells"], kind)
        np.testing.assert_array_equal(arrays["q_eq"], per_cell(DATA.q_eq, kind))
        np.testing.assert_array_equal(arrays["subdomain"], per_cell(DATA.subdomain, kind))
        for side in SIDES:
            check_edges(DATA.mesh.points, arrays[side], side)
    again = load_npz(path)
    pairs = [(again.mesh.x, DATA.mesh.x), (again.mesh.y, DATA.mesh.y)]
    pairs += [(getattr(again, name), getattr(DATA, name)) for name in ("u", "q_eq", "subdomain")]
    for found, expected in pairs:
        assert found.dtype == expected.dtype
        assert found.tobytes() == expected.tobytes()
        assert found.shape == expected.shape


@pytest.mark.parametrize("kind", KINDS)
def test_fields_vectors_and_the_json_of_a_step(tmp_path: Path, kind: Cells) -> None:
    x = DATA.mesh.x
    fields = {"p": x + 1, "velocity": np.stack([x, -x], axis=-1)}
    cell_fields = {"rho": x[1:, 1:], "flux": np.stack([x[1:, 1:]] * 4, axis=-1)}
    data = replace(DATA, fields=fields, cell_fields=cell_fields, step='{"status": "succeeded"}')
    again = load_npz(write_mesh(tmp_path / "mesh.npz", data, cells=kind)[0])
    assert again.step == data.step
    for found, expected in ((again.fields, fields), (again.cell_fields, cell_fields)):
        assert [*found] == [*expected]
        for name, values in expected.items():
            np.testing.assert_array_equal(found[name], values)


def test_files_that_are_no_result(tmp_path: Path) -> None:
    path = tmp_path / "mesh.npz"
    for content in (b"", b"text", b"PK\x03\x04 broken"):
        path.write_bytes(content)
        with pytest.raises(InputError, match=r"mesh\.npz is not a mesh"):
            load_npz(path)
    for arrays in ({"x": np.ones(3)}, {n: np.ones((4, 4)) for n in ("x", "y", "u", "cells", "q_eq", "subdomain")}):
        np.savez(path, **arrays)
        with pytest.raises(InputError, match=r"mesh\.npz is not a mesh"):
            load_npz(path)
    np.savez(path, x=np.array([{}], dtype=object))
    with pytest.raises(InputError, match=r"mesh\.npz is not a mesh"):
        load_npz(path)
    with pytest.raises(FileNotFoundError):
        load_npz(tmp_path / "missing.npz")


TABLE = np.arange(12.0).reshape(3, 4)
ARRAYS = {
    "x": TABLE,
    "turned": TABLE.T,
    "every second": TABLE[:, ::2].astype(np.float32),
    "sides/gr\u00fcn": np.zeros((0, 2), np.int64),
    "flags": TABLE > 3,
    "one": np.array(3.0),
    "bytes": np.frombuffer(b"abc", np.uint8),
    "text": np.array("h\u00e9"),
}


def test_bytes_made_in_memory_are_read_by_others() -> None:
    data = npz_bytes(ARRAYS)
    with zipfile.ZipFile(BytesIO(data)) as archive:
        assert archive.testzip() is None
        assert archive.namelist() == [f"{name}.npy" for name in ARRAYS]
        assert {member.date_time for member in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}
    with np.load(BytesIO(data), allow_pickle=False) as found:
        assert list(found) == list(ARRAYS)
        for name, values in ARRAYS.items():
            assert found[name].dtype == np.asarray(values).dtype
            assert found[name].shape == np.shape(values)
            np.testing.assert_array_equal(found[name], values)


def test_equal_arrays_have_equal_bytes() -> None:
    others = {name: np.array(values, order="F") for name, values in ARRAYS.items()}
    assert npz_bytes(others) == npz_bytes(ARRAYS)
    assert npz_bytes({**ARRAYS, "one": np.array(4.0)}) != npz_bytes(ARRAYS)


def test_small_and_large_files_have_the_same_arrays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    small = dict(np.load(write_mesh(tmp_path / "small.npz", DATA)[0]))
    monkeypatch.setattr("equimesh.io.write.MAX_POINTS_IN_MEMORY", 0)
    large = dict(np.load(write_mesh(tmp_path / "large.npz", DATA)[0]))
    assert list(small) == list(large)
    for name, values in small.items():
        assert values.dtype == large[name].dtype
        np.testing.assert_array_equal(values, large[name])


def test_what_the_format_cannot_hold(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ValueError, match="cannot hold object"):
        npz_bytes({"x": np.array([{}], dtype=object)})
    ordinary = npz_bytes(ARRAYS)
    monkeypatch.setattr(npz, "MAX_BYTES", 99)
    large = npz_bytes(ARRAYS)
    assert large != ordinary, "more than 4 GB need the other form of a zip file"
    with np.load(BytesIO(large), allow_pickle=False) as found:
        assert {name: values.tolist() for name, values in found.items()} == {
            name: np.asarray(values).tolist() for name, values in ARRAYS.items()
        }


@pytest.mark.parametrize(
    "arrays",
    [
        {"x": np.arange(5.0), "y": np.arange(3.0), "values": np.ones((5, 3))},
        {"values": np.asfortranarray(np.arange(15.0).reshape(5, 3))},
        {"points": np.arange(14.0).reshape(7, 2)[::2], "values": np.ones(4)},
        {"values": np.empty((0, 2))},
    ],
)
def test_samples_are_saved_in_the_bytes_of_numpy(arrays: dict[str, npt.NDArray[np.float64]]) -> None:
    ours, numpys = BytesIO(), BytesIO()
    save_npz(ours, arrays)
    np.savez(numpys, **arrays)  # type: ignore[arg-type]
    assert ours.getvalue() == numpys.getvalue()
