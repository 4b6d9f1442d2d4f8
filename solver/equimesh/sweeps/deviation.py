"""How far a mesh is from the solution of the equations: one pass over its cells, without a correction."""

import math

import numpy as np

from equimesh.equations.boundary import Boundary
from equimesh.equations.metric import ReferenceMetric
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.compiled import vectorised
from equimesh.numerics.threads import run_on_threads
from equimesh.numerics.types import Array
from equimesh.sweeps.cell_metrics import cell_metrics
from equimesh.sweeps.kernels import Nodes
from equimesh.sweeps.sides import Sides

# Nodes of a strip of rows: its intermediate arrays stay in the cache.
STRIP_NODES = 32_768
# Rows of a strip, at least: each strip also reads one row more.
MIN_STRIP_ROWS = 8
# Fewer nodes are not worth a second thread.
MIN_THREADED_NODES = 16_384


def deviation(
    metric: ReferenceMetric, boundary: Boundary, mesh: Mesh, *, u: Array | None = None, threads: int = 1
) -> float:
    """The largest relative difference of a squared metric length of a mesh from the mean of its grid line.

    Infinite where a length is not a number. ``mesh`` is one of the reference square. ``u`` is
    :meth:`~equimesh.equations.metric.ReferenceMetric.u` at the nodes where that is known. The ``threads`` share the
    rows; the result does not depend on their number.
    """
    x, y = np.ascontiguousarray(mesh.x), np.ascontiguousarray(mesh.y)
    n_xi, n_eta = x.shape
    rows = max(MIN_STRIP_ROWS, -(-STRIP_NODES // n_eta))
    starts = range(0, n_xi - 1, rows)
    lines, found = np.empty((len(starts), 3, n_eta)), np.zeros((len(starts), 2))
    threads = threads if x.size >= MIN_THREADED_NODES else 1

    def work(thread: int) -> None:
        with np.errstate(all="ignore"):
            for k in range(thread, len(starts), threads):
                first, last = starts[k], min(starts[k] + rows, n_xi - 1)
                before = max(first - 1, 0)
                here = slice(before, last + 1)
                cells = np.empty((3, last - before, n_eta - 1))
                cell_metrics(metric, x[here], y[here], cells, None if u is None else u[here])
                strip_deviation(Nodes(x[here], y[here]), cells, first - before, lines[k], found[k])

    run_on_threads(threads, work)
    with np.errstate(all="ignore"):
        sides = Sides(metric, boundary, x.shape).moves(x, y)[0]
        sums, high, low = lines[:, 0, 1:-1].sum(axis=0), lines[:, 1, 1:-1].max(axis=0), lines[:, 2, 1:-1].min(axis=0)
        mean = sums / (n_xi - 1)
        xi = float((np.maximum(high - mean, mean - low) / mean).max(initial=0.0))
    if not math.isfinite(float(sums.sum() + found[:, 1].sum())):
        return math.inf
    return max(sides, xi, float(found[:, 0].max()))


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
