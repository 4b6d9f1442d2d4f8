"""The optimized transmission condition: interfaces that yield as the rest of every grid line does."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from equimesh.equations.mesh_equations import EDGES, Cells, Condition, MeshEquations, NodalState, Rows, Triplets
from equimesh.equations.metric import ReferenceMetric
from equimesh.equations.newton_solve import MAX_FACTORISED_POINTS, NewtonSolution, newton_steps
from equimesh.equations.problem import Boundary, Problem, Side, SideLine
from equimesh.equations.problem import sides as physical_sides
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.types import Array, Pair
from equimesh.schwarz.conditions import LineData, Optimized
from equimesh.schwarz.decomposition import ENDS, Place, SubdomainWindow
from equimesh.schwarz.line_corrections import LineSums
from equimesh.schwarz.merged_mesh import MergedMeshes
from equimesh.schwarz.settings import LocalSolver
from equimesh.schwarz.subdomains import MAX_LOCAL_STEPS, Outcome, SubdomainSweeps
from equimesh.sweeps.line_sums import cell_metrics

# Interfaces that yield: the rest of every grid line outside the window shares the metric length of the line.
#
# Beyond an interface in ``beta`` a grid line has ``N`` more edges, whose squared metric lengths in the merged mesh sum
# to ``R``. Let the interface node move by ``dr``, and let the rest of the line follow so that its lengths stay equal.
# Each of them then becomes ``(R - 2 w . dr) / N`` to first order, with ``w = M r_xi`` (in units of one edge): the sum
# of a line's lengths changes by the moves of its ends in the metric. The window's own edges along the line must have
# that length, too. In one dimension this is the Dirichlet-to-Neumann map of the rest, for any number of subdomains; N,
# w and R are the Robin parameter, its weights and its data. Along the interface the mesh equations hold as in the
# interior, with the grid line beyond held fixed.


@dataclass(frozen=True, kw_only=True)
class YieldingSide:
    """One yielding interface with its data from the merged mesh: arrays over the lines that cross it.

    ``total`` is the sum of the squared metric lengths beyond it, ``weights`` are w, ``x`` and ``y`` the nodes of the
    interface.
    """

    axis: int
    end: int
    total: Array
    weights: tuple[Array, Array]
    x: Array
    y: Array

    def rest(self, x: Array, y: Array) -> Array:
        """The sum of the squared metric lengths beyond, with the nodes of the window at ``x``, ``y``."""
        line = -2 if self.end else 1
        x, y = (x[line], y[line]) if self.axis == 0 else (x[:, line], y[:, line])
        moved = self.weights[0] * (x - self.x) + self.weights[1] * (y - self.y)
        return np.asarray(self.total - 2.0 * moved if self.end else self.total + 2.0 * moved)


def yielding_sides(
    metric: ReferenceMetric, window: SubdomainWindow, state: Mesh, sums: LineSums, *, local: bool
) -> Sides:
    """The yielding sides of a window; ``state`` is its part of the merged mesh, ``sums`` are the line sums.

    ``local`` takes the length of the first edge beyond an interface for all edges there.
    """
    found = []
    for (axis, end), is_open in window.open.items():
        if is_open:
            found.append(_side(metric, window, state, sums, axis, end, local=local))
    return Sides(tuple(found), state.x.shape)


@dataclass(frozen=True)
class Sides:
    """All yielding sides of a window of some shape."""

    sides: tuple[YieldingSide, ...]
    shape: tuple[int, ...]

    def rest(self, x: Array, y: Array) -> tuple[Array, Array]:
        """The sums beyond the window, for :meth:`equimesh.sweeps.sweep.Sweep.correct`."""
        found = np.zeros((2, self.shape[1])), np.zeros((2, self.shape[0]))
        for side in self.sides:
            found[side.axis][side.end] = side.rest(x, y)
        return found


def _side(
    metric: ReferenceMetric, window: SubdomainWindow, state: Mesh, sums: LineSums, axis: int, end: int, *, local: bool
) -> YieldingSide:
    span = window.part.spans[axis]
    point = span.last if end else span.first
    edges = sums.points[axis] - 1 - point if end else point
    place = slice(-3, None) if end else slice(0, 3)
    # The interface with one line on both of its sides, the lines that cross it along the first index.
    x, y = (np.ascontiguousarray(q[place] if axis == 0 else q[:, place].T) for q in (state.x, state.y))
    weights, beyond = _weights(metric, x, y, axis, end)
    total = sums.beyond(window, axis, end)
    for along, corner in zip(ENDS, (0, -1), strict=True):
        if not window.open[1 - axis, along]:
            lengths = sums.side_edges(window, axis, end, along)
            t = (x, y)[axis][:, corner]
            weights[axis][corner] = 0.5 * float(np.sum(lengths / np.diff(t)))
            weights[1 - axis][corner] = 0.0
            beyond[corner] = lengths[end]
    return YieldingSide(
        axis=axis,
        end=end,
        total=beyond * edges if local else total,
        weights=(weights[0], weights[1]),
        x=x[1].copy(),
        y=y[1].copy(),
    )


def _weights(metric: ReferenceMetric, x: Array, y: Array, axis: int, end: int) -> tuple[list[Array], Array]:
    """``M r_xi`` at the middle one of three lines, and the squared metric length of the edges beyond it."""
    lines, points = x.shape
    cells = np.empty((3, lines - 1, points - 1))
    if axis == 0:
        cell_metrics(metric, x, y, cells)
    else:
        turned = np.empty((3, points - 1, lines - 1))
        cell_metrics(metric, np.ascontiguousarray(x.T), np.ascontiguousarray(y.T), turned)
        cells[:] = turned.transpose(0, 2, 1)
    nodal = 0.25 * (cells[:, 0, 1:] + cells[:, 0, :-1] + cells[:, 1, 1:] + cells[:, 1, :-1])
    e = 0.5 * (x[2] - x[0])[1:-1], 0.5 * (y[2] - y[0])[1:-1]
    weights = [np.zeros(points), np.zeros(points)]
    weights[0][1:-1] = nodal[0] * e[0] + nodal[1] * e[1]
    weights[1][1:-1] = nodal[1] * e[0] + nodal[2] * e[1]
    edge = 0.5 * (cells[:, end, 1:] + cells[:, end, :-1])
    d = (x[1 + end] - x[end])[1:-1], (y[1 + end] - y[end])[1:-1]
    lengths = np.zeros(points)
    lengths[1:-1] = edge[0] * d[0] ** 2 + 2.0 * edge[1] * d[0] * d[1] + edge[2] * d[1] ** 2
    return weights, lengths


# The equations of a subdomain whose interfaces yield, for Newton's method. Sweeps solve the same equations.
#
# The window's outermost line beyond an interface is held. By the equation across the interface, the last edge inside
# has the metric length of those beyond, which :class:`equimesh.schwarz.optimized.YieldingSide` gives.


def equations(problem: Problem, window: SubdomainWindow, held: Mesh, yielding: Sides) -> MeshEquations:
    """The equations of a window, with its outermost lines beyond interfaces at their positions in ``held``."""
    physical = [side for place, side in physical_sides(problem.boundary).items() if not window.open[place]]
    edges = tuple(
        (float(span.first), float(points - 1 - span.last))
        for span, points in zip(window.part.spans, problem.grid.shape, strict=True)
    )
    conditions: list[Condition] = [*physical]
    for side in yielding.sides:
        beyond = edges[side.axis][side.end]
        conditions.append(YieldingLine(side=side, edges=beyond))
        # The node of an orthogonal side on an interface follows the interior, like all nodes of that side.
        if problem.boundary is not Boundary.ORTHOGONAL:
            ends = [end for end in ENDS if not window.open[1 - side.axis, end]]
            conditions += [YieldingEnd(side=side, edges=beyond, end=end, kind=problem.boundary) for end in ends]
    conditions += [HeldLine(axis=side.axis, end=side.end, held=held) for side in yielding.sides]
    return MeshEquations(problem.metric, window.shape, (problem.grid.d_xi, problem.grid.d_eta), conditions)


@dataclass(frozen=True, kw_only=True)
class HeldLine:
    """The outermost line at one end of a window, at its position in ``held``, a mesh of the window's shape."""

    axis: int
    end: int
    held: Mesh

    def rows(self, window: NodalState) -> Rows:
        """Coordinates minus those that are held."""
        edge = -1 if self.end else 0
        place = edge if self.axis == 0 else (slice(None), edge)
        unknown = np.concatenate([numbers[place] for numbers in window.numbers])
        values = np.concatenate([window.x[place] - self.held.x[place], window.y[place] - self.held.y[place]])
        return Rows(unknown, values, lambda: [(unknown, unknown, np.ones(unknown.size))])


