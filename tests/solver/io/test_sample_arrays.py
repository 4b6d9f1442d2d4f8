"""Arrays of samples in files, read part by part: every kind of file, and what cannot be read so."""

from __future__ import annotations

import json
import socket
from pathlib import Path

import h5py
import numpy as np
import pytest
import zarr

from equimesh.errors import SamplesError
from equimesh.io.sample_arrays import array_of, open_arrays

VALUES = np.random.default_rng(4).standard_normal((30, 20))
NAMES = ("u.zarr", "u.h5", "u.npz", "u.npy")


def write(path: Path, values: np.ndarray) -> Path:
    if path.suffix == ".zarr":
        zarr.create_group(path).create_array("values", data=values, chunks=(7, 9))
    elif path.suffix == ".h5":
        with h5py.File(path, "w") as file:
            file.create_dataset("values", data=values, chunks=(7, 9), compression="gzip")
    elif path.suffix == ".npz":
        np.savez(path, x=np.arange(3.0), values=values)
    else:
        np.save(path, values)
    return path


@pytest.mark.parametrize("name", NAMES)
def test_a_part_is_read_in_double_precision(tmp_path: Path, name: str) -> None:
    for kind in ("<f8", ">f8", "<f4", "i2", "u1"):
        values = (10 * VALUES).astype(kind)
        path = write(tmp_path / f"{np.dtype(kind).str.strip('<>|=')}{kind[0] == '>'}-{name}", values)
        found = array_of(open_arrays(path), "values", path, ndim=2)
        assert (found.shape, found.chunk) == ((30, 20), (7, 9) if name in NAMES[:2] else (1, 20))
        part = found.read(slice(3, 12), slice(8, 11))
        assert part.dtype == np.float64
        np.testing.assert_array_equal(part, values[3:12, 8:11].astype(np.float64))


def test_columns_first_is_read_too(tmp_path: Path) -> None:
    for path in (tmp_path / "u.npy", tmp_path / "u.npz"):
        write(path, np.asfortranarray(VALUES))
        found = array_of(open_arrays(path), "values", path, ndim=2)
        np.testing.assert_array_equal(found.read(slice(3, 12), slice(8, 11)), VALUES[3:12, 8:11])


def test_a_zarr_array_needs_no_group(tmp_path: Path) -> None:
    path = tmp_path / "u.zarr"
    zarr.create_array(path, data=VALUES, chunks=(8, 8))
    np.testing.assert_array_equal(
        array_of(open_arrays(path), "values", path, ndim=2).read(slice(0, 30), slice(0, 20)), VALUES
    )


def test_a_file_that_is_not_here_is_said_with_the_machine(tmp_path: Path) -> None:
    with pytest.raises(SamplesError, match=f"no file .*none.h5 on {socket.gethostname()}: .* all workers reach"):
        open_arrays(tmp_path / "none.h5")


def test_other_files_are_refused(tmp_path: Path) -> None:
    for name in ("u.h5", "u.npy", "u.npz"):
        (tmp_path / name).write_bytes(b"nothing of the kind")
        with pytest.raises(SamplesError, match=f"{name} cannot be read on"):
            open_arrays(tmp_path / name)
    (tmp_path / "u.zarr").mkdir()
    with pytest.raises(SamplesError, match=r"u.zarr cannot be read on"):
        open_arrays(tmp_path / "u.zarr")
    (tmp_path / "u.csv").write_text("1,2,3")
    with pytest.raises(SamplesError, match=r"its suffix must be one of .zarr, .h5"):
        open_arrays(tmp_path / "u.csv")


@pytest.mark.parametrize("name", NAMES)
def test_other_types_and_shapes_are_refused(tmp_path: Path, name: str) -> None:
    path = write(tmp_path / name, VALUES > 0)
    with pytest.raises(SamplesError, match=r"values of .* holds bool: only real numbers are allowed"):
        array_of(open_arrays(path), "values", path, ndim=2)
    with pytest.raises(SamplesError, match="has no array 'w'; it has"):
        array_of(open_arrays(path), "w", path, ndim=2)
    other = write(tmp_path / f"other-{name}", VALUES)
    with pytest.raises(SamplesError, match=r"has shape \(30, 20\): it must have 1 dimensions"):
        array_of(open_arrays(other), "values", other, ndim=1)


def test_objects_are_never_loaded(tmp_path: Path) -> None:
    np.savez(tmp_path / "u.npz", values=np.array([[{}]], dtype=object))
    with pytest.raises(SamplesError, match="holds object: only real numbers"):
        array_of(open_arrays(tmp_path / "u.npz"), "values", tmp_path / "u.npz", ndim=2)
    np.save(tmp_path / "u.npy", np.array([[{}]], dtype=object))
    with pytest.raises(SamplesError, match="cannot be read"):
        open_arrays(tmp_path / "u.npy")


def test_a_compressed_npz_is_refused_with_a_remedy(tmp_path: Path) -> None:
    np.savez_compressed(tmp_path / "u.npz", values=VALUES)
    with pytest.raises(SamplesError, match=r"values in u.npz is compressed, .* numpy.savez, or as zarr"):
        open_arrays(tmp_path / "u.npz")


def test_an_unknown_compression_of_zarr_is_said(tmp_path: Path) -> None:
    path = write(tmp_path / "u.zarr", VALUES)
    text = json.loads((path / "values" / "zarr.json").read_text())
    text["codecs"][-1] = {"name": "unheard_of", "configuration": {}}
    (path / "values" / "zarr.json").write_text(json.dumps(text))
    with pytest.raises(SamplesError, match="unheard_of"):
        array_of(open_arrays(path), "values", path, ndim=2)


def test_a_damaged_chunk_is_said_with_its_place(tmp_path: Path) -> None:
    path = write(tmp_path / "u.h5", VALUES)
    with h5py.File(path, "r+") as file:
        file["values"].id.write_direct_chunk((7, 9), b"not gzip")
    found = array_of(open_arrays(path), "values", path, ndim=2)
    np.testing.assert_array_equal(found.read(slice(0, 7), slice(0, 9)), VALUES[:7, :9])
    with pytest.raises(SamplesError, match=r"values\[5:9, 0:12\] of .*u.h5 cannot be read: OSError"):
        found.read(slice(5, 9), slice(0, 12))
