"""u as a smooth function through samples in a file, of which every process reads what it needs."""

from __future__ import annotations

import os
import threading
from collections import OrderedDict
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NoReturn

import numpy as np
import numpy.typing as npt

from equimesh.domains.domain import Box
from equimesh.errors import SamplesError
from equimesh.fields.bicubic import COUNT, ORDER, Axis, Bicubic
from equimesh.fields.samples import (
    RequestedBox,
    bicubic_spline,
    check_reach,
    check_size,
    checked_axis,
    ends_of,
    slope_error,
)
from equimesh.formulas.vocabulary import LIMITS
from equimesh.inputs import real_array
from equimesh.io.sample_arrays import SampleArray, array_of, open_arrays
from equimesh.numerics.types import Array

# A bicubic spline through samples that are in a file, in tiles: each is computed when a point lies in it.
#
# A tile is a fixed rectangle of samples. Its spline goes through these samples and ``MARGIN`` more on every side. The
# influence of a sample falls to a quarter from one sample to the next, so this is the spline through all samples, up
# to rounding. Tiles depend on the shape of the samples alone. So the value at a point does not depend on other
# points, or on the process that evaluates it.

# Pieces of an axis in a tile.
TILE = 512
# Samples beyond a tile that its spline goes through, too. 24 leave an error of 3e-14.
MARGIN = 32

Read = Callable[[slice, slice], Array]
"""Returns a window of the samples."""


class Tiles:
    """The spline through samples on the axes ``x`` and ``y``, whose values ``read`` returns window by window.

    Splines of at most ``max_bytes`` are kept, those used last; one is always kept. Threads may share the object.
    """

    def __init__(self, axes: tuple[Array, Array], read: Read, max_bytes: int) -> None:
        self._axes, self._read, self._max_bytes = axes, read, max_bytes
        self._kept: OrderedDict[tuple[int, int], Bicubic] = OrderedDict()
        self._along: dict[tuple[int, int], Axis] = {}
        self._bytes = 0
        self._lock = threading.Lock()

    @property
    def kept_bytes(self) -> int:
        """The bytes of the splines that are in memory."""
        return self._bytes

    def evaluate(self, x: Array, y: Array, order: int = 0) -> tuple[Array, ...]:
        """The spline and its partial derivatives up to ``order``, each of the points' shape."""
        x, y = np.broadcast_arrays(np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64))
        values = np.empty((COUNT[order], *x.shape))
        rows, x, y = values.reshape(len(values), -1), x.ravel(), y.ravel()
        count = tile_count(self._axes[1].size)
        tiles = tile_of(self._axes[0], x) * count + tile_of(self._axes[1], y)
        for tile, points in _groups(tiles):
            spline = self._spline(*divmod(tile, count))
            if len(points) == x.size:
                rows[:] = spline.evaluate(x, y, order)
            else:
                rows[:, points] = spline.evaluate(x[points], y[points], order)
        return tuple(values)

    def _spline(self, i: int, j: int) -> Bicubic:
        with self._lock:
            spline = self._kept.pop((i, j), None)
            if spline is None:
                spline = self._compute(i, j)
                self._bytes += spline.coefficients.nbytes
            self._kept[i, j] = spline
            while self._bytes > self._max_bytes and len(self._kept) > 1:
                _, old = self._kept.popitem(last=False)
                self._bytes -= old.coefficients.nbytes
            return spline

    def _compute(self, i: int, j: int) -> Bicubic:
        """The spline of one tile, without the margin."""
        (rows, kept_x), (columns, kept_y) = (window(axis.size, k) for axis, k in zip(self._axes, (i, j), strict=True))
        values = self._read(rows, columns)
        bad = ~np.isfinite(values)
        if bad.any():
            a, b = np.unravel_index(int(bad.argmax()), bad.shape)
            raise not_finite(values[a, b], int(a) + rows.start, int(b) + columns.start)
        check_size(values)
        whole = bicubic_spline(self._axes[0][rows], self._axes[1][columns], values)
        knots_x, knots_y, coefficients = (np.asarray(part, dtype=float) for part in whole.tck)
        table = coefficients.reshape(len(knots_x) - ORDER, len(knots_y) - ORDER)
        inside_x, along_x = self._trimmed(0, i, knots_x, kept_x)
        inside_y, along_y = self._trimmed(1, j, knots_y, kept_y)
        return Bicubic(
            knots=(knots_x[inside_x[0]], knots_y[inside_y[0]]),
            along_x=along_x,
            along_y=along_y,
            coefficients=np.ascontiguousarray(table[inside_x[1], inside_y[1]]),
        )

    def _trimmed(
        self, direction: int, number: int, knots: Array, kept: tuple[int, int]
    ) -> tuple[tuple[slice, slice], Axis]:
        """Where the knots and the coefficients of the pieces of a tile are, and these pieces."""
        axis = self._axes[direction]
        breaks = knots[ORDER - 1 : len(knots) - ORDER + 1]
        first = max(0, int(np.searchsorted(breaks, axis[kept[0]], side="right")) - 1)
        last = min(len(breaks) - 1, int(np.searchsorted(breaks, axis[kept[1]], side="left")))
        inside = slice(first, last + 2 * ORDER - 1), slice(first, last + ORDER - 1)
        if (direction, number) not in self._along:
            self._along[direction, number] = Axis.of(knots[inside[0]])
        return inside, self._along[direction, number]


