"""Least error on paved meshes: smooth displacements on a background grid, then of all nodes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import scipy

from equimesh.least_error.block_levels import COARSEST_CELLS
from equimesh.least_error.cells import Cells
from equimesh.least_error.charts import CurveChart
from equimesh.least_error.descent import descend
from equimesh.least_error.evaluation import Evaluation, Result
from equimesh.least_error.objective import Objective
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.types import Array, BoolArray, IntArray

# Smooth displacements of the nodes of any mesh: cubic splines on a coarse background grid over its bounding box.
#
# Nodes of the boundary move along it. What a spline would move them across it is taken away, with its harmonic
# extension inside, so that lines of nodes near the boundary keep their distances from it.

REACH = 4
"""Splines in each direction that are not 0 at a place."""
MIN_SUPPORT = 1e-3
"""The smallest sum of squares of a spline over the nodes inside, for which it is used."""


class Boundary:
    """What moves of nodes become at the boundary of a mesh of a ``chart`` at ``mesh``, shape ``(2, nodes)``."""

    def __init__(self, chart: CurveChart, mesh: Array, corners: IntArray) -> None:
        nodes = mesh.shape[1]
        self._inside = chart.free[1] > 0.0
        self._along = np.stack([_slope(chart, mesh, axis)[0] for axis in (0, 1)]) * chart.free[0]
        self._along[:, self._inside] = 0.0
        squares = (self._along**2).sum(axis=0)
        self._across = np.divide(self._along, squares, out=np.zeros_like(self._along), where=squares > 0.0)
        self._factors, self._links = _laplacian(corners, self._inside, nodes)

    @property
    def inside(self) -> BoolArray:
        """Which nodes are free both ways, shape ``(nodes,)``."""
        return np.asarray(self._inside)

    def moves(self, moves: Array) -> Array:
        """The moves of the unknowns, shape ``(2, nodes)``, for displacements of the nodes, shape ``(2, nodes)``."""
        inside, out = self._inside, np.zeros_like(moves)
        out[0, ~inside] = (self._across * moves)[:, ~inside].sum(axis=0)
        rest = moves[:, ~inside] - self._along[:, ~inside] * out[0, ~inside]
        out[:, inside] = moves[:, inside] - self._factors.solve(self._links @ rest.T).T
        return out

    def pulled_back(self, gradient: Array) -> Array:
        """The derivatives by the displacements of the nodes, for those by the unknowns: the transpose of ``moves``."""
        inside, out = self._inside, np.zeros_like(gradient)
        out[:, inside] = gradient[:, inside]
        rest = -(self._links.T @ self._factors.solve(np.ascontiguousarray(gradient[:, inside].T))).T
        slope = gradient[0, ~inside] - (self._along[:, ~inside] * rest).sum(axis=0)
        out[:, ~inside] = rest + self._across[:, ~inside] * slope
        return out


class Background:
    """Displacements of the nodes by the coefficients of splines, on a grid with ``cells`` along the longer side."""

    def __init__(self, boundary: Boundary, points: Array, cells: int) -> None:
        """``points`` are the nodes of the initial mesh, shape ``(2, nodes)``."""
        low, high = points.min(axis=1), points.max(axis=1)
        self.spacing = float((high - low).max()) / cells
        """The side of a cell of the grid."""
        self._boundary = boundary
        splines = _splines((points - low[:, None]) / self.spacing)
        squares = splines.multiply(splines).T @ boundary.inside.astype(np.float64)
        self._splines = scipy.sparse.csr_array(splines[:, np.flatnonzero(squares > MIN_SUPPORT)])
        self._transposed = scipy.sparse.csr_array(self._splines.T)
        self._squares = scipy.sparse.csr_array(self._transposed.multiply(self._transposed))

    @property
    def count(self) -> int:
        """How many splines there are."""
        return int(self._splines.shape[1])

    def moves(self, coefficients: Array) -> Array:
        """The moves of the unknowns of the mesh, shape ``(2, nodes)``; ``coefficients`` have shape ``(2, count)``."""
        return self._boundary.moves((self._splines @ coefficients.T).T)

    def pulled_back(self, gradient: Array) -> Array:
        """The derivatives by the coefficients, for those by the unknowns."""
        return np.ascontiguousarray((self._transposed @ self._boundary.pulled_back(gradient).T).T)

    def blocks(self, blocks: Array) -> Array:
        """Approximate second derivatives of each coefficient, shape ``(3, count)``, for those of each node."""
        return np.ascontiguousarray((self._squares @ (blocks * self._boundary.inside).T).T)


def _slope(chart: CurveChart, mesh: Array, axis: int) -> Array:
    """The derivatives of x or y of every node by its unknowns, shape ``(2, nodes)``."""
    collected, nothing = np.zeros((5, mesh.shape[1])), np.zeros_like(mesh)
    collected[axis] = 1.0
    return chart.derivatives(mesh, collected, nothing, nothing[0])[0].copy()


def _laplacian(
    corners: IntArray, inside: BoolArray, nodes: int
) -> tuple[scipy.sparse.linalg.SuperLU, scipy.sparse.csr_array]:
    """The graph Laplacian of the edges between nodes inside, as its factors, and its edges to the boundary."""
    ends = np.concatenate([corners[:, [k, (k + 1) % 4]] for k in range(4)])
    both = np.concatenate([ends, ends[:, ::-1]])
    links = scipy.sparse.csr_array((np.ones(len(both)), (both[:, 0], both[:, 1])), shape=(nodes, nodes))
    rows = scipy.sparse.csr_array(links[np.flatnonzero(inside)])
    own = scipy.sparse.csr_array(scipy.sparse.diags_array(rows.sum(axis=1)) - rows[:, np.flatnonzero(inside)])
    factors = scipy.sparse.linalg.splu(
        own.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    )
    return factors, scipy.sparse.csr_array(rows[:, np.flatnonzero(~inside)])


def _splines(places: Array) -> scipy.sparse.csr_array:
    """The uniform cubic B-splines at places, shape ``(2, nodes)``, in units of the grid: shape ``(nodes, splines)``."""
    nodes = places.shape[1]
    first = np.floor(places).astype(np.int64)
    t = places - first
    weights = np.stack([(1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, -3 * t**3 + 3 * t**2 + 3 * t + 1, t**3]) / 6.0
    numbers = first[None] + np.arange(REACH)[:, None, None]
    columns = int(numbers[:, 1].max()) + 1
    column = numbers[:, None, 0] * columns + numbers[None, :, 1]
    weight = weights[:, None, 0] * weights[None, :, 1]
    row = np.broadcast_to(np.arange(nodes), column.shape)
    size = (int(numbers[:, 0].max()) + 1) * columns
    return scipy.sparse.csr_array((weight.ravel(), (row.ravel(), column.ravel())), shape=(nodes, size))


def background_counts(nodes: int, first: int, fewest_nodes: float) -> list[int]:
    """Cells of the grids, each with twice as many as the one before, while a cell has ``fewest_nodes`` nodes."""
    most = math.sqrt(nodes / fewest_nodes)
    return [first * 2**k for k in range(max(0, math.floor(math.log2(max(1.0, most / first))) + 1))]


FEWEST_POINTS = 300
"""Points of a mesh, at least: fewer need no displacements that are smooth."""
FIRST_GRID = 4
"""Cells along the longer side of the coarsest background grid."""
FEWEST_NODES = 9.0
"""Nodes in a cell of the finest background grid."""
GRID_STEPS = 12
"""Steps of descent on each background grid, at most."""
NODE_STEPS = 20
"""Steps of descent of the nodes, at most."""


def is_paved(mesh: Mesh) -> bool:
    """Whether the blocks of a mesh are too small for coarser meshes: fewer cells than these have in the mean."""
    few = len(mesh.cells) < COARSEST_CELLS**2 * len(mesh.blocks)
    return few and len(mesh.points) > FEWEST_POINTS and not mesh.ties.size


def paved_steps(nodes: int, more: float) -> int:
    """The largest number of steps of :func:`descend_paved`, with ``more`` times the usual steps."""
    grids = background_counts(nodes, FIRST_GRID, FEWEST_NODES)
    return round(GRID_STEPS * more) * len(grids) + round(NODE_STEPS * more)


def descend_paved(
    objective: Objective, chart: CurveChart, initial: Array, first: Array, min_decrease: float, more: float
) -> Iterator[tuple[Array, Result]]:
    """The meshes of the descent, as :func:`~equimesh.least_error.descent.descend` has them."""
    points = np.stack(chart.nodes(initial))
    boundary = Boundary(chart, initial, objective.cells.corners)
    now, is_first = first, True
    for cells in background_counts(points.shape[1], FIRST_GRID, FEWEST_NODES):
        smooth = Smooth(objective, Background(boundary, points, cells), now)
        steps = descend(smooth, smooth.zero, round(GRID_STEPS * more), min_decrease)
        for number, (coefficients, then) in enumerate(steps):
            now = smooth.unknowns(coefficients)
            if number > 0 or is_first:
                yield now, then
        is_first = False
    for number, found in enumerate(descend(objective, now, round(NODE_STEPS * more), min_decrease)):
        if number > 0 or is_first:
            yield found


class Smooth:
    """An objective as a function of the coefficients of a ``background``, which move the nodes from ``start``."""

    def __init__(self, objective: Objective, background: Background, start: Array) -> None:
        self._objective, self._background, self._start = objective, background, start
        self.zero = start[:, : background.count] * 0.0
        """The coefficients of ``start``, shape ``(2, count)``."""

    @property
    def cells(self) -> Cells:
        """The cells of the mesh."""
        return self._objective.cells

    @property
    def length(self) -> float:
        """The length of a row of cells: the spacing of the background times the root of their number."""
        return float(self._background.spacing * self.cells.count**0.5)

    def unknowns(self, coefficients: Array) -> Array:
        """The unknowns of the mesh."""
        return self._start + self._background.moves(coefficients)

    def cut(self, mesh: Array) -> bool:
        """Cut triangles anew; whether the cuts are others than before."""
        return self._objective.cut(self.unknowns(mesh))

    @property
    def ties(self) -> IntArray:
        """Nothing: no nodes are tied."""
        return np.empty((0, 2), dtype=np.int64)

    @property
    def parts(self) -> None:
        """Nothing: compiled code knows no background."""

    @property
    def beyond(self) -> float:
        """See :attr:`~equimesh.least_error.objective.Objective.beyond`."""
        return self._objective.beyond

    def smallest_share(self, mesh: Array) -> float:
        """The smallest Jacobian of a corner over that of the start; not positive for a folded mesh."""
        return self._objective.smallest_share(self.unknowns(mesh))

    def evaluate(self, mesh: Array, floor: float | None = None) -> Evaluation | None:
        """The objective with its derivatives by the coefficients; ``None`` where it has none."""
        found = self._objective.evaluate(self.unknowns(mesh), floor)
        if found is None:
            return None
        background = self._background
        return replace(found, gradient=background.pulled_back(found.gradient), blocks=background.blocks(found.blocks))
