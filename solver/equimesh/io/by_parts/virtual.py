"""HDF5 files that show the datasets of other files as one: virtual datasets."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
import numpy.typing as npt

# The format of the files. What HDF5 writes as "latest" has a heap that the HDF5 library of VTK refuses.
LIBRARY = ("v110", "v110")


@dataclass(frozen=True, kw_only=True)
class Source:
    """Rows of a dataset in the file ``file``, named relative to the head; they become ``first`` to ``last - 1``."""

    file: str
    first: int
    last: int


def add_virtual(
    file: h5py.File, name: str, shape: tuple[int, ...], dtype: npt.DTypeLike, sources: Sequence[Source]
) -> None:
    """Add the dataset ``name`` of the sources, which all have it by the same name, and nothing else in its rows.

    Where a file is missing, numbers are NaN, and whole numbers 0.
    """
    layout = h5py.VirtualLayout(shape=shape, dtype=dtype)
    for source in sources:
        rows = source.last - source.first
        if rows:
            layout[source.first : source.last] = h5py.VirtualSource(
                source.file, name, shape=(rows, *shape[1:]), dtype=dtype
            )
    file.create_virtual_dataset(name, layout, fillvalue=np.nan if np.dtype(dtype).kind == "f" else 0)


def create(path: Path) -> h5py.File:
    """A new HDF5 file that old libraries can read."""
    return h5py.File(path, "w", libver=LIBRARY)
