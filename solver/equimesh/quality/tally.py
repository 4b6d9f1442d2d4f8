"""The errors of interpolating u, summed over every cell, from one evaluation of u at each point."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from equimesh.fields.expression import Field
from equimesh.meshes.mesh import MeshRows
from equimesh.numerics.compiled import compiled
from equimesh.numerics.threads import run_on_threads
from equimesh.numerics.types import Array, IntArray, Pair
from equimesh.quality.cell_maps import gather_values, locate
from equimesh.quality.cells import BLOCK_POINTS, BilinearCells, CellPoints, Cells, ChosenCells, MeshCells, pieces

# Compiled integrals over cells of the squared errors of bilinear interpolation.
#
# ``corners`` of shape ``(8, n)`` are x and then y of the corners of the cells, counter-clockwise; ``values`` of shape
# ``(4, n)`` are those of the interpolant there. Functions at points have the shape ``(points, n)``.

MIDDLE_WEIGHT = 2 / 45
"""Weight of the middles of the edges; see :meth:`ErrorRule.lean`."""


@compiled
def add_errors(
    corners: Array,
    values: Array,
    u: Array,
    gradient: Pair,
    points: CellPoints,
    sums: Array,
    largest: Array,
    place: int,
) -> None:
    """To ``sums`` the integrals of errors ``u_h - u`` over every cell, by quadrature.

    ``values``, ``sums`` and ``largest`` have those of these cells from ``place`` on. The first sum is that of the
    squared error, the second that of the squared error of the gradient, the others are those of the two components of
    this error. ``largest`` becomes the largest size of the error.
    """
    x0, x1, x2, x3 = corners[0], corners[1], corners[2], corners[3]
    y0, y1, y2, y3 = corners[4], corners[5], corners[6], corners[7]
    v0, v1, v2, v3 = values[0, place:], values[1, place:], values[2, place:], values[3, place:]
    squares, slopes, along_x, along_y = sums[0, place:], sums[1, place:], sums[2, place:], sums[3, place:]
    most = largest[place:]
    for p in range(u.shape[0]):
        s, t, weight = points.s[p], points.t[p], points.weights[p]
        a, b, c, d = (1.0 - s) * (1.0 - t), s * (1.0 - t), s * t, (1.0 - s) * t
        here, u_x, u_y = u[p], gradient[0][p], gradient[1][p]
        for k in range(corners.shape[1]):
            x_s = (1.0 - t) * (x1[k] - x0[k]) + t * (x2[k] - x3[k])
            y_s = (1.0 - t) * (y1[k] - y0[k]) + t * (y2[k] - y3[k])
            x_t = (1.0 - s) * (x3[k] - x0[k]) + s * (x2[k] - x1[k])
            y_t = (1.0 - s) * (y3[k] - y0[k]) + s * (y2[k] - y1[k])
            det = x_s * y_t - x_t * y_s
            along_s = (1.0 - t) * (v1[k] - v0[k]) + t * (v2[k] - v3[k])
            along_t = (1.0 - s) * (v3[k] - v0[k]) + s * (v2[k] - v1[k])
            error = a * v0[k] + b * v1[k] + c * v2[k] + d * v3[k] - here[k]
            error_x = (along_s * y_t - along_t * y_s) / det - u_x[k]
            error_y = (along_t * x_s - along_s * x_t) / det - u_y[k]
            share = weight * det
            squares[k] += share * error * error
            slopes[k] += share * (error_x * error_x + error_y * error_y)
            along_x[k] += share * error_x
            along_y[k] += share * error_y
            most[k] = max(most[k], abs(error))


@compiled
def add_values(corners: Array, values: Array, u: Array, points: CellPoints, sums: Array, largest: Array) -> None:
    """To ``sums`` of every cell the integral of the squared error alone; ``largest`` as in :func:`add_errors`."""
    x0, x1, x2, x3 = corners[0], corners[1], corners[2], corners[3]
    y0, y1, y2, y3 = corners[4], corners[5], corners[6], corners[7]
    v0, v1, v2, v3 = values[0], values[1], values[2], values[3]
    for p in range(u.shape[0]):
        s, t, weight = points.s[p], points.t[p], points.weights[p]
        a, b, c, d = (1.0 - s) * (1.0 - t), s * (1.0 - t), s * t, (1.0 - s) * t
        here = u[p]
        for k in range(largest.size):
            x_s = (1.0 - t) * (x1[k] - x0[k]) + t * (x2[k] - x3[k])
            y_s = (1.0 - t) * (y1[k] - y0[k]) + t * (y2[k] - y3[k])
            x_t = (1.0 - s) * (x3[k] - x0[k]) + s * (x2[k] - x1[k])
            y_t = (1.0 - s) * (y3[k] - y0[k]) + s * (y2[k] - y1[k])
            error = a * v0[k] + b * v1[k] + c * v2[k] + d * v3[k] - here[k]
            sums[k] += weight * (x_s * y_t - x_t * y_s) * error * error
            largest[k] = max(largest[k], abs(error))


@compiled
def add_between_lines(
    lines: Pair, nodal: Array, rule: CellPoints, at: tuple[Array, Array, Array], sums: Array, place: int
) -> None:
    """As :func:`add_errors` for the first two sums alone, of all cells between ``lines`` at x and at y.

    ``nodal`` is u where these cross. u and its gradient ``at`` the points of a Gauss rule have the shape
    ``(k rows, k columns)`` for k points per direction: those at the first place of each cell come first.
    """
    (x, y), (u, u_x, u_y) = lines, at
    columns = y.size - 1
    count = u.shape[1] // columns
    per_y = np.empty(columns)
    for j in range(columns):
        per_y[j] = 1.0 / (y[j + 1] - y[j])
    for i in range(x.size - 1):
        v0, v1, begin = nodal[i], nodal[i + 1], place + i * columns
        squares, slopes = sums[0, begin : begin + columns], sums[1, begin : begin + columns]
        per_x = 1.0 / (x[i + 1] - x[i])
        for p in range(count * count):
            s, t, weight, row, first = rule.s[p], rule.t[p], rule.weights[p], p // count, p % count * columns
            a, b, c, d = (1.0 - s) * (1.0 - t), s * (1.0 - t), s * t, (1.0 - s) * t
            k = row * (x.size - 1) + i
            here, by_x, by_y = u[k, first:], u_x[k, first:], u_y[k, first:]
            for j in range(columns):
                error = a * v0[j] + b * v1[j] + c * v1[j + 1] + d * v0[j + 1] - here[j]
                squares[j] += weight * error * error
            for j in range(columns):
                along_x = ((1.0 - t) * (v1[j] - v0[j]) + t * (v1[j + 1] - v0[j + 1])) * per_x - by_x[j]
                along_y = ((1.0 - s) * (v0[j + 1] - v0[j]) + s * (v1[j + 1] - v1[j])) * per_y[j] - by_y[j]
                slopes[j] += weight * (along_x * along_x + along_y * along_y)
        for j in range(columns):
            area = (x[i + 1] - x[i]) * (y[j + 1] - y[j])
            squares[j] *= area
            slopes[j] *= area


@compiled
def add_middles(nodes: Pair, nodal: Array, middles: Pair, sums: Array, largest: Array) -> None:
    """As :func:`add_values` for all cells of a mesh and the middles of their edges, each evaluated once.

    ``nodal`` is u at the ``nodes``; ``middles`` is u in the middle of the edges along xi, of shape
    ``(n_xi - 1, n_eta)``, and of those along eta, of shape ``(n_xi, n_eta - 1)``.
    """
    (x, y), (of_xi, of_eta) = nodes, middles
    columns = x.shape[1] - 1
    for i in range(x.shape[0] - 1):
        for j in range(columns):
            k = i * columns + j
            ax, ay, bx = x[i + 1, j] - x[i, j], y[i + 1, j] - y[i, j], x[i + 1, j + 1] - x[i + 1, j]
            by = y[i + 1, j + 1] - y[i + 1, j]
            cx, cy = x[i + 1, j + 1] - x[i, j + 1], y[i + 1, j + 1] - y[i, j + 1]
            dx, dy = x[i, j + 1] - x[i, j], y[i, j + 1] - y[i, j]
            ex, ey, fx, fy = 0.5 * (ax + cx), 0.5 * (ay + cy), 0.5 * (bx + dx), 0.5 * (by + dy)
            bottom = 0.5 * (nodal[i, j] + nodal[i + 1, j]) - of_xi[i, j]
            top = 0.5 * (nodal[i, j + 1] + nodal[i + 1, j + 1]) - of_xi[i, j + 1]
            left = 0.5 * (nodal[i, j] + nodal[i, j + 1]) - of_eta[i, j]
            right = 0.5 * (nodal[i + 1, j] + nodal[i + 1, j + 1]) - of_eta[i + 1, j]
            total = (ax * fy - ay * fx) * bottom * bottom + (cx * fy - cy * fx) * top * top
            total += (ex * dy - ey * dx) * left * left + (ex * by - ey * bx) * right * right
            sums[k] += MIDDLE_WEIGHT * total
            largest[k] = max(max(largest[k], max(abs(bottom), abs(top))), max(abs(left), abs(right)))


MIN_CELLS_FOR_THREADS = 16_384
"""On fewer cells a second thread costs more than it saves."""


def share_blocks(work: Callable[[int, int], None], cells: int, threads: int) -> None:
    """Call ``work(k, threads)`` for every thread k; in one thread where there are few ``cells``."""
    threads = threads if cells >= MIN_CELLS_FOR_THREADS else 1
    run_on_threads(threads, lambda thread: work(thread, threads))


@dataclass(frozen=True, eq=False)
class ErrorRule:
    """Quadrature of squared errors: u and its gradient at ``inner`` points, u alone at ``edge`` points of every cell.

    Gradients are weighted by ``inner.weights``, values by those and by ``edge.weights``.
    """

    inner: CellPoints
    edge: CellPoints

    @classmethod
    def gauss(cls, count: int) -> ErrorRule:
        """The Gauss rule with ``count`` points per direction, alone."""
        return cls(CellPoints.gauss(count), CellPoints(np.empty(0), np.empty(0), np.empty(0)))

    @classmethod
    def lean(cls) -> ErrorRule:
        """The 2 x 2 Gauss rule, and the middles of the edges.

        The interpolation error is ``a s (1-s) + b t (1-t)`` to leading order. Its square has the integral
        ``(a^2 + b^2)/30 + a b/18``, of which the 2 x 2 rule gives ``(a + b)^2/36``. Four middles with weights of
        2/45 add the rest. The result is exact to leading order; for the gradient the 2 x 2 rule alone is. The weights
        sum to more than 1: the corners, where there is no error, have the negative rest.
        """
        middles = CellPoints(
            np.array([0.5, 1.0, 0.5, 0.0]),
            np.array([0.0, 0.5, 1.0, 0.5]),
            np.full(4, 2 / 45),
        )
        return cls(CellPoints.gauss(2), middles)


def on_lines(u: Field, x: Array, y: Array, order: int = 0) -> tuple[Array, ...]:
    """u and its derivatives up to ``order`` where lines at ``x`` cross lines at ``y``."""
    shape, step = (x.size, y.size), x.itemsize
    return u.evaluate(np.ndarray(shape, float, x, 0, (step, 0)), np.ndarray(shape, float, y, 0, (0, step)), order)


@dataclass(frozen=True, kw_only=True, eq=False)
class ErrorTally:
    """Sums over own cells, all of them or some, that grow while blocks of cells are added.

    ``chosen`` are these cells, ``sampled`` is whether they are some only. ``values`` are u at the corners, of shape
    ``(4, n)``, or where ``lines`` cross. ``sums`` of shape ``(4, n)`` are the integrals of :func:`add_errors`, between
    lines the first two of them. ``largest`` are the largest errors at a point, not known between lines. ``nodal`` is u
    at the held nodes, ``None`` where it is not known.
    """

    cells: Cells
    u: Field
    rule: ErrorRule
    chosen: ChosenCells
    sampled: bool
    nodal: Array | None
    values: Array
    sums: Array
    largest: Array
    ends: list[tuple[float, float]]
    corners: Array | None
    """x and y of the corners of some cells; ``None`` where all are looked at, in blocks."""
    lines: Pair | None
    """Those between which all cells are; ``None`` for other meshes, and where some cells are looked at."""

    @classmethod
    def of(
        cls,
        cells: Cells,
        u: Field,
        rule: ErrorRule,
        numbers: IntArray | None = None,
        nodal: Array | None = None,
    ) -> ErrorTally:
        """Nothing yet of the own ``cells`` or of those with ``numbers``.

        ``nodal`` is u at the held nodes if that is known.
        """
        chosen = ChosenCells.of(cells.rows, numbers)
        count, lines = chosen.numbers.size, cells.lines if numbers is None else None
        corners = None
        if lines is not None:
            values = nodal = on_lines(u, *lines)[0]
        elif isinstance(cells, MeshCells) and (nodal is not None or numbers is None):
            if nodal is None:
                (nodal,) = u.evaluate(*cells.nodes)
            values = cells.corner_values(nodal, chosen.numbers)
            corners = None if numbers is None else cells.corners(numbers)
        else:
            corners = cells.corners(chosen.numbers)
            (values,) = u.evaluate(corners[:4], corners[4:])
        return cls(
            cells=cells,
            u=u,
            rule=rule,
            chosen=chosen,
            sampled=numbers is not None,
            nodal=nodal,
            values=values,
            sums=np.zeros((4 if lines is None else 2, count)),
            largest=np.zeros(count),
            ends=[(float(values.min()), float(values.max()))] if count else [],
            corners=corners,
            lines=lines,
        )

    def pieces(self, some: IntArray) -> tuple[Array, Array]:
        """The corners, shape ``(8, n)``, and the values there, shape ``(4, n)``, of some of the cells."""
        if self.lines is None:
            corners = self.cells.corners(self.chosen.numbers[some]) if self.corners is None else self.corners[:, some]
            return corners, self.values[:, some]
        values = np.empty((4, some.size))
        gather_values(self.values, some, values)
        return self.cells.corners(some + self.cells.own.start), values

    @property
    def size(self) -> float:
        """The largest size of u at a corner."""
        return max(map(abs, self.ends[0])) if self.ends else 0.0

    def _corners(self, where: slice, numbers: slice | IntArray) -> Array:
        """The corners of the cells at these places, which have these ``numbers``."""
        return self.cells.corners(numbers) if self.corners is None else np.ascontiguousarray(self.corners[:, where])

    def add(self, where: slice, corners: Array, derivatives: tuple[Array, ...]) -> None:
        """The cells at these places, with u and its ``derivatives`` at the inner points."""
        u, u_x, u_y = (np.ascontiguousarray(part) for part in derivatives[:3])
        add_errors(corners, self.values, u, (u_x, u_y), self.rule.inner, self.sums, self.largest, where.start)
        self._widen(u)

    def add_all(self, threads: int = 1) -> None:
        """All cells at all points of the rule, block by block; ``threads`` share the blocks if they are many."""
        if self.lines is not None:
            self._add_between(self.lines, threads)
            return
        points = self.rule.inner
        blocks: list[tuple[slice, slice | IntArray]] = list(self.cells.blocks_of(self.chosen, points))
        if not self.sampled:
            start = self.cells.own.start
            blocks = [(slice(k.start - start, k.stop - start), k) for k in self.cells.blocks(points)]

        def work(thread: int, threads: int) -> None:
            with np.errstate(all="ignore"):
                for where, numbers in blocks[thread::threads]:
                    corners = self._corners(where, numbers)
                    self.add(where, corners, self._at(points, corners, order=1))
                    if not self._shares_edges:
                        self._add_edges(where, corners)

        share_blocks(work, self.largest.size, threads)
        if self._shares_edges:
            self.add_edges()

    def _add_between(self, lines: Pair, threads: int) -> None:
        """All cells between ``lines`` at all points of the rule, some rows at a time."""
        inner, (x, y), nodal = self.rule.inner, lines, self.values
        count, columns, first = math.isqrt(inner.s.size), y.size - 1, self.cells.rows.first
        height = max(1, 4 * BLOCK_POINTS // (inner.s.size * columns))
        rows = [
            slice(piece.start - first, piece.stop - first + 1)
            for strip in self.cells.rows.strips
            for piece in pieces(*strip, height)
        ]
        at_y = (y[:-1] + inner.t[:count, None] * np.diff(y)).ravel()

        def work(thread: int, threads: int) -> None:
            with np.errstate(all="ignore"):
                for here in rows[thread::threads]:
                    part, place = x[here], here.start * columns
                    at_x = (part[:-1] + inner.s[::count, None] * np.diff(part)).ravel()
                    at = on_lines(self.u, at_x, at_y, order=1)
                    there = np.ascontiguousarray(at[0]), np.ascontiguousarray(at[1]), np.ascontiguousarray(at[2])
                    add_between_lines((part, y), nodal[here], inner, there, self.sums, place)

        share_blocks(work, self.largest.size, threads)
        for begin, end in self.cells.rows.strips if self.rule.edge.s.size else ():
            here = slice(begin - first, end - first + 1)
            self._add_middles_between(x[here], y, nodal[here], here.start * columns)

    def _add_middles_between(self, x: Array, y: Array, nodal: Array, place: int) -> None:
        """The middles of the edges of the cells between lines at x and at y, from ``place`` on."""
        shape = x.size, y.size
        (of_xi,), (of_eta,) = on_lines(self.u, 0.5 * (x[1:] + x[:-1]), y), on_lines(self.u, x, 0.5 * (y[1:] + y[:-1]))
        middles = np.ascontiguousarray(of_xi), np.ascontiguousarray(of_eta)
        nodes = np.repeat(x, y.size).reshape(shape), np.tile(y, x.size).reshape(shape)
        where = slice(place, place + (x.size - 1) * (y.size - 1))
        add_middles(nodes, nodal, middles, self.sums[0, where], self.largest[where])

    @property
    def _shares_edges(self) -> bool:
        """Whether u in the middle of an edge is evaluated once for the two cells beside it."""
        return isinstance(self.cells, BilinearCells) and not self.sampled and self.nodal is not None

    def add_edges(self) -> None:
        """All cells at the edge points of the rule."""
        edge = self.rule.edge
        if not edge.s.size:
            return
        if isinstance(self.cells, BilinearCells) and self.nodal is not None and not self.sampled:
            for first, last in self.cells.rows.strips:
                self._add_middles(self.cells.window, self.nodal, first, last)
            return
        for where, numbers in self.cells.blocks_of(self.chosen, edge):
            self._add_edges(where, self._corners(where, numbers))

    def _add_edges(self, where: slice, corners: Array) -> None:
        """The cells at these places at the edge points of the rule, where only u counts."""
        edge = self.rule.edge
        if edge.s.size:
            values, (u,) = np.ascontiguousarray(self.values[:, where]), self._at(edge, corners)
            add_values(corners, values, np.ascontiguousarray(u), edge, self.sums[0, where], self.largest[where])
            self._widen(u)

    def _at(self, points: CellPoints, corners: Array, order: int = 0) -> tuple[Array, ...]:
        """u and its derivatives at ``points`` of the cells with these ``corners``."""
        x, y = np.empty((2, points.s.size, corners.shape[1]))
        locate(corners, points.s, points.t, x, y)
        return self.u.evaluate(x, y, order)

    def _add_middles(self, window: MeshRows, nodal: Array, first: int, last: int) -> None:
        """The middles of the edges of the rows ``first`` to ``last - 1`` of cells."""
        rows, columns = window.rows, window.rows.cells[1]
        x, y = window.nodes(first, last)
        (of_xi,) = self.u.evaluate(0.5 * (x[1:] + x[:-1]), 0.5 * (y[1:] + y[:-1]))
        (of_eta,) = self.u.evaluate(0.5 * (x[:, 1:] + x[:, :-1]), 0.5 * (y[:, 1:] + y[:, :-1]))
        there = np.ascontiguousarray(nodal[first - rows.begin : last + 1 - rows.begin])
        where = slice((first - rows.first) * columns, (last - rows.first) * columns)
        middles = np.ascontiguousarray(of_xi), np.ascontiguousarray(of_eta)
        add_middles((x, y), there, middles, self.sums[0, where], self.largest[where])
        self._widen(of_xi)
        self._widen(of_eta)

    @property
    def range(self) -> tuple[float, float]:
        """The smallest and the largest value of u at the points so far; blocks with NaN have no part in it.

        Between lines they are those where these cross.
        """
        known = [ends for ends in self.ends if not math.isnan(ends[0])]
        return min((low for low, _ in known), default=math.nan), max((high for _, high in known), default=math.nan)

    def _widen(self, u: Array) -> None:
        self.ends.append((float(u.min()), float(u.max())))
