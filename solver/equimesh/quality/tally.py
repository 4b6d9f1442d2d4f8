"""The errors of interpolating u, summed over every cell, from one evaluation of u at each point."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from equimesh.fields.field import Field
from equimesh.meshes.mesh_window import MeshWindow, WindowCells
from equimesh.numerics.threads import run_on_threads
from equimesh.numerics.types import Array, IntArray
from equimesh.quality.cell_errors import add_errors, add_middles, add_values
from equimesh.quality.cell_maps import locate
from equimesh.quality.cells import BilinearCells, CellPoints, Cells, MeshCells

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


@dataclass(frozen=True, kw_only=True, eq=False)
class ErrorTally:
    """Sums over own cells of a process, all of them or some, that grow while blocks of cells are added.

    ``chosen`` are these cells, ``sampled`` is whether they are some only. ``values`` of shape ``(4, n)`` are u at the
    corners, ``sums`` of shape ``(4, n)`` the integrals of :func:`~equimesh.quality.cell_errors.add_errors`,
    ``largest`` the largest errors at a point. ``nodal`` is u at the held nodes, ``None`` where it is not known.
    """

    cells: Cells
    u: Field
    rule: ErrorRule
    chosen: WindowCells
    sampled: bool
    nodal: Array | None
    values: Array
    sums: Array
    largest: Array
    ends: list[tuple[float, float]]

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
        chosen = WindowCells.of(cells.rows, numbers)
        count = chosen.numbers.size
        if isinstance(cells, MeshCells) and (nodal is not None or numbers is None):
            nodal = u.evaluate(*cells.nodes)[0] if nodal is None else nodal
            values = cells.corner_values(nodal, chosen.numbers)
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
            sums=np.zeros((4, count)),
            largest=np.zeros(count),
            ends=[(float(values.min()), float(values.max()))] if count else [],
        )

    def add(self, where: slice, corners: Array, derivatives: tuple[Array, ...]) -> None:
        """The cells at these places, with u and its ``derivatives`` at the inner points of the rule."""
        u, u_x, u_y = (np.ascontiguousarray(part) for part in derivatives[:3])
        values, sums = np.ascontiguousarray(self.values[:, where]), np.zeros((4, corners.shape[1]))
        add_errors(corners, values, u, (u_x, u_y), self.rule.inner, sums, self.largest[where])
        self.sums[:, where] = sums
        self._widen(u)

    def add_all(self, threads: int = 1) -> None:
        """All cells at the inner points of the rule, block by block; ``threads`` share the blocks if they are many."""
        inner = self.rule.inner
        blocks = list(self.cells.blocks_of(self.chosen, inner))

        def work(thread: int, threads: int) -> None:
            with np.errstate(all="ignore"):
                for where, numbers in blocks[thread::threads]:
                    corners = self.cells.corners(numbers)
                    x, y = np.empty((2, inner.s.size, corners.shape[1]))
                    locate(corners, inner.s, inner.t, x, y)
                    self.add(where, corners, self.u.evaluate(x, y, order=1))

        share_blocks(work, self.largest.size, threads)

    def add_edges(self) -> None:
        """All cells at the edge points of the rule."""
        edge = self.rule.edge
        if not edge.s.size:
            return
        if isinstance(self.cells, BilinearCells) and not self.sampled and self.nodal is not None:
            for first, last in self.cells.rows.strips:
                self._add_middles(self.cells.window, self.nodal, first, last)
            return
        for where, numbers in self.cells.blocks_of(self.chosen, edge):
            corners = self.cells.corners(numbers)
            x, y = np.empty((2, edge.s.size, corners.shape[1]))
            locate(corners, edge.s, edge.t, x, y)
            (there,) = self.u.evaluate(x, y)
            values = np.ascontiguousarray(self.values[:, where])
            add_values(corners, values, np.ascontiguousarray(there), edge, self.sums[0, where], self.largest[where])
            self._widen(there)

    def _add_middles(self, window: MeshWindow, nodal: Array, first: int, last: int) -> None:
        """The middles of the edges of the rows ``first`` to ``last - 1`` of cells."""
        rows, columns = window.rows, window.rows.cells[1]
        x, y = window.nodes(first, last)
        of_xi = self.u.evaluate(0.5 * (x[1:] + x[:-1]), 0.5 * (y[1:] + y[:-1]))[0]
        of_eta = self.u.evaluate(0.5 * (x[:, 1:] + x[:, :-1]), 0.5 * (y[:, 1:] + y[:, :-1]))[0]
        there = np.ascontiguousarray(nodal[first - rows.begin : last + 1 - rows.begin])
        where = slice((first - rows.first) * columns, (last - rows.first) * columns)
        middles = np.ascontiguousarray(of_xi), np.ascontiguousarray(of_eta)
        add_middles((x, y), there, middles, self.sums[0, where], self.largest[where])
        self._widen(of_xi)
        self._widen(of_eta)

    @property
    def range(self) -> tuple[float, float]:
        """The smallest and the largest value of u at the points so far; blocks with NaN have no part in it."""
        known = [ends for ends in self.ends if not math.isnan(ends[0])]
        return min((low for low, _ in known), default=math.nan), max((high for _, high in known), default=math.nan)

    def _widen(self, u: Array) -> None:
        self.ends.append((float(u.min()), float(u.max())))
