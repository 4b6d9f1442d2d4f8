"""One part of a sweep: the strips of rows that one thread corrects, in two phases.

Between the phases stand the sums along the xi-lines, to which all parts contribute. A part reads the rows next to its
own, and writes its own only. The whole grid is the case of one part.
"""

import numpy as np

from equimesh.equations.metric import ReferenceMetric
from equimesh.meshes.parts import Part, Parts
from equimesh.meshes.strips import strips_of
from equimesh.numerics.types import Array, SingleArray
from equimesh.sweeps import closed_kernels, kernels
from equimesh.sweeps.cell_metrics import cell_memory, cell_metrics
from equimesh.sweeps.kernels import Lines, Moved, Nodes, Strip
from equimesh.sweeps.line_sums import LineSums
from equimesh.sweeps.sides import finite_or_infinite


class PartSweep:
    """The corrections of one part, with the memory for the metric of its cells."""

    def __init__(
        self,
        metric: ReferenceMetric,
        parts: Parts,
        part: Part,
        summed: int,
        along_q: SingleArray | None = None,
    ) -> None:
        """The xi-edges from rows of the grid below ``summed`` belong to the xi-lines.

        ``along_q`` of shape ``(2, n_xi, n_eta)`` is working memory where the eta-lines are closed.
        """
        self._along_q = along_q
        self._metric, self._last = metric, parts.shape[0] - 1 - parts.begin
        self._first = 1 - parts.begin
        self._strips = [(k, Strip(*parts.strips[k], summed - parts.begin)) for k in part.strips]
        # As many rows for every part: the machine code of a kernel, and so its rounding, depends on the layout.
        rows = max((last - first for first, last in strips_of(parts.shape)), default=0)
        self._cells = cell_memory(rows + 1, parts.shape[1])

    def along_eta(
        self, nodes: Nodes, u: Array | None, along: tuple[Array, Array], lines: Lines, out: Moved, sums: LineSums
    ) -> float:
        """The first phase: correct the eta-lines, and sum the xi-edges of every strip.

        ``along`` holds the moves of the nodes on the sides: along eta (left, right), and along xi (bottom, top) in the
        rows that are held. ``u`` is given at all nodes where it is known. Returns the largest relative deviation along
        the lines.
        """
        (x, y), (along_eta, along_xi), largest = nodes, along, 0.0
        for k, strip in self._strips:
            cells, rows = self._cells[:, : strip.last - strip.first + 1], slice(strip.first - 1, strip.last + 1)
            cell_metrics(self._metric, x[rows], y[rows], cells, None if u is None else u[rows])
            if strip.first == self._first:
                kernels.end_edges(x, y, cells, 0, along_eta[0], sums.pushes[0], sums.first)
            if strip.last == self._last:
                kernels.end_edges(x, y, cells, -1, along_eta[1], sums.pushes[1], sums.first)
            if self._along_q is not None:
                found = closed_kernels.closed_eta_corrections(nodes, cells, strip, out, self._along_q, sums.strips[k])
            else:
                found = kernels.eta_corrections(nodes, cells, strip, along_xi, lines, out, sums.strips[k])
            if sums.closings is not None:
                closed_kernels.closing_sums(strip, sums.edges, out, sums.closings[k])
            largest = max(largest, finite_or_infinite(found))
        return largest

    def along_xi(self, nodes: Nodes, out: Moved, sums: LineSums) -> tuple[float, float]:
        """The second phase: add the corrections of the xi-lines, from the starts of the strips.

        Returns the largest relative deviation along the lines, and the largest move of a coordinate.
        """
        found = np.zeros((len(self._strips), 2))
        for (k, strip), largest in zip(self._strips, found, strict=True):
            data = nodes, strip, sums.levels, sums.starts[k], out
            if self._along_q is None:
                kernels.xi_corrections(*data, largest)
            else:
                closed_kernels.closed_xi_corrections(*data, self._along_q, largest)
        deviation, move = (max(map(finite_or_infinite, column), default=0.0) for column in found.T.tolist())
        return deviation, move