@dataclass(frozen=True, kw_only=True)
class YieldingLine:
    """A yielding interface without its ends, with ``edges`` of the grid beyond: the equation across it.

    The squared metric length of the last edge inside, minus the mean of those beyond as they yield.
    """

    side: YieldingSide
    edges: float

    def rows(self, window: NodalState) -> Rows:
        """One equation for every line that crosses the interface in the interior of the window."""
        turned = window if self.side.axis == 0 else window.turned()
        # Two lines of nodes: the interface and the one inside, in the order of the grid.
        own, first = (1, -3) if self.side.end else (0, 1)
        cells = Cells(_between(turned, first))
        lower, upper = cells.fluxes[0].value[0], cells.fluxes[1].value[0]
        line = -2 if self.side.end else 1
        rest = self.side.rest(window.x, window.y)[1:-1] / turned.d_xi**2
        row = turned.numbers[0][line, 1:-1]
        return Rows(row, upper[:-1] + lower[1:] - rest / self.edges, lambda: self._triplets(turned, cells, own, row))

    def _triplets(self, turned: NodalState, cells: Cells, own: int, row: npt.NDArray[np.int64]) -> Triplets:
        found: Triplets = []
        for edge, inside in ((1, slice(0, -1)), (0, slice(1, None))):
            for corner in range(4):
                for axis in range(2):
                    by = cells.flux_derivatives[edge][corner][axis][0, inside]
                    found.append((row, cells.unknown(corner, axis)[0, inside], by))
        sign = 2.0 if self.side.end else -2.0
        weights = self.side.weights if self.side.axis == 0 else self.side.weights[::-1]
        for axis in range(2):
            by = sign * weights[axis][1:-1] / (self.edges * turned.d_xi**2)
            found.append((row, cells.window.numbers[axis][own, 1:-1], by))
        return found


