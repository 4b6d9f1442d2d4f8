"""The metric of the cells between rows of nodes."""

import numpy as np

from equimesh.equations.metric import ReferenceMetric
from equimesh.numerics.types import Array
from equimesh.sweeps import kernels


def cell_metrics(metric: ReferenceMetric, s: Array, t: Array, cells: Array, u: Array | None = None) -> None:
    """The metric of the cells between rows of nodes, in ``cells`` of shape ``(3, rows - 1, n_eta - 1)``.

    ``u`` is given at the nodes where it is known.
    """
    arc_length = metric.arc_length
    if arc_length is not None and metric.on_unit_square:
        u = metric.u(s, t) if u is None else u
        kernels.arc_length_cells(s, t, u, arc_length.a**2, arc_length.b, cells)
        return
    cells[0], cells[1], cells[2] = metric.base(_centres(s), _centres(t))
    if arc_length is not None:
        u = metric.u(s, t) if u is None else u
        kernels.arc_length_cells_on(s, t, u, arc_length.a**2, arc_length.b, cells)


def _centres(q: Array) -> Array:
    return np.asarray(0.25 * (q[1:, 1:] + q[1:, :-1] + q[:-1, 1:] + q[:-1, :-1]))
