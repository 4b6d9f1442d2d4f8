"""u as a smooth function through samples in a file, of which every process reads what it needs."""

from __future__ import annotations

import os
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from equimesh.domains.domain import Box
from equimesh.errors import SamplesError
from equimesh.fields.sample_scan import Scan, scan
from equimesh.fields.samples import RequestedBox, check_reach, checked_axis, ends_of
from equimesh.fields.tiles import Tiles
from equimesh.inputs import real_array
from equimesh.io.sample_arrays import SampleArray, array_of, open_arrays
from equimesh.numerics.types import Array

# The most bytes of splines that a process keeps; it computes others again.
MAX_BYTES: Final = 4 << 30
# What an object keeps for itself when it goes to another process.
OWN: Final = ("_lock", "_opened")


@dataclass(frozen=True, kw_only=True, eq=False)
class Opened:
    """The file as one process has it open."""

    process: int
    axes: tuple[Array, Array]
    values: SampleArray
    tiles: Tiles


class ChunkedSamples:
    """u as the bicubic spline through samples on a rectilinear grid that are in a file, read part by part.

    ``path`` is a zarr group or array, an HDF5 file (``.h5``, ``.hdf5``, ``.hdf``), an ``.npz`` that is not compressed,
    or an ``.npy``. ``values`` is the name of the array of shape ``(nx, ny)`` in it: u at ``(x[i], y[j])``. ``x`` and
    ``y`` are names of arrays in the file, or the axes themselves. By default they are the arrays ``x`` and ``y`` of the
    file; where it has none, they are uniform on ``box``, the domain's, which they must cover.

    Values and derivatives are those of :class:`~equimesh.GridSamples` of all samples, to 3e-14 of their size. Samples
    are read in tiles of 513 x 513 with 32 more on every side, when a point lies in the tile. A process keeps the
    splines of at most ``max_bytes``, at 8 bytes a sample; give it more where it evaluates more of u again and again.

    Where the object is made, all samples are read once, block by block, and checked. To another process goes the path:
    each opens the file by itself, so ``path`` must be in a folder that all of them reach by the same name.

    Implements :class:`~equimesh.fields.field.Field`. Raises :class:`~equimesh.errors.SamplesError`, which names the
    first bad index in the whole array, also from :meth:`evaluate` where a file cannot be read any more.
    """

    path: Path
    box: Box
    found: Scan

    def __init__(
        self,
        *,
        path: str | os.PathLike[str],
        x: str | npt.ArrayLike | None = None,
        y: str | npt.ArrayLike | None = None,
        values: str = "values",
        box: Box | None = None,
        max_bytes: int = MAX_BYTES,
    ) -> None:
        requested = RequestedBox.of(box)
        self.path, self.box, self.max_bytes = Path(os.path.abspath(path)), requested.box, max_bytes
        self._values = values
        self._axes: tuple[str | Array | None, ...] = tuple(
            axis if axis is None or isinstance(axis, str) else real_array(axis, name, ndim=1)
            for axis, name in ((x, "x"), (y, "y"))
        )
        self._shape: tuple[int, ...] | None = None
        self._lock, self._opened = threading.Lock(), None
        opened = self._open()
        for number, (name, axis) in enumerate(zip("xy", opened.axes, strict=True)):
            check_reach(axis, name, requested, number, ends_of(*opened.axes))
        self._shape, self._opened = opened.values.shape, opened
        self.found = scan(opened.values, *opened.axes)

    @property
    def x(self) -> Array:
        """The first axis."""
        return self._here().axes[0]

    @property
    def y(self) -> Array:
        """The second axis."""
        return self._here().axes[1]

    @property
    def shape(self) -> tuple[int, int]:
        """The numbers of samples along x and y."""
        n, m = self._here().values.shape
        return n, m

    @property
    def kept_bytes(self) -> int:
        """The bytes of the splines that this process has in memory."""
        return self._here().tiles.kept_bytes

    def read(self, rows: slice, columns: slice) -> Array:
        """A window of the samples."""
        return self._here().values.read(rows, columns)

    def evaluate(self, x: Array, y: Array, order: int = 0) -> tuple[Array, ...]:
        """u and its partial derivatives up to ``order``, each of the points' shape: see ``Field.evaluate``.

        Outside the samples the nearest point of their rectangle is used.
        """
        return self._here().tiles.evaluate(x, y, order)

    def _here(self) -> Opened:
        """The file as this process has it open; a process that was forked opens it again."""
        opened = self._opened
        if opened is not None and opened.process == os.getpid():
            return opened
        with self._lock:
            if self._opened is None or self._opened.process != os.getpid():
                self._opened = self._open()
            return self._opened

    def _open(self) -> Opened:
        arrays = open_arrays(self.path)
        values = array_of(arrays, self._values, self.path, ndim=2)
        if self._shape is not None and values.shape != self._shape:
            raise SamplesError(
                f"{self._values} of {self.path} has shape {values.shape} in this process, and had {self._shape}: the"
                " file has changed, or is another one on this machine",
                field="path",
            )
        axes = self._axis(arrays, values, 0), self._axis(arrays, values, 1)
        shape = axes[0].size, axes[1].size
        if values.shape != shape:
            hint = "; transpose it" if values.shape == shape[::-1] else ""
            raise SamplesError(
                f"{self._values} has shape {values.shape}, but x has {shape[0]} points and y has {shape[1]}:"
                f" values[i][j] is u at (x[i], y[j]), so the shape must be {shape}{hint}",
                field="values",
            )
        tiles = Tiles(axes, lambda rows, columns: values.read(rows, columns), self.max_bytes)
        return Opened(process=os.getpid(), axes=axes, values=values, tiles=tiles)

    def _axis(self, arrays: Any, values: SampleArray, number: int) -> Array:
        given, name = self._axes[number], "xy"[number]
        if isinstance(given, np.ndarray):
            return checked_axis(given, name)
        if given is None and not any(known in arrays for known in "xy"):
            return checked_axis(np.linspace(*self.box[number], values.shape[number]), name)
        stored = array_of(arrays, given or name, self.path, ndim=1)
        return checked_axis(stored.read(slice(0, stored.shape[0])), name)

    def __getstate__(self) -> dict[str, Any]:
        """The path, and what is known of all samples; no samples."""
        return {name: value for name, value in self.__dict__.items() if name not in OWN}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._lock, self._opened = threading.Lock(), None

    def __repr__(self) -> str:
        return f"ChunkedSamples({self.path.name})"
