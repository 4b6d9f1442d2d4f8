"""How far a mesh with closed lines is from the solution of the equations."""

import math

import numpy as np

from equimesh.domains.closing import closed_of
from equimesh.equations.boundary import Boundary
from equimesh.equations.metric import ReferenceMetric
from equimesh.meshes.closed import padded
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.types import Array
from equimesh.sweeps.cell_metrics import cell_memory, cell_metrics
from equimesh.sweeps.frame import Frame
from equimesh.sweeps.side_nodes import SideNodes
from equimesh.sweeps.sides import Sides


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
