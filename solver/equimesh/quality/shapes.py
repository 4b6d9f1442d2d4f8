"""What is measured of a mesh alone, whatever it adapts to: the shapes and sizes of its cells, and its faces.

A grid whose cells are valid is measured row by row, any other mesh cell by cell. The statistics of all strips give
those of the mesh. :mod:`equimesh.quality.measures` and :mod:`equimesh.quality.faces` define the measures.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from equimesh.numerics.compiled import compiled, inlined, vectorised
from equimesh.numerics.types import Array, BoolArray, IntArray, Pair
from equimesh.quality.cell_maps import (
    areas_of_row,
    gather_corners,
    gather_row_of_cells,
    shapes,
    size_ratios_of,
    sum_of_row,
)
from equimesh.quality.cells import BilinearCells, MeshCells
from equimesh.quality.tally import share_blocks

# Extremes, mean and root mean square of numbers that come in blocks.


class Statistics(NamedTuple):
    """The largest and the smallest of some numbers, their mean and the root of the mean of their squares."""

    max: float
    min: float
    mean: float
    rms: float

    @classmethod
    def of(cls, parts: Array, count: int) -> list[Statistics]:
        """Those of each of some rows of ``count`` numbers, from the :func:`parts <fill_parts>` of their blocks.

        These have the shape ``(blocks, rows, 4)``.
        """
        ends = parts[:, :, 0].max(axis=0).tolist(), parts[:, :, 1].min(axis=0).tolist()
        sums, squares = parts[:, :, 2:].sum(axis=0).T.tolist()
        found = zip(*ends, sums, squares, strict=True)
        return [cls(high, low, total / count, math.sqrt(square / count)) for high, low, total, square in found]

    def times(self, factor: float) -> Statistics:
        """Those of the numbers times a positive ``factor``."""
        return Statistics(*(factor * value for value in self))


@compiled
def fill_parts(rows: Array, out: Array) -> None:
    """Fill ``out``, of shape ``(rows, 4)``, with the largest and smallest, the sum and the sum of squares of each row.

    Where a number is not finite they are what numpy says.
    """
    fast_parts(rows, out)
    for r in range(rows.shape[0]):
        if not np.isfinite(out[r, 3]):
            out[r, 0], out[r, 1], out[r, 2], out[r, 3] = -np.inf, np.inf, 0.0, 0.0
            for k in range(rows.shape[1]):
                number = rows[r, k]
                out[r, 0] = number if number > out[r, 0] or number != number else out[r, 0]
                out[r, 1] = number if number < out[r, 1] or number != number else out[r, 1]
                out[r, 2] += number
                out[r, 3] += number * number


@compiled
def join_parts(one: Array, other: Array) -> None:
    """Add to ``one`` the :func:`fill_parts` of other numbers."""
    for r in range(len(one)):
        high, low = other[r, 0], other[r, 1]
        one[r, 0] = high if high > one[r, 0] or high != high else one[r, 0]
        one[r, 1] = low if low < one[r, 1] or low != low else one[r, 1]
        one[r, 2] += other[r, 2]
        one[r, 3] += other[r, 3]


@vectorised
def fast_parts(rows: Array, out: Array) -> None:
    """:func:`fill_parts` where all numbers are finite; where one is not, the sum of their squares is neither.

    Each comparison waits for the one before it: extremes are found of every fourth number, and then of the four.
    """
    fours = rows.shape[1] // 4 * 4
    for r in range(rows.shape[0]):
        row = rows[r]
        a = b = c = d = e = f = g = h = row[0]
        total, squares = 0.0, 0.0
        for k in range(0, fours, 4):
            p, q, s, t = row[k], row[k + 1], row[k + 2], row[k + 3]
            a, b, c, d = p if p > a else a, q if q > b else b, s if s > c else c, t if t > d else d
            e, f, g, h = p if p < e else e, q if q < f else f, s if s < g else g, t if t < h else h
        for k in range(fours, row.size):
            a, e = max(a, row[k]), min(e, row[k])
        for k in range(row.size):
            total += row[k]
            squares += row[k] * row[k]
        out[r, 0], out[r, 1] = max(max(a, b), max(c, d)), min(min(e, f), min(g, h))
        out[r, 2], out[r, 3] = total, squares


@vectorised
def skewnesses(tangents: Array) -> None:
    """From the tangents of angles, none negative, to the angles as shares of a right one, to rounding.

    The ranges and the quotient of polynomials are those of S. L. Moshier's Cephes library.
    """
    for k in range(tangents.size):
        tangent = tangents[k]
        is_large, is_small = tangent > 2.414213562373095, tangent <= 0.66
        above = -1.0 if is_large else (tangent if is_small else tangent - 1.0)
        below = tangent if is_large else (1.0 if is_small else tangent + 1.0)
        x = above / below
        begin = 0.5 * np.pi if is_large else (0.0 if is_small else 0.25 * np.pi)
        z = x * x
        p = -8.750608600031904122785e-1 * z - 1.615753718733365076637e1
        p = ((p * z - 7.500855792314704667340e1) * z - 1.228866684490136173410e2) * z - 6.485021904942025371773e1
        q = (z + 2.485846490142306297962e1) * z + 1.650270098316988542046e2
        q = ((q * z + 4.328810604912902668951e2) * z + 4.853903996359136964868e2) * z + 1.945506571482613964425e2
        tangents[k] = (begin + (x + x * z * p / q)) / (0.5 * np.pi)


# Rows of valid cells between two rows of nodes: ``x0``, ``y0`` of the first, ``x1``, ``y1`` of the second.
#
# A loop with few arrays of one dimension and without a sum or an extreme is computed four cells at a time.


@vectorised
def shapes_of_row(x0: Array, x1: Array, y0: Array, y1: Array, out: Array) -> None:
    """As :func:`~equimesh.quality.cell_maps.shapes`, of a row of cells.

    The smallest sine is that of the angle farthest from a right one.
    """
    regularity, sine, tangent, aspect = out[0], out[1], out[2], out[3]
    for j in range(regularity.size):
        ax, ay, bx, by = x1[j] - x0[j], y1[j] - y0[j], x1[j + 1] - x1[j], y1[j + 1] - y1[j]
        cx, cy, dx, dy = x0[j + 1] - x1[j + 1], y0[j + 1] - y1[j + 1], x0[j] - x0[j + 1], y0[j] - y0[j + 1]
        aa, bb, cc, dd = ax * ax + ay * ay, bx * bx + by * by, cx * cx + cy * cy, dx * dx + dy * dy
        da, ab, bc, cd = dx * ay - dy * ax, ax * by - ay * bx, bx * cy - by * cx, cx * dy - cy * dx
        p, q, r, s = 1.0 / da, 1.0 / ab, 1.0 / bc, 1.0 / cd
        regularity[j] = 0.5 * max(max((dd + aa) * p, (aa + bb) * q), max((bb + cc) * r, (cc + dd) * s))
        p, q = -(dx * ax + dy * ay) * p, -(ax * bx + ay * by) * q
        r, s = -(bx * cx + by * cy) * r, -(cx * dx + cy * dy) * s
        steepest = max(max(max(p, q), max(r, s)), -min(min(p, q), min(r, s)))
        tangent[j] = steepest
        sine[j] = 1.0 / np.sqrt(1.0 + steepest * steepest)
        aspect[j] = np.sqrt(max(max(aa, bb), max(cc, dd)) / min(min(aa, bb), min(cc, dd)))


@vectorised
def sizes_of_row(before: Array, here: Array, after: Array, out: Array) -> None:
    """Larger area over smaller for the cells of a row and their edge neighbours, the largest over these.

    ``before``, ``here`` and ``after`` are areas. At a side a cell takes the place of its missing neighbour.
    """
    last = here.size - 1
    for j in range(1, last):
        large = max(max(before[j], after[j]), max(max(here[j - 1], here[j + 1]), here[j]))
        small = min(min(before[j], after[j]), min(min(here[j - 1], here[j + 1]), here[j]))
        out[j] = max(large / here[j], here[j] / small)
    for j, beside in ((0, min(1, last)), (last, max(last - 1, 0))):
        large = max(max(before[j], after[j]), max(here[beside], here[j]))
        small = min(min(before[j], after[j]), min(here[beside], here[j]))
        out[j] = max(large / here[j], here[j] / small)


@vectorised
def centres_of_row(x0: Array, x1: Array, y0: Array, y1: Array, to_x: Array, to_y: Array) -> None:
    """The centroids of a row of cells."""
    for j in range(to_x.size):
        ax, ay = x1[j] - x0[j], y1[j] - y0[j]  # the other corners, seen from the first one
        bx, by = x1[j + 1] - x0[j], y1[j + 1] - y0[j]
        cx, cy = x0[j + 1] - x0[j], y0[j + 1] - y0[j]
        one, two = ax * by - ay * bx, bx * cy - by * cx
        weight = 1.0 / (3.0 * (one + two))
        to_x[j] = x0[j] + weight * (one * (ax + bx) + two * (bx + cx))
        to_y[j] = y0[j] + weight * (one * (ay + by) + two * (by + cy))


INNER_DISTANCE_SHARE = 0.2
"""The share of the distance between two centres that is at least the length of reference for skewness."""
SIDE_DISTANCE_SHARE = 0.4
"""The same of the distance between the centre of a cell and a side of the domain."""


@vectorised
def cross_faces(start: Pair, end: Pair, before: Pair, after: Pair, cosine: Array, skewness: Array) -> None:
    """The ``cosine`` of inner faces from ``start`` to ``end``, between two rows of centres, and the squared skewness.

    Each row is two arrays ``(n,)``, x and y.
    """
    (xa, ya), (xb, yb), (ox, oy), (px, py) = start, end, before, after
    for k in range(cosine.size):
        ex, ey = xb[k] - xa[k], yb[k] - ya[k]
        fx, fy = xa[k] + 0.5 * ex - ox[k], ya[k] + 0.5 * ey - oy[k]
        dx, dy = px[k] - ox[k], py[k] - oy[k]
        edge, apart, across = ex * ex + ey * ey, dx * dx + dy * dy, abs(dx * ey - dy * ex)
        cosine[k] = across / np.sqrt(apart * edge)
        share = abs(fx * ey - fy * ex) / across
        sx, sy = fx - share * dx, fy - share * dy
        skewness[k] = (sx * sx + sy * sy) / max(INNER_DISTANCE_SHARE**2 * apart, 0.25 * edge)


@vectorised
def add_faces(cosine: Array, skewness: Array, smallest: Array, total: Array, most: Array) -> None:
    """Of each column the smallest and the sum of the cosines, and the largest squared skewness."""
    for k in range(cosine.size):
        smallest[k], most[k] = min(smallest[k], cosine[k]), max(most[k], skewness[k])
        total[k] += cosine[k]


@compiled
def side_skewness(start: tuple[float, float], end: tuple[float, float], centre: tuple[float, float]) -> float:
    """The skewness of a face from ``start`` to ``end`` on a side, of a cell with this ``centre``."""
    ex, ey = end[0] - start[0], end[1] - start[1]
    fx, fy = start[0] + 0.5 * ex - centre[0], start[1] + 0.5 * ey - centre[1]
    half = 0.5 * math.sqrt(ex * ex + ey * ey)
    off, apart = abs(fx * ex + fy * ey) / (2.0 * half), abs(fx * ey - fy * ex) / (2.0 * half)
    return off / max(SIDE_DISTANCE_SHARE * apart, half)


@compiled
def survey_rows(nodes: Pair, span: tuple[int, int, bool], parts: Array, kept: Array, to: int, out: Array) -> None:
    """The shapes of the rows of cells ``span[0]`` to before ``span[1]``, and the faces that begin there.

    ``span[2]`` says whether the last row of nodes is on a side; the first is where it is row 0. ``out`` gets the
    smallest determinant at a corner, NaN where a coordinate is not finite, and the area; of the inner faces the
    smallest cosine, their sum and their number; the largest skewness of a face. ``parts`` are set to those of the
    measures by :func:`fill_parts`; these go to ``kept`` if that has rows, from ``to`` on. All is nothing unless the
    first of ``out`` is positive.
    """
    (x, y), (first, last, to_side) = nodes, span
    rows, columns = x.shape[0] - 1, x.shape[1] - 1
    area, centres, measured, found = (
        np.empty((3, columns)),
        np.empty((6, columns)),
        np.empty((5, columns)),
        np.empty((5, 4)),
    )
    ignored, cosine, skewness = np.empty(columns), np.empty(columns), np.empty(columns)
    lowest, smallest, total, most = np.empty(columns), np.empty(columns), np.empty(columns), np.empty(columns)
    for j in range(columns):
        ignored[j] = lowest[j] = np.inf
        smallest[j], total[j], most[j] = 1.0, 0.0, 0.0
    for r in range(5):
        parts[r, 0], parts[r, 1], parts[r, 2], parts[r, 3] = -np.inf, np.inf, 0.0, 0.0
    size, count, largest = 0.0, 0.0, 0.0
    for ahead in range(max(first - 1, 0), last + 1):  # areas and centres are known of the rows around
        if ahead < rows:
            x0, x1, y0, y1, k = x[ahead], x[ahead + 1], y[ahead], y[ahead + 1], ahead % 3
            areas_of_row(x0, x1, y0, y1, area[k], lowest if first <= ahead < last else ignored)
            centres_of_row(x0, x1, y0, y1, centres[k], centres[3 + k])
        i = ahead - 1
        if i < first:
            continue
        x0, x1, y0, y1 = x[i], x[i + 1], y[i], y[i + 1]
        here, cx, cy = area[i % 3], centres[i % 3], centres[3 + i % 3]
        shapes_of_row(x0, x1, y0, y1, measured)
        skewnesses(measured[2])
        sizes_of_row(area[max(i - 1, 0) % 3], here, area[min(i + 1, rows - 1) % 3], measured[4])
        fast_parts(measured, found)
        join_parts(parts, found)
        for r in range(len(kept)):
            for j in range(columns):
                kept[r, to + (i - first) * columns + j] = measured[r, j]
        size += sum_of_row(here)
        for is_eta in range(2):  # the edges along xi, and those along eta with which the row begins
            n, k = columns - 1 + is_eta, 1 - is_eta
            if is_eta and i == 0:
                continue
            xb, yb = (x0[1:], y0[1:]) if is_eta else (x1[1:], y1[1:])
            ox, oy = (centres[(i - 1) % 3], centres[3 + (i - 1) % 3]) if is_eta else (cx, cy)
            cross_faces((x0[k:], y0[k:]), (xb, yb), (ox, oy), (cx[k:], cy[k:]), cosine[:n], skewness[:n])
            add_faces(cosine[:n], skewness[:n], smallest, total, most)
            count += n
        for side in range(2):
            j, k = side * columns, side * (columns - 1)
            largest = max(largest, side_skewness((x0[j], y0[j]), (x1[j], y1[j]), (cx[k], cy[k])))
        for side in range(2):
            if (i == 0 and side == 0) or (side == 1 and to_side and i == last - 1):
                for j in range(columns):
                    start, end = (x[i + side, j], y[i + side, j]), (x[i + side, j + 1], y[i + side, j + 1])
                    largest = max(largest, side_skewness(start, end, (cx[j], cy[j])))
    low, cosines, least, squared = np.inf, 0.0, 1.0, 0.0
    for j in range(columns):
        low, least, squared = min(low, lowest[j]), min(least, smallest[j]), max(squared, most[j])
        cosines += total[j]
    out[0], out[1] = low if np.isfinite(size) else np.nan, size
    out[2], out[3], out[4], out[5] = least, cosines, count, max(largest, np.sqrt(squared))


# The same of any cells, some of which may be folded.

CHUNK = 1024
"""Cells that are measured together: what is known of them stays in the cache."""


@inlined
def gather_any(nodes: Pair, cells: IntArray, first: int, corners: Array) -> None:
    """x and y of the corners of consecutive cells, which have the nodes of the table ``cells`` or are those of rows."""
    if len(cells):
        gather_corners(nodes[0][0], nodes[1][0], cells[first : first + corners.shape[1]], corners)
    else:
        gather_row_of_cells(nodes[0], nodes[1], first, corners)


@compiled
def survey_shapes(
    nodes: Pair,
    tables: tuple[IntArray, IntArray],
    known: tuple[Array, BoolArray],
    place: int,
    count: int,
    parts: Array,
    kept: Array,
    to: int,
) -> None:
    """The shapes of ``count`` cells from ``place`` on, as :func:`survey_rows`; no faces.

    ``tables`` and what is ``known``, area and validity, are those of all held cells.
    """
    (cells, neighbours), (area, valid) = tables, known
    for r in range(5):
        parts[r, 0], parts[r, 1], parts[r, 2], parts[r, 3] = -np.inf, np.inf, 0.0, 0.0
    for begin in range(0, count, CHUNK):
        first, size = place + begin, min(CHUNK, count - begin)
        corners, rows, found = np.empty((8, size)), np.empty((5, size)), np.empty((5, 4))
        gather_any(nodes, cells, first, corners)
        shapes(corners, valid[first : first + size], rows[:4])
        skewnesses(rows[2])
        size_ratios_of(neighbours, first, valid, area, rows[4])
        fill_parts(rows, found)
        join_parts(parts, found)
        for r in range(len(kept)):
            for k in range(size):
                kept[r, to + begin + k] = rows[r, k]


SHAPES = ("q_geo", "scaled_jacobian", "skewness", "aspect_ratio", "size_ratio")
"""The measures of a mesh alone that have one value per cell, in the order of the rows of an array of them."""
MAX_KEPT_CELLS = 16_384
"""On at most this many cells all values are kept, since they exist anyway."""


class FaceSums(NamedTuple):
    """The smallest cosine between the normal of an inner face and the line of its two centres, the sum of all and their
    number; the largest skewness of a face."""

    lowest: float
    total: float
    number: float
    skewness: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Shapes:
    """What was measured of the ``cells`` of a mesh: the same for each function that it is measured with.

    ``statistics`` are those of the measures :data:`SHAPES`. ``faces`` are those of a valid grid without closed lines.
    """

    cells: MeshCells
    statistics: tuple[Statistics, ...]
    faces: FaceSums | None
    _kept: Array | None

    @classmethod
    def of(cls, cells: MeshCells, *, threads: int = 1, keep: bool = False) -> Shapes:
        """The shapes of ``cells``; all values of a large mesh are kept with ``keep`` alone."""
        strips, own, columns = cells.rows.strips, cells.own, cells.shape[1]
        is_kept = keep or cells.count <= MAX_KEPT_CELLS
        kept = np.empty((len(SHAPES) if is_kept else 0, own.stop - own.start if is_kept else 0))
        parts, found = np.empty((len(strips), len(SHAPES), 4)), np.empty((len(strips), 6))
        nodes = cells.grid_nodes

        def share(work: Callable[[slice, int, int], None]) -> None:
            def of_thread(thread: int, threads: int) -> None:
                for number in range(thread, len(strips), threads):
                    span = slice(strips[number][0] * columns, strips[number][1] * columns)
                    work(cells.places(span), span.start - own.start, number)

            share_blocks(of_thread, own.stop - own.start, threads)

        def rows(places: slice, to: int, number: int) -> None:
            first, last = places.start // columns, places.stop // columns
            span = first, last, strips[number][1] == cells.shape[0]
            survey_rows(nodes, span, parts[number], kept, to, found[number])

        def others(places: slice, to: int, number: int) -> None:
            count = places.stop - places.start
            survey_shapes(nodes, cells.tables, known, places.start, count, parts[number], kept, to)

        faces, is_plain = None, False
        with np.errstate(all="ignore"):
            if isinstance(cells, BilinearCells) and not any(cells.closed):
                share(rows)
                of_all = cells.rows.joined(found)
                (lowest, _, cosine, *_), (_, area, _, total, number, _) = of_all.min(axis=0), of_all.sum(axis=0)
                cells.know(float(lowest), float(area))
                is_plain = cells.all_valid
            if is_plain:
                faces = FaceSums(float(cosine), float(total), float(number), float(of_all[:, 5].max()))
            else:
                known = cells.area, cells.valid  # before the threads need them
                share(others)
            joined = cells.rows.joined(parts.reshape(len(strips), -1)).reshape(-1, len(SHAPES), 4)
            statistics = tuple(Statistics.of(joined, cells.count))
        return cls(cells=cells, statistics=statistics, faces=faces, _kept=kept if is_kept else None)

    @cached_property
    def kept(self) -> Array:
        """All values of the own cells, shape ``(5, cells)``."""
        found = Shapes.of(self.cells, keep=True)._kept if self._kept is None else self._kept
        assert found is not None
        return found
