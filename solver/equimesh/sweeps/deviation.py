"""How far a mesh is from the solution of the equations: one pass over its cells, without a correction."""

from __future__ import annotations

import math

import numpy as np

from equimesh.domains.domain import closed_of, is_closed
from equimesh.equations.metric import ReferenceMetric
from equimesh.equations.problem import Boundary
from equimesh.meshes.mesh import Mesh, MeshRows
from equimesh.meshes.nested import padded
from equimesh.numerics.compiled import vectorised
from equimesh.numerics.threads import run_on_threads
from equimesh.numerics.types import Array
from equimesh.sweeps.kernels import Nodes
from equimesh.sweeps.line_sums import cell_memory, cell_metrics
from equimesh.sweeps.sweep import Frame, SideNodes, Sides

# How far a mesh with closed lines is from the solution of the equations.


def closed_deviation(metric: ReferenceMetric, boundary: Boundary, mesh: Mesh) -> float:
    """As :func:`~equimesh.sweeps.deviation.deviation`, for a whole mesh with closed lines of the reference square."""
    closed = closed_of(metric.domain)
    frame, nodes = Frame.around(closed), padded(mesh, closed_of(metric.domain))
    x, y = nodes.x, nodes.y
    with np.errstate(all="ignore"):
        cells = cell_memory(x.shape[0] - 1, x.shape[1])
        cell_metrics(metric, x, y, cells)
        found = [Sides(metric, boundary, (x.shape[0], x.shape[1]), frame).moves(SideNodes.of(x, y))[0]]
        for axis in (0, 1):
            turned = cells if axis == 0 else cells.transpose(0, 2, 1)
            lengths = _squared_lengths(np.moveaxis(x, axis, 0), np.moveaxis(y, axis, 0), turned)
            first, last = frame.span(axis, x.shape[axis])
            edges = lengths[first:last]
            mean = edges.mean(axis=0)
            found.append(float((np.abs(edges - mean) / mean).max()))
    largest = max(found)
    return largest if all(map(math.isfinite, found)) else math.inf


def _squared_lengths(x: Array, y: Array, cells: Array) -> Array:
    """The squared metric lengths of the edges along the first axis, at the inner nodes of the other one."""
    dx, dy = np.diff(x, axis=0)[:, 1:-1], np.diff(y, axis=0)[:, 1:-1]
    m11, m12, m22 = 0.5 * (cells[:, :, 1:] + cells[:, :, :-1])
    return np.asarray(m11 * dx**2 + 2.0 * m12 * dx * dy + m22 * dy**2)


# Fewer nodes are not worth a second thread.
MIN_THREADED_NODES = 16_384


def deviation(
    metric: ReferenceMetric,
    boundary: Boundary,
    mesh: Mesh | MeshRows,
    *,
    u: Array | None = None,
    threads: int = 1,
) -> float:
    """The largest relative difference of a squared metric length of a mesh from the mean of its grid line.

    Infinite where a length is not a number. ``mesh`` is one of the reference square. ``u`` is
    :meth:`~equimesh.equations.metric.ReferenceMetric.u` at the nodes where that is known. The ``threads`` share the
    rows. Where only some rows of a mesh are here, so is the row of nodes before the own ones, and the number is that of
    the whole mesh. The result does not depend on the number of threads.
    """
    if is_closed(metric.domain):
        return closed_deviation(metric, boundary, mesh if isinstance(mesh, Mesh) else Mesh(mesh.x, mesh.y))
    given = MeshRows.of(mesh)
    rows = given.rows
    strips, n_eta = rows.strips, rows.shape[1]
    lines, found = np.empty((len(strips), 3, n_eta)), np.zeros((len(strips), 2))
    threads = threads if given.x.size >= MIN_THREADED_NODES else 1

    def work(thread: int) -> None:
        with np.errstate(all="ignore"):
            for k in range(thread, len(strips), threads):
                first, last = strips[k]
                before = max(first - 1, 0)
                x, y = given.nodes(before, last)
                values = None if u is None else u[before - rows.begin : last + 1 - rows.begin]
                cells = cell_memory(last - before, n_eta)
                cell_metrics(metric, x, y, cells, values)
                strip_deviation(Nodes(x, y), cells, first - before, lines[k], found[k])

    run_on_threads(threads, work)
    with np.errstate(all="ignore"):
        sides = Sides(metric, boundary, rows.shape).moves(SideNodes.of_rows(given.x, given.y, rows))[0]
        of_lines = rows.over_lines(lines)
        xi, check = (0.0, 0.0) if of_lines is None else _largest_of_lines(of_lines[:, 1:-1], rows.shape[0] - 1)
        here = [xi, found[:, 0].max(initial=0.0), found[:, 1].sum() + check]
        every = rows.joined(np.array([here]))
    if not math.isfinite(float(every[:, 2].sum())):
        return math.inf
    return max(sides, float(every[:, :2].max()))


def _largest_of_lines(lines: Array, edges: int) -> tuple[float, float]:
    """The largest relative deviation along the xi-lines, which have so many ``edges``, and the sum of their lengths."""
    sums, high, low = lines
    mean = sums / edges
    return float((np.maximum(high - mean, mean - low) / mean).max(initial=0.0)), float(sums.sum())


@vectorised
def strip_deviation(nodes: Nodes, m: Array, skipped: int, lines: Array, found: Array) -> None:
    """The squared metric lengths of a strip of cells ``m``, of which the first ``skipped`` rows belong to another one.

    ``lines`` receives the sum, the largest and the smallest of the xi-edges of every xi-line; ``found`` the largest
    relative deviation along the eta-lines between two rows of cells, and the sum of their squared lengths.
    """
    x, y = nodes
    n_eta = x.shape[1]
    sums, high, low = lines[0], lines[1], lines[2]
    sums[:], high[:], low[:] = 0.0, -np.inf, np.inf
    flux = np.empty(n_eta)
    deviation, check = 0.0, 0.0
    for c in range(skipped, m.shape[1]):
        x1, y1, x2, y2, b11, b12, b22 = x[c], y[c], x[c + 1], y[c + 1], m[0, c], m[1, c], m[2, c]
        for j in range(1, n_eta - 1):
            gx, gy = x2[j] - x1[j], y2[j] - y1[j]
            square = 0.5 * (
                (b11[j - 1] + b11[j]) * gx * gx
                + 2.0 * (b12[j - 1] + b12[j]) * gx * gy
                + (b22[j - 1] + b22[j]) * gy * gy
            )
            sums[j] += square
            high[j] = max(high[j], square)
            low[j] = min(low[j], square)
    for c in range(1, m.shape[1]):
        x1, y1 = x[c], y[c]
        a11, a12, a22, b11, b12, b22 = m[0, c - 1], m[1, c - 1], m[2, c - 1], m[0, c], m[1, c], m[2, c]
        total = 0.0
        for j in range(n_eta - 1):
            fx, fy = x1[j + 1] - x1[j], y1[j + 1] - y1[j]
            flux[j] = 0.5 * (
                (a11[j] + b11[j]) * fx * fx + 2.0 * (a12[j] + b12[j]) * fx * fy + (a22[j] + b22[j]) * fy * fy
            )
            total += flux[j]
        level, largest = total / (n_eta - 1), 0.0
        for j in range(n_eta - 1):
            largest = max(largest, abs(flux[j] - level))
        deviation = max(deviation, largest / level)
        check += total
    found[0], found[1] = deviation, check
