"""Virtual datasets: rows of several files as one, and NaN where a file is missing."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np

from equimesh.io.by_parts.virtual import Source, add_virtual, create


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
