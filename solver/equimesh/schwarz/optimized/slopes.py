"""The derivative of the data of subdomains with yielding interfaces by the merged mesh."""

from collections.abc import Sequence

import numpy as np

from equimesh.equations.boundary import Boundary, SideLine
from equimesh.equations.boundary import sides as physical_sides
from equimesh.equations.mesh_equations import EDGES, Cells
from equimesh.equations.problem import Problem
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.types import Array, Pair
from equimesh.schwarz.lines.line_sums import LineSums
from equimesh.schwarz.optimized import sides
from equimesh.schwarz.optimized.sides import YieldingSide
from equimesh.schwarz.window import ENDS, SubdomainWindow

# How far nodes move, in units of the square, for the difference quotient of an interface's weights.
DIFFERENCE_STEP = 1e-6


class YieldingSlopes:
    """The derivative of the right sides that all subdomains receive, where they have the solutions ``states``.

    Held lines and sums of metric lengths are differentiated exactly, the weights of an interface by a central
    difference quotient. These weights are multiplied by moves of the interface, which are zero at the fixed point.
    """

    def __init__(
        self,
        problem: Problem,
        windows: Sequence[SubdomainWindow],
        sums: LineSums,
        mesh: Mesh,
        states: Sequence[Mesh],
        *,
        local: bool,
    ) -> None:
        """``sums`` are recomputed for other meshes, and finally for ``mesh``."""
        self._problem, self._windows, self._sums, self._local = problem, windows, sums, local
        self._mesh, self._states, self._edges = mesh, states, EdgeSlopes(problem, mesh)
        self._sides = self._sides_of(mesh)

    def received(self, change: Pair) -> list[Array]:
        """For every subdomain the change of its equations' right side, when the nodes of the mesh move by ``change``.

        ``change`` is of two arrays of the grid's shape, a right side as the vector of the subdomain's equations.
        """
        edges = self._edges.along(change)
        step = DIFFERENCE_STEP / max(float(np.abs(change).max()), np.finfo(np.float64).tiny)
        ahead, behind = (
            self._sides_of(Mesh(self._mesh.x + h * change[0], self._mesh.y + h * change[1])) for h in (step, -step)
        )
        self._sums.read(self._mesh)
        found = []
        for k, window in enumerate(self._windows):
            right = np.zeros((2, *window.shape))
            held = [q[window.slices] for q in change]
            for side, upper, lower in zip(self._sides[k], ahead[k], behind[k], strict=True):
                slopes = [(u - w) / (2 * step) for u, w in zip(upper.weights, lower.weights, strict=True)]
                self._close(k, side, right, self._rest(k, side, held, slopes, edges))
            for side in self._sides[k]:
                rim = -1 if side.end else 0
                place = rim if side.axis == 0 else (slice(None), rim)
                for component in (0, 1):
                    right[component][place] = held[component][place]
            found.append(right.ravel())
        return found

    def _close(self, k: int, side: YieldingSide, right: Array, rest: Array) -> None:
        """Add the change of the sums beyond an interface to the equations across it."""
        window, points = self._windows[k], self._problem.grid.shape[side.axis]
        span = window.part.spans[side.axis]
        edges = points - 1 - span.last if side.end else span.first
        follows = self._problem.boundary is Boundary.ORTHOGONAL
        lower, upper = (int(window.open[1 - side.axis, end] or follows) for end in ENDS)
        nodes, line = slice(lower, rest.size - upper), -2 if side.end else 1
        place = (line, nodes) if side.axis == 0 else (nodes, line)
        spacing = (self._problem.grid.d_xi, self._problem.grid.d_eta)[side.axis]
        right[side.axis][place] = rest[nodes] / (edges * spacing**2)

    def _rest(self, k: int, side: YieldingSide, held: list[Array], slopes: list[Array], edges: Pair) -> Array:
        """The change of the sum of squared metric lengths beyond an interface, with a fixed state of the window."""
        window, line = self._windows[k], -2 if side.end else 1
        place = (line, slice(None)) if side.axis == 0 else (slice(None), line)
        state = self._states[k]
        moved = slopes[0] * (state.x[place] - side.x) + slopes[1] * (state.y[place] - side.y)
        moved -= side.weights[0] * held[0][place] + side.weights[1] * held[1][place]
        lines = edges[side.axis] if side.axis == 0 else edges[side.axis].T
        lines = lines[:, window.slices[1 - side.axis]]
        span = window.part.spans[side.axis]
        beyond = lines[span.last :] if side.end else lines[: span.first]
        total = beyond[0 if side.end else -1] * len(beyond) if self._local else beyond.sum(axis=0)
        return np.asarray(total - 2.0 * moved if side.end else total + 2.0 * moved)

    def _sides_of(self, mesh: Mesh) -> list[tuple[YieldingSide, ...]]:
        self._sums.read(mesh)
        metric = self._problem.metric
        return [
            sides.sides(metric, window, window.restrict(mesh), self._sums, local=self._local).sides
            for window in self._windows
        ]


class EdgeSlopes:
    """The derivative of the squared metric length of every edge of ``mesh``, exact for the discrete metric."""

    def __init__(self, problem: Problem, mesh: Mesh) -> None:
        equations = problem.equations()
        self._cells = Cells(equations.window(equations.vector(mesh)))
        self._spacing = problem.grid.d_xi, problem.grid.d_eta
        self._sides = []
        # An orthogonal side follows the interior: no subdomain receives the lengths of its edges.
        if problem.boundary is not Boundary.ORTHOGONAL:
            for side in physical_sides(problem.boundary).values():
                line = SideLine.of(side, problem.metric, side.line((mesh.x, mesh.y)[1 - side.axis]))
                self._sides.append((side, line.flux_derivatives))

    def along(self, change: Pair) -> Pair:
        """The change for the xi-edges, ``(n_xi - 1, n_eta)``, and the eta-edges, when the nodes move by ``change``."""
        n_xi, n_eta = change[0].shape
        found = np.zeros((n_xi - 1, n_eta)), np.zeros((n_xi, n_eta - 1))
        halves = [self._half(edge, change) for edge in range(len(EDGES))]
        found[0][:, 1:-1] = self._spacing[0] ** 2 * (halves[1][:, :-1] + halves[0][:, 1:])
        found[1][1:-1] = self._spacing[1] ** 2 * (halves[3][:-1] + halves[2][1:])
        for side, (by_first, by_second) in self._sides:
            moved = side.line(change[1 - side.axis])
            side.line(found[1 - side.axis])[:] = by_first * moved[:-1] + by_second * moved[1:]
        return found

    def _half(self, edge: int, change: Pair) -> Array:
        """The change of the fluxes through one edge of every cell."""
        found = np.zeros_like(self._cells.centre[0])
        for corner, by_node in enumerate(self._cells.flux_derivatives[edge]):
            for by, moved in zip(by_node, change, strict=True):
                found += by * self._cells.corner(moved, corner)
        return found
