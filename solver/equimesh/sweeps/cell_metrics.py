"""The metric of the cells between rows of nodes."""

import numpy as np

from equimesh.equations.metric import ReferenceMetric
from equimesh.numerics.types import Array
from equimesh.sweeps import kernels

# Numbers that are left free on either side of the metric of cells, besides two rows of it.
MARGIN = 4_096


def cell_memory(rows: int, n_eta: int) -> Array:
    """Memory for the metric of ``rows`` rows of cells, shape ``(3, rows, n_eta - 1)``, apart from all other memory.

    A compiled loop looks whether its arrays may overlap, and then takes another way, which rounds differently. Where an
    array begins right behind another one it takes them for overlapping. So the last bit of a mesh would depend on where
    the memory happens to lie.
    """
    size, margin = 3 * rows * (n_eta - 1), MARGIN + 2 * n_eta
    return np.empty(size + 2 * margin)[margin : margin + size].reshape(3, rows, n_eta - 1)


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
