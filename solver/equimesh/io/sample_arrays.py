"""Arrays of samples in files that are read part by part: zarr, HDF5, npy and npz."""

import socket
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from equimesh.errors import InputError, SamplesError
from equimesh.numerics.types import Array

HDF5_SUFFIXES: Final = (".h5", ".hdf5", ".hdf")
# What a file is called whose arrays can be read part by part.
SUFFIXES: Final = (".zarr", *HDF5_SUFFIXES, ".npy", ".npz")
# The name of the only array of a file that has no names.
ONLY: Final = "values"
# The part of a zip's local header before the name, and where it holds the lengths of the name and of the extra field.
ZIP_HEADER_BYTES: Final = 30
ZIP_NAME_LENGTH: Final = slice(26, 28)
ZIP_EXTRA_LENGTH: Final = slice(28, 30)
# What goes wrong in the libraries of the files: missing filters, damaged chunks, files that are cut off.
FAILURES: Final = (OSError, ValueError, KeyError, TypeError, RuntimeError, EOFError, zipfile.BadZipFile)


@dataclass(frozen=True, kw_only=True, eq=False)
class SampleArray:
    """One array of a file: its ``shape``, and ``chunk``, the shape of what is read from the file at a time."""

    name: str
    path: Path
    shape: tuple[int, ...]
    chunk: tuple[int, ...]
    _stored: Any

    def read(self, *where: slice) -> Array:
        """A part of the array in double precision.

        Raises :class:`~equimesh.errors.SamplesError` where the file cannot be read.
        """
        try:
            with np.errstate(over="ignore", invalid="ignore"):
                return np.array(self._stored[where], dtype=np.float64, order="C")
        except FAILURES as error:
            ranges = ", ".join(f"{part.start}:{part.stop}" for part in where)
            raise SamplesError(f"{self.name}[{ranges}] of {self.path} cannot be read: {_reason(error)}") from error


def open_arrays(path: Path) -> Mapping[str, Any]:
    """The arrays of a file by their names, none of them read; the only one of a file without names is ``values``.

    Raises :class:`~equimesh.errors.SamplesError` where this machine has no such file, or cannot read it.
    """
    if not path.exists():
        raise SamplesError(
            f"there is no file {path} on {socket.gethostname()}: check its name; on a cluster it must be in a folder"
            " that all workers reach by the same name",
            field="path",
        )
    try:
        return _opener(path)(path)
    except SamplesError:
        raise
    except InputError as error:  # a library that is not installed
        raise SamplesError(str(error), field="path") from error
    except FAILURES as error:
        raise SamplesError(
            f"{path} cannot be read on {socket.gethostname()}: {_reason(error)}", field="path"
        ) from error


def array_of(arrays: Mapping[str, Any], name: str, path: Path, *, ndim: int) -> SampleArray:
    """One of the arrays of a file.

    Raises :class:`~equimesh.errors.SamplesError` where there is none of this name, or it holds no real numbers in
    ``ndim`` dimensions.
    """
    stored = arrays.get(name)
    if stored is None or not hasattr(stored, "dtype") or not hasattr(stored, "shape"):
        known = ", ".join(sorted(map(str, arrays))[:10]) or "none"
        raise SamplesError(f"{path.name} has no array {name!r}; it has {known}", field=name)
    if getattr(stored.dtype, "kind", "") not in "iuf":
        raise SamplesError(f"{name} of {path.name} holds {stored.dtype}: only real numbers are allowed", field=name)
    if len(stored.shape) != ndim:
        raise SamplesError(
            f"{name} of {path.name} has shape {stored.shape}: it must have {ndim} dimensions", field=name
        )
    chunk = getattr(stored, "chunks", None) or (1, *stored.shape[1:])
    return SampleArray(name=name, path=path, shape=tuple(stored.shape), chunk=tuple(chunk), _stored=stored)


def _opener(path: Path) -> Callable[[Path], Mapping[str, Any]]:
    if path.is_dir():
        return _open_zarr
    suffix = path.suffix.lower()
    if suffix in HDF5_SUFFIXES:
        import h5py

        return lambda file: h5py.File(file, "r", locking=False)
    if suffix == ".npy":
        return lambda file: {ONLY: np.load(file, mmap_mode="r", allow_pickle=False)}
    if suffix == ".npz":
        return _open_npz
    raise SamplesError(
        f"{path.name!r} cannot be read in parts: its suffix must be one of {', '.join(SUFFIXES)}", field="path"
    )


def _open_zarr(path: Path) -> Mapping[str, Any]:
    zarr = import_zarr()
    found = zarr.open(path, mode="r")
    return {ONLY: found} if isinstance(found, zarr.Array) else dict(found.arrays())


def _open_npz(path: Path) -> Mapping[str, Any]:
    """The arrays of an npz, mapped into memory."""
    found: dict[str, Any] = {}
    with zipfile.ZipFile(path) as archive, path.open("rb") as file:
        for member in archive.infolist():
            name = member.filename.removesuffix(".npy")
            if member.compress_type != zipfile.ZIP_STORED:
                raise SamplesError(
                    f"{name} in {path.name} is compressed, so it cannot be read in parts: write the file with"
                    " numpy.savez, or as zarr or HDF5",
                    field="path",
                )
            file.seek(member.header_offset)
            header = file.read(ZIP_HEADER_BYTES)
            name_bytes, extra_bytes = (
                int.from_bytes(header[part], "little") for part in (ZIP_NAME_LENGTH, ZIP_EXTRA_LENGTH)
            )
            file.seek(name_bytes + extra_bytes, 1)
            found[name] = _map_npy(path, file)
    return found


def _map_npy(path: Path, file: Any) -> Any:
    """The array of the npy file that begins here."""
    version = np.lib.format.read_magic(file)
    read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, is_fortran, dtype = read_header(file)
    if dtype.hasobject:
        return np.empty(shape, dtype=object)  # refused by its type
    return np.memmap(path, dtype, "r", offset=file.tell(), shape=shape, order="F" if is_fortran else "C")


def _reason(error: BaseException) -> str:
    return f"{type(error).__name__}: {str(error)[:200]}"


def import_zarr() -> Any:
    """The library zarr; raises :class:`~equimesh.errors.InputError` where it is not installed."""
    try:
        import zarr
    except ImportError as error:
        raise InputError(
            "zarr is not installed: pip install 'equimesh[dask]', or choose another format", field="format"
        ) from error
    return zarr