def tile_count(samples: int) -> int:
    """The number of tiles along an axis of so many samples."""
    return max(1, -(-(samples - 1) // TILE))


def tile_of(axis: Array, t: Array) -> npt.NDArray[np.intp]:
    """The number of the tile that every point of an axis lies in; the nearest one outside of the samples."""
    return np.searchsorted(axis[TILE:-1:TILE], t, side="right")


def window(samples: int, number: int) -> tuple[slice, tuple[int, int]]:
    """The samples that the spline of a tile goes through, and the first and the last sample of the tile itself."""
    first, last = number * TILE, min((number + 1) * TILE, samples - 1)
    return slice(max(0, first - MARGIN), min(samples, last + MARGIN + 1)), (first, last)


def not_finite(value: float, i: int, j: int) -> SamplesError:
    """The error for a sample that is no finite number, by its index in the whole array."""
    found = "NaN" if np.isnan(value) else "infinite"
    return SamplesError(
        f"values[{i}][{j}] is {found}: every sample must be a finite number; fill in the missing ones", field="values"
    )


def _groups(tiles: npt.NDArray[np.intp]) -> list[tuple[int, npt.NDArray[np.intp]]]:
    """The numbers of all points of each tile."""
    if tiles.size and tiles.min() == tiles.max():
        return [(int(tiles[0]), np.arange(tiles.size))]
    order = np.argsort(tiles, kind="stable")
    starts = np.flatnonzero(np.diff(tiles[order], prepend=-1))
    return [(int(tiles[points[0]]), points) for points in np.split(order, starts[1:]) if points.size]


# Range, faults, noise and jumps of all samples in a file, from one pass over it in blocks.

# Numbers of the largest block that is read at a time, unless one chunk has more.
MAX_BLOCK_NUMBERS = 1 << 22


@dataclass(frozen=True, kw_only=True)
class Step:
    """The largest difference of two neighbours along one axis: its ``size``, and the index of the first of the two."""

    size: float
    i: int
    j: int


@dataclass(frozen=True, kw_only=True)
class Scan:
    """The smallest and the largest sample, and the largest step along x and along y."""

    low: float
    high: float
    steps: tuple[Step, Step]

    @property
    def size(self) -> float:
        """The range of the samples."""
        return self.high - self.low


# The step of one sample, which has no neighbours.
NOTHING = Step(size=-1.0, i=0, j=0)


def scan(values: SampleArray, x: Array, y: Array) -> Scan:
    """Read all samples once.

    Raises :class:`~equimesh.errors.SamplesError` for one that is not finite or too large, by its index in the whole
    array, and for a slope between two that is too large.
    """
    low, high, steps = np.inf, -np.inf, [NOTHING, NOTHING]
    above: dict[int, Array] = {}
    for rows, row_blocks in _by_rows(values):
        left: Array | None = None
        for columns in row_blocks:
            block = values.read(rows, columns)
            lowest, highest = float(block.min()), float(block.max())
            if not max(-lowest, highest) <= LIMITS.magnitude:  # NaN, too
                _refuse(block, rows.start, columns.start)
            low, high = min(low, lowest), max(high, highest)
            row, column = rows.start, columns.start
            pieces = [(0, block, row, column), (1, block, row, column)]
            if column in above:
                pieces.append((0, np.concatenate([above[column], block[:1]]), row - 1, column))
            if left is not None:
                pieces.append((1, np.concatenate([left, block[:, :1]], axis=1), row, column - 1))
            for axis, piece, i, j in pieces:
                found = _largest_step(piece, axis, (i, j))
                _check_slope(found, piece.shape[axis], (x, y)[axis], (i, j)[axis], "xy"[axis])
                steps[axis] = max(steps[axis], found, key=lambda step: step.size)
            above[column], left = block[-1:].copy(), block[:, -1:].copy()
    return Scan(low=low, high=high, steps=(steps[0], steps[1]))


def steps_of(values: Array) -> tuple[float, tuple[Step, Step]]:
    """The range of samples in memory, and the largest step along x and along y."""
    along_x, along_y = (_largest_step(values, axis, (0, 0)) for axis in (0, 1))
    return float(np.ptp(values)), (along_x, along_y)


def _by_rows(values: SampleArray) -> Iterator[tuple[slice, list[slice]]]:
    """Blocks of whole chunks: rows, and the columns of the blocks in these rows."""
    (n, m), (height, width) = values.shape, (min(a, b) for a, b in zip(values.chunk, values.shape, strict=True))
    width = width * max(1, min(-(-m // width), MAX_BLOCK_NUMBERS // (height * width)))
    height = height * max(1, MAX_BLOCK_NUMBERS // (height * width))
    for row in range(0, n, height):
        columns = [slice(column, min(column + width, m)) for column in range(0, m, width)]
        yield slice(row, min(row + height, n)), columns


def _refuse(block: Array, row: int, column: int) -> NoReturn:
    """Raise the error for the first sample of a block that is not finite or too large."""
    bad = ~(np.abs(block) <= LIMITS.magnitude)
    a, b = (int(k) for k in np.unravel_index(int(bad.argmax()), bad.shape))
    value = block[a, b]
    if not np.isfinite(value):
        raise not_finite(value, a + row, b + column)
    raise SamplesError(
        f"values[{a + row}][{b + column}] = {value:.6g}: at most {LIMITS.magnitude:g} in size is allowed; rescale u",
        field="values",
    )


def _largest_step(block: Array, axis: int, first: tuple[int, int]) -> Step:
    """The largest step of a block, whose first sample has the index ``first``."""
    if block.shape[axis] < 2:
        return NOTHING
    sizes = np.diff(block, axis=axis)
    np.abs(sizes, out=sizes)
    a, b = (int(k) for k in np.unravel_index(int(sizes.argmax()), sizes.shape))
    return Step(size=float(sizes[a, b]), i=a + first[0], j=b + first[1])


def _check_slope(step: Step, count: int, points: Array, first: int, name: str) -> None:
    """Refuse a step of neighbours that is too large for the smallest distance of these points."""
    lengths = np.diff(points[first : first + count])
    if lengths.size and step.size > LIMITS.magnitude * float(lengths.min()):
        raise slope_error(points, name)


# The most bytes of splines that a process keeps; it computes others again.
MAX_BYTES: Final = 4 << 30
# What an object keeps for itself when it goes to another process.
OWN: Final = ("_lock", "_opened")


@dataclass(frozen=True, kw_only=True, eq=False)
class OpenFile:
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

    Implements :class:`~equimesh.fields.expression.Field`. Raises :class:`~equimesh.errors.SamplesError`, which names
    the first bad index in the whole array, also from :meth:`evaluate` where a file cannot be read any more.
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

    def _here(self) -> OpenFile:
        """The file as this process has it open; a process that was forked opens it again."""
        opened = self._opened
        if opened is not None and opened.process == os.getpid():
            return opened
        with self._lock:
            if self._opened is None or self._opened.process != os.getpid():
                self._opened = self._open()
            return self._opened

    def _open(self) -> OpenFile:
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
        return OpenFile(process=os.getpid(), axes=axes, values=values, tiles=tiles)

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
