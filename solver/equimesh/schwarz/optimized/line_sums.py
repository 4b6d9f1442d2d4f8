"""Sums of squared metric lengths along the lines of a mesh, on both sides of some of its cross lines."""

import numpy as np

from equimesh.equations.problem import Problem
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.threads import run_on_threads
from equimesh.numerics.types import Array
from equimesh.sweeps import kernels
from equimesh.sweeps.cell_metrics import cell_metrics
from equimesh.sweeps.sides import Sides

# Rows that are summed at a time.
MAX_ROWS = 64


class LineSums:
    """Sums of the squared metric lengths of edges for every grid line, on both sides of some grid points.

    ``at`` holds these grid points, along xi and along eta. ``edges`` are the squared metric lengths of the edges of the
    four sides, of shape ``(2, n_eta - 1)`` left and right, ``(2, n_xi - 1)`` bottom and top.
    """

    def __init__(self, problem: Problem, at: tuple[set[int], set[int]], threads: int = 1) -> None:
        self._problem, self._threads = problem, threads
        self.points = shape = problem.grid.shape
        strips = set(range(0, shape[0], MAX_ROWS))
        self._cuts = tuple(
            np.array(sorted({0, *points, n - 1})) for points, n in zip((at[0] | strips, at[1]), shape, strict=True)
        )
        self._sums = tuple(np.zeros((len(cuts) - 1, n)) for cuts, n in zip(self._cuts, shape[::-1], strict=True))
        self._cells = np.empty((threads, 3, MAX_ROWS + 1, shape[1] - 1))
        self._sides = Sides(problem.metric, problem.boundary, shape)
        self.edges = self._sides.fluxes

    def read(self, mesh: Mesh) -> None:
        """Compute the sums of a mesh."""
        run_on_threads(self._threads, lambda worker: self._interior(worker, mesh))
        self._sides.moves(mesh.x, mesh.y)
        along_xi, along_eta = self._sums
        for side in (0, -1):
            along_xi[:, side] = np.add.reduceat(self.edges[1][side], self._cuts[0][:-1])
            along_eta[:, side] = np.add.reduceat(self.edges[0][side], self._cuts[1][:-1])

    def beyond(self, axis: int, end: int, point: int) -> Array:
        """The sums on one side (``end``) of a grid point, for every line along ``axis``."""
        k = int(np.searchsorted(self._cuts[axis], point))
        return np.asarray(self._sums[axis][k:].sum(axis=0) if end else self._sums[axis][:k].sum(axis=0))

    def _interior(self, worker: int, mesh: Mesh) -> None:
        cuts, (along_xi, along_eta) = self._cuts[0], self._sums
        x, y = mesh.x, mesh.y
        for k in range(worker, len(cuts) - 1, self._threads):
            begin, last = int(cuts[k]), int(cuts[k + 1])
            first = max(begin, 1)
            cells = self._cells[worker, :, : last - first + 1]
            rows = slice(first - 1, last + 1)
            cell_metrics(self._problem.metric, x[rows], y[rows], cells)
            kernels.segment_sums(kernels.Nodes(x, y), cells, (begin, last), self._cuts[1], along_xi[k], along_eta)
