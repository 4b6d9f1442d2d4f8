"""Interfaces that yield: the rest of every grid line outside the window shares the metric length of the line.

Beyond an interface in ``beta`` a grid line has ``N`` more edges, whose squared metric lengths in the merged mesh sum to
``R``. Let the interface node move by ``dr``, and let the rest of the line follow so that its lengths stay equal. Each
of them then becomes ``(R - 2 w . dr) / N`` to first order, with ``w = M r_xi`` (in units of one edge): the sum of a
line's lengths changes by the moves of its ends in the metric. The window's own edges along the line must have that
length, too. In one dimension this is the Dirichlet-to-Neumann map of the rest, for any number of subdomains; N, w and R
are the Robin parameter, its weights and its data. Along the interface the mesh equations hold as in the interior, with
the grid line beyond held fixed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from equimesh.equations.metric import ReferenceMetric
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.types import Array
from equimesh.schwarz.lines.line_sums import LineSums
from equimesh.schwarz.window import ENDS, SubdomainWindow
from equimesh.sweeps.line_sums import cell_metrics


@dataclass(frozen=True, kw_only=True)
class YieldingSide:
    """One yielding interface with its data from the merged mesh: arrays over the lines that cross it.

    ``total`` is the sum of the squared metric lengths beyond it, ``weights`` are w, ``x`` and ``y`` the nodes of the
    interface.
    """

    axis: int
    end: int
    total: Array
    weights: tuple[Array, Array]
    x: Array
    y: Array

    def rest(self, x: Array, y: Array) -> Array:
        """The sum of the squared metric lengths beyond, with the nodes of the window at ``x``, ``y``."""
        line = -2 if self.end else 1
        x, y = (x[line], y[line]) if self.axis == 0 else (x[:, line], y[:, line])
        moved = self.weights[0] * (x - self.x) + self.weights[1] * (y - self.y)
        return np.asarray(self.total - 2.0 * moved if self.end else self.total + 2.0 * moved)


def sides(metric: ReferenceMetric, window: SubdomainWindow, state: Mesh, sums: LineSums, *, local: bool) -> Sides:
    """The yielding sides of a window; ``state`` is its part of the merged mesh, ``sums`` those of the mesh.

    ``local`` takes the length of the first edge beyond an interface for all edges there.
    """
    found = []
    for (axis, end), is_open in window.open.items():
        if is_open:
            found.append(_side(metric, window, state, sums, axis, end, local=local))
    return Sides(tuple(found), state.x.shape)


@dataclass(frozen=True)
class Sides:
    """All yielding sides of a window of some shape."""

    sides: tuple[YieldingSide, ...]
    shape: tuple[int, ...]

    def rest(self, x: Array, y: Array) -> tuple[Array, Array]:
        """The sums beyond the window, for :meth:`equimesh.sweeps.sweep.Sweep.correct`."""
        found = np.zeros((2, self.shape[1])), np.zeros((2, self.shape[0]))
        for side in self.sides:
            found[side.axis][side.end] = side.rest(x, y)
        return found


def _side(
    metric: ReferenceMetric, window: SubdomainWindow, state: Mesh, sums: LineSums, axis: int, end: int, *, local: bool
) -> YieldingSide:
    span = window.part.spans[axis]
    point = span.last if end else span.first
    edges = sums.points[axis] - 1 - point if end else point
    place = slice(-3, None) if end else slice(0, 3)
    # The interface with one line on both of its sides, the lines that cross it along the first index.
    x, y = (np.ascontiguousarray(q[place] if axis == 0 else q[:, place].T) for q in (state.x, state.y))
    weights, beyond = _weights(metric, x, y, axis, end)
    total = sums.beyond(window, axis, end)
    for along, corner in zip(ENDS, (0, -1), strict=True):
        if not window.open[1 - axis, along]:
            lengths = sums.side_edges(window, axis, end, along)
            t = (x, y)[axis][:, corner]
            weights[axis][corner] = 0.5 * float(np.sum(lengths / np.diff(t)))
            weights[1 - axis][corner] = 0.0
            beyond[corner] = lengths[end]
    return YieldingSide(
        axis=axis,
        end=end,
        total=beyond * edges if local else total,
        weights=(weights[0], weights[1]),
        x=x[1].copy(),
        y=y[1].copy(),
    )


def _weights(metric: ReferenceMetric, x: Array, y: Array, axis: int, end: int) -> tuple[list[Array], Array]:
    """``M r_xi`` at the middle one of three lines, and the squared metric length of the edges beyond it."""
    lines, points = x.shape
    cells = np.empty((3, lines - 1, points - 1))
    if axis == 0:
        cell_metrics(metric, x, y, cells)
    else:
        turned = np.empty((3, points - 1, lines - 1))
        cell_metrics(metric, np.ascontiguousarray(x.T), np.ascontiguousarray(y.T), turned)
        cells[:] = turned.transpose(0, 2, 1)
    nodal = 0.25 * (cells[:, 0, 1:] + cells[:, 0, :-1] + cells[:, 1, 1:] + cells[:, 1, :-1])
    e = 0.5 * (x[2] - x[0])[1:-1], 0.5 * (y[2] - y[0])[1:-1]
    weights = [np.zeros(points), np.zeros(points)]
    weights[0][1:-1] = nodal[0] * e[0] + nodal[1] * e[1]
    weights[1][1:-1] = nodal[1] * e[0] + nodal[2] * e[1]
    edge = 0.5 * (cells[:, end, 1:] + cells[:, end, :-1])
    d = (x[1 + end] - x[end])[1:-1], (y[1 + end] - y[end])[1:-1]
    lengths = np.zeros(points)
    lengths[1:-1] = edge[0] * d[0] ** 2 + 2.0 * edge[1] * d[0] * d[1] + edge[2] * d[1] ** 2
    return weights, lengths