@dataclass(frozen=True, kw_only=True)
class YieldingEnd:
    """The corner of a yielding interface and a physical side: as :class:`YieldingLine`, on the side at its ``end``."""

    side: YieldingSide
    edges: float
    end: int
    kind: Boundary

    def rows(self, window: NodalState) -> Rows:
        """One equation, for the tangential coordinate on the side."""
        axis, corner = self.side.axis, -1 if self.end else 0
        along = Side(axis=1 - axis, end=self.end, kind=self.kind)
        place = slice(-3, -1) if self.side.end else slice(1, 3)
        unknown = along.line(window.numbers[axis])[place]
        edge = SideLine.of(along, window.metric, along.line((window.x, window.y)[axis])[place])
        scale = 1.0 / (window.d_xi, window.d_eta)[axis] ** 2
        rest = self.side.rest(window.x, window.y)[corner] / self.edges
        own = 1 if self.side.end else 0
        row = unknown[own : own + 1]

        def triplets() -> Triplets:
            sign = 2.0 if self.side.end else -2.0
            by_rest = sign * np.atleast_1d(self.side.weights[axis][corner]) / self.edges
            by_first, by_second = edge.flux_derivatives
            return [
                (row, unknown[:1], scale * by_first),
                (row, unknown[1:], scale * by_second),
                (row, row, scale * by_rest),
            ]

        return Rows(row, scale * (edge.fluxes - rest), triplets)


def _between(window: NodalState, first: int) -> NodalState:
    """Two neighbouring lines of a window, from line ``first`` on."""
    rows = slice(first, first + 2)
    numbers = window.numbers[0][rows], window.numbers[1][rows]
    lines = {name: getattr(window, name)[rows] for name in ("x", "y", "u", "u_x", "u_y")}
    return replace(window, numbers=numbers, **lines)


# The derivative of the data of subdomains with yielding interfaces by the merged mesh.

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
            yielding_sides(metric, window, window.restrict(mesh), self._sums, local=self._local).sides
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


