"""A bicubic spline through samples that are in a file, in tiles: each is computed when a point lies in it.

A tile is a fixed rectangle of samples. Its spline goes through these samples and ``MARGIN`` more on every side. The
influence of a sample falls to a quarter from one sample to the next, so this is the spline through all samples, up to
rounding. Tiles depend on the shape of the samples alone. So the value at a point does not depend on other points, or on
the process that evaluates it.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from equimesh.errors import SamplesError
from equimesh.fields.axis import ORDER, Axis
from equimesh.fields.bicubic import COUNT, Bicubic
from equimesh.fields.samples import bicubic_spline, check_size
from equimesh.numerics.types import Array

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
