"""Sums of squared metric lengths along the pieces of the lines of a mesh, between some of its cross lines."""

import numpy as np

from equimesh.equations.problem import Problem
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.threads import run_on_threads
from equimesh.numerics.types import Array, IntArray
from equimesh.sweeps import kernels
from equimesh.sweeps.line_sums import cell_metrics
from equimesh.sweeps.sides import WHOLE, Frame, SideNodes, Sides

# Rows that are summed at a time.
MAX_ROWS = 64


class Segments:
    """Sums of the squared metric lengths of edges for every line of a mesh, between neighbouring ``cuts``.

    ``cuts`` are nodes of the mesh along xi and along eta, in ascending order, at most ``MAX_ROWS`` rows apart along xi.
    ``along`` are the sums, of shape ``(pieces, n_eta)`` along xi and ``(pieces, n_xi)`` along eta. ``edges`` are the
    squared metric lengths of the edges of the four sides, of shape ``(2, n_eta - 1)`` left and right and
    ``(2, n_xi - 1)`` bottom and top; zero on sides that are not physical in ``frame``. The first and the last line of a
    direction have sums where they are physical sides.
    """

    def __init__(
        self,
        problem: Problem,
        shape: tuple[int, int],
        cuts: tuple[IntArray, IntArray],
        threads: int = 1,
        frame: Frame = WHOLE,
    ) -> None:
        self._problem, self._threads, self._cuts = problem, threads, cuts
        self.along = tuple(np.zeros((len(points) - 1, n)) for points, n in zip(cuts, shape[::-1], strict=True))
        self._cells = np.empty((threads, 3, MAX_ROWS + 1, shape[1] - 1))
        self._sides = Sides(problem.metric, problem.boundary, shape, frame)
        self.edges = self._sides.fluxes

    def read(self, mesh: Mesh) -> None:
        """Compute the sums of a mesh."""
        run_on_threads(self._threads, lambda worker: self._interior(worker, mesh))
        self._sides.moves(SideNodes.of(mesh.x, mesh.y))
        along_xi, along_eta = self.along
        for side in (0, -1):
            along_xi[:, side] = _pieces(self.edges[1][side], self._cuts[0])
            along_eta[:, side] = _pieces(self.edges[0][side], self._cuts[1])

    def _interior(self, worker: int, mesh: Mesh) -> None:
        cuts, (along_xi, along_eta) = self._cuts[0], self.along
        x, y = mesh.x, mesh.y
        for k in range(worker, len(cuts) - 1, self._threads):
            begin, last = int(cuts[k]), int(cuts[k + 1])
            first = max(begin, 1)
            cells = self._cells[worker, :, : last - first + 1]
            rows = slice(first - 1, last + 1)
            cell_metrics(self._problem.metric, x[rows], y[rows], cells)
            kernels.segment_sums(kernels.Nodes(x, y), cells, (begin, last), self._cuts[1], along_xi[k], along_eta)


def _pieces(lengths: Array, cuts: IntArray) -> Array:
    return np.asarray(np.add.reduceat(lengths[: cuts[-1]], cuts[:-1]))