# Sweeps of a subdomain end when their moves are this share of the first: the interface data is no more accurate. A
# tenth of it leads to the same numbers of iterations.
SWEEP_ACCURACY = 0.1
MAX_SWEEPS = 4


class OptimizedSubdomains:
    """All subdomains of a decomposition, with the optimized condition.

    Sweeps of a subdomain end when they move its nodes by no more than ``enough``. With ``in_turns`` each subdomain also
    writes its overlap into the merged mesh, for subdomains of later turns.
    """

    def __init__(
        self,
        problem: Problem,
        merged: MergedMeshes,
        condition: Optimized,
        solver: LocalSolver,
        *,
        in_turns: bool,
        enough: float,
        threads: int,
    ) -> None:
        self.windows = [
            SubdomainWindow(merged.decomposition, part, condition.ghosts) for part in merged.decomposition.parts
        ]
        self._problem, self._local = problem, condition.data is LineData.LOCAL
        self._by_sweeps, self._enough = solver is LocalSolver.SWEEPS, enough
        self._merged, self._sums = merged, merged.line_sums(problem, self.windows, threads, local=self._local)
        shape, windows = problem.grid.shape, {k: self.windows[k] for k in merged.numbers}
        self._sweeps = {k: SubdomainSweeps(problem, w.shape, w.frame(shape)) for k, w in windows.items()}
        self._mesh, self._in_turns = Mesh.uniform(problem.grid), in_turns

    def restart(self, mesh: Mesh) -> None:
        """Nothing to do: every solve reads the merged mesh."""

    def begin(self, mesh: Mesh, turn: Sequence[int] | None = None) -> None:  # noqa: ARG002
        """Read the merged mesh ``mesh`` in the next solves."""
        self._mesh = mesh
        self._sums.read(mesh)

    def solve(self, k: int) -> Outcome:
        """The solution of a subdomain, from its part of the merged mesh.

        By sweeps, as accurate as an iteration needs. Where they fail or are not requested, by Newton's method.
        """
        start, sides = self.received(k)
        if self._by_sweeps:
            solution = self._sweeps[k].solve(
                start, sides.rest, accuracy=SWEEP_ACCURACY, most=MAX_SWEEPS, enough=self._enough
            )
            if solution.converged:
                return Outcome(solution)
            start, sides = self.received(k)  # the sweeps have overwritten it
        if not start.is_folded and (start.x.size <= MAX_FACTORISED_POINTS or not self._by_sweeps):
            *_, solution = newton_steps(self.equations(k), start, most_steps=MAX_LOCAL_STEPS, fast=True)
            if solution.converged:
                return Outcome(solution)
        return Outcome(NewtonSolution(start, 0, math.inf, converged=False))

    def keep(self, k: int, state: Mesh) -> None:
        """Nothing to do: every solve reads the merged mesh."""

    def place(self, k: int) -> Place:
        """The nodes that a subdomain owns; in turns also the nodes of its overlap."""
        window = self.windows[k]
        return window.covered if self._in_turns else window.part.owned

    def state(self, k: int, mesh: Mesh) -> Mesh:
        """The part of the merged mesh."""
        return self._merged.restrict(self.windows[k], mesh)

    def equations(self, k: int) -> MeshEquations:
        """The equations of a subdomain, with its data from the merged mesh."""
        start, sides = self.received(k)
        return equations(self._problem, self.windows[k], start, sides)

    def slopes(self, states: Sequence[Mesh]) -> YieldingSlopes:
        """The derivative of the received data by the mesh that is read, at the solutions ``states``."""
        return YieldingSlopes(self._problem, self.windows, self._sums, self._mesh, states, local=self._local)

    def received(self, k: int) -> tuple[Mesh, Sides]:
        """The data of a subdomain: its part of the merged mesh, and its yielding sides."""
        start = self._merged.restrict(self.windows[k], self._mesh)
        return start, yielding_sides(self._problem.metric, self.windows[k], start, self._sums, local=self._local)

    def sent(self, turn: Sequence[int]) -> int:  # noqa: ARG002
        """The sum of each line, over all interfaces that it crosses: all subdomains pass it on, in every turn."""
        lines = [w.shape[1 - axis] for w in self.windows for (axis, _), is_open in w.open.items() if is_open]
        return 0 if self._local else sum(lines)
