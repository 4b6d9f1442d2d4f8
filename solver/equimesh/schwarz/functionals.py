"""The transmission conditions of the paper, as functionals that a receiver sets equal to its neighbour's."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

import numpy as np

from equimesh.equations.mesh_equations import Condition, MeshEquations, NodalState, Rows, Triplets
from equimesh.equations.newton_solve import NewtonSolution, newton_steps
from equimesh.equations.problem import Problem, sides
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.types import Array
from equimesh.schwarz.conditions import Classical, PairOfFunctionals
from equimesh.schwarz.decomposition import AXES, ENDS, Decomposition, Place, Subdomain, SubdomainWindow
from equimesh.schwarz.merged_mesh import MergedMeshes
from equimesh.schwarz.settings import LocalSolver
from equimesh.schwarz.subdomains import MAX_LOCAL_STEPS, Outcome, SubdomainSweeps
from equimesh.sweeps.sweep import Frame

# An interface of a subdomain as rows of equations, closed by a transmission condition.


@dataclass(frozen=True, kw_only=True)
class InterfaceData:
    """The values of a condition's two functionals that a subdomain receives, shape ``(k,)`` each."""

    normal: Array
    tangential: Array


@dataclass(frozen=True, kw_only=True)
class Interface:
    """An interface of one window, as the condition that closes it.

    ``axis`` is the direction across the interface, ``end`` the end (0 or 1) of the window where it lies, ``line`` the
    grid line of the window on which the functionals are evaluated. ``nodes`` are those on the line that belong to this
    interface, ``free`` those of them whose tangential coordinate no physical side fixes. ``p`` is signed.
    """

    condition: PairOfFunctionals
    axis: int
    end: int
    line: int
    nodes: slice
    free: slice
    p: float
    data: InterfaceData

    def rows(self, window: NodalState) -> Rows:
        """Functional minus received value, attached to the window's outermost line."""
        turned = window if self.axis == 0 else window.turned()
        edge = -1 if self.end else 0
        normal = self.condition.normal(turned, self.line, self.p)
        tangential = self.condition.tangential(turned, self.line, self.p)
        received = np.zeros((2, turned.x.shape[1]))
        received[0, self.nodes], received[1, self.nodes] = self.data.normal, self.data.tangential
        rows, values = [], []
        triplets: Triplets = []
        for component, functional, kept in ((0, normal, self.nodes), (1, tangential, self.free)):
            row = turned.numbers[component][edge][kept]
            rows.append(row)
            values.append((functional.values - received[component])[kept])
            triplets += [(row, unknown[kept], by[kept]) for unknown, by in functional.derivatives]
        return Rows(np.concatenate(rows), np.concatenate(values), lambda: triplets)


@dataclass(frozen=True, kw_only=True)
class InterfaceCorner:
    """The node where two interfaces of a window meet: both coordinates as the diagonal neighbour has them."""

    node: tuple[int, int]
    x: float
    y: float

    def rows(self, window: NodalState) -> Rows:
        """Coordinates minus received ones."""
        unknown = np.array([numbers[self.node] for numbers in window.numbers])
        values = np.array([window.x[self.node] - self.x, window.y[self.node] - self.y])
        return Rows(unknown, values, lambda: [(unknown, unknown, np.ones(2))])


# The mesh equations of one subdomain: its window of the grid, its interfaces, and the data that it exchanges.


@dataclass(frozen=True, kw_only=True)
class Link:
    """One interface of the subdomain that receives data over it.

    ``axis`` is the direction across it, ``end`` the end of the subdomain where it lies, ``line`` its grid line in the
    whole grid, ``sender`` the number of the neighbour beyond, ``p`` the signed parameter of the ``condition``.
    """

    condition: PairOfFunctionals
    axis: int
    end: int
    line: int
    sender: int
    p: float


@dataclass(frozen=True, kw_only=True)
class CornerLink:
    """The node where two interfaces of a subdomain meet: its place in the whole grid, and the diagonal neighbour."""

    node: tuple[int, int]
    sender: int


class Neighbours(Protocol):
    """The other subdomains, as the receiver reads them."""

    def functional(self, link: Link) -> InterfaceData:
        """The two functionals of the link's condition on its grid line, evaluated by the sender."""
        ...

    def node(self, link: CornerLink) -> tuple[float, float]:
        """The position that the sender gives a node."""
        ...


class SubdomainProblem:
    """The equations of one subdomain that exchanges functionals with its neighbours.

    Its window reaches ``ghosts`` grid lines beyond every interface. The state is a :class:`~equimesh.meshes.mesh.Mesh`
    of the window's shape and belongs to the caller.
    """

    def __init__(
        self, problem: Problem, decomposition: Decomposition, part: Subdomain, condition: PairOfFunctionals
    ) -> None:
        self.problem, self.part, self.condition = problem, part, condition
        self.window = SubdomainWindow(decomposition, part, condition.ghosts)
        self.links = tuple(self._link(decomposition, *side) for side, is_open in self.window.open.items() if is_open)
        self.corner_links = tuple(
            self._corner_link(decomposition, ends)
            for ends in ((0, 0), (0, 1), (1, 0), (1, 1))
            if self.window.open[0, ends[0]] and self.window.open[1, ends[1]]
        )

    def equations(self, neighbours: Neighbours, *, classical: bool = False) -> MeshEquations:
        """The subdomain's equations with data from its neighbours.

        ``classical`` takes the neighbours' positions on the outermost lines of the window instead of the condition: a
        problem that more often has a solution near by.
        """
        conditions = self._conditions(neighbours, classical)
        return MeshEquations(self.problem.metric, self.window.shape, self._spacing, conditions)

    def held(self, neighbours: Neighbours, state: Mesh) -> Mesh:
        """The state with the neighbours' positions on the outermost lines beyond interfaces: classical data."""
        x, y = state.x.copy(), state.y.copy()
        for link in map(self.classical, self.links):
            data, edge, nodes = neighbours.functional(link), -1 if link.end else 0, self._nodes(link.axis)
            place = (edge, nodes) if link.axis == 0 else (nodes, edge)
            across, along = (x, y) if link.axis == 0 else (y, x)
            across[place], along[place] = data.normal, data.tangential
        for corner in self.corner_links:
            local = (corner.node[0] - self.window.first[0], corner.node[1] - self.window.first[1])
            x[local], y[local] = neighbours.node(corner)
        return Mesh(x, y)

    def functional(self, state: Mesh, link: Link) -> InterfaceData:
        """The data that this subdomain sends over a neighbour's ``link``: the functionals of its own window."""
        if isinstance(link.condition, Classical):
            return self._positions(state, link)
        equations = MeshEquations(self.problem.metric, self.window.shape, self._spacing, ())
        window = equations.window(equations.vector(state))
        turned = window if link.axis == 0 else window.turned()
        line, nodes = link.line - self.window.first[link.axis], self._nodes(link.axis)
        return InterfaceData(
            normal=link.condition.normal(turned, line, link.p).values[nodes],
            tangential=link.condition.tangential(turned, line, link.p).values[nodes],
        )

    def node(self, state: Mesh, link: CornerLink) -> tuple[float, float]:
        """Position of a node of the whole grid in this subdomain's window."""
        local = (link.node[0] - self.window.first[0], link.node[1] - self.window.first[1])
        return float(state.x[local]), float(state.y[local])

    def _positions(self, state: Mesh, link: Link) -> InterfaceData:
        line = link.line - self.window.first[link.axis]
        across, along = (state.x, state.y) if link.axis == 0 else (state.y.T, state.x.T)
        nodes = self._nodes(link.axis)
        return InterfaceData(normal=across[line][nodes].copy(), tangential=along[line][nodes].copy())

    @property
    def _spacing(self) -> tuple[float, float]:
        return self.problem.grid.d_xi, self.problem.grid.d_eta

    def _link(self, decomposition: Decomposition, axis: int, end: int) -> Link:
        span, (column, row) = self.part.spans[axis], self.part.place
        step = 1 if end else -1
        sender = decomposition.at(column + step * (axis == 0), row + step * (axis == 1)).number
        line = span.last if end else span.first
        spacing = self._spacing[axis]
        beyond = 1.0 - line * spacing if end else line * spacing
        return Link(
            condition=self.condition,
            axis=axis,
            end=end,
            line=line,
            sender=sender,
            p=step * self.condition.strength(beyond),
        )

    def _corner_link(self, decomposition: Decomposition, ends: tuple[int, int]) -> CornerLink:
        column, row = (place + (1 if end else -1) for place, end in zip(self.part.place, ends, strict=True))
        xi, eta = (self.window.slices[axis].stop - 1 if ends[axis] else self.window.slices[axis].start for axis in AXES)
        return CornerLink(node=(xi, eta), sender=decomposition.at(column, row).number)

    def nodes(self, axis: int) -> int:
        """The number of nodes along an interface across ``axis`` that no other interface of the window holds."""
        nodes = self._nodes(axis)
        return int(nodes.stop - nodes.start)

    def _nodes(self, axis: int) -> slice:
        """Nodes along an interface across ``axis`` that no other interface of the window holds."""
        lower, upper = (int(self.window.open[1 - axis, end]) for end in ENDS)
        return slice(lower, self.window.shape[1 - axis] - upper)

    def _conditions(self, neighbours: Neighbours, classical: bool) -> list[Condition]:
        physical = [side for place, side in sides(self.problem.boundary).items() if not self.window.open[place]]
        corners = []
        for corner in self.corner_links:
            x, y = neighbours.node(corner)
            local = (corner.node[0] - self.window.first[0], corner.node[1] - self.window.first[1])
            corners.append(InterfaceCorner(node=local, x=x, y=y))
        links = [self.classical(link) for link in self.links] if classical else self.links
        return [*physical, *(self._interface(link, neighbours.functional(link)) for link in links), *corners]

    def classical(self, link: Link) -> Link:
        """The outermost line of the window beyond an interface, with the classical condition."""
        window = self.window.slices[link.axis]
        return replace(link, condition=Classical(), line=window.stop - 1 if link.end else window.start, p=0.0)

    def _interface(self, link: Link, data: InterfaceData) -> Interface:
        # Where the interface ends on a physical side or at another interface, the tangential unknown is fixed already.
        return Interface(
            condition=link.condition,
            axis=link.axis,
            end=link.end,
            line=link.line - self.window.first[link.axis],
            nodes=self._nodes(link.axis),
            free=slice(1, self.window.shape[1 - link.axis] - 1),
            p=link.p,
            data=data,
        )


# What the subdomains send each other over their interfaces, with the paper's conditions.


class Exchange:
    """The data that subdomains receive: the states of their neighbours, as they read them.

    Where all subdomains are here, data is computed when it is read. Else :meth:`read` has all of it delivered, with
    classical data that may take the place of the condition where it ``has_substitute``.
    """

    def __init__(self, merged: MergedMeshes, parts: Sequence[SubdomainProblem], *, has_substitute: bool) -> None:
        self._merged, self._parts, self._has_substitute = merged, parts, has_substitute
        self._states: Mapping[int, Mesh] = {}
        self._received: dict[Link | CornerLink, Sequence[Array]] = {}

    def read(self, states: Mapping[int, Mesh], turn: Sequence[int] | None) -> None:
        """Set the ``states`` of subdomains, and have the data for a ``turn`` of them delivered."""
        self._states, self._received = states, {}
        if self._merged.is_whole:
            return
        for k in range(len(self._parts)) if turn is None else turn:
            part = self._parts[k]
            substitutes = [part.classical(link) for link in part.links] if self._has_substitute else []
            links: list[Link | CornerLink] = [*part.links, *substitutes, *part.corner_links]
            for link in links:
                data = self._merged.deliver(link.sender, k, partial(self._sent, link), "interfaces")
                if data is not None:
                    self._received[link] = data

    def functional(self, link: Link) -> InterfaceData:
        """The two functionals of the link's condition on its grid line, evaluated by the sender."""
        normal, tangential = self._received[link] if link in self._received else self._sent(link)
        return InterfaceData(normal=normal, tangential=tangential)

    def node(self, link: CornerLink) -> tuple[float, float]:
        """The position that the sender gives a node."""
        position = (self._received[link] if link in self._received else self._sent(link))[0]
        return float(position[0]), float(position[1])

    def _sent(self, link: Link | CornerLink) -> Sequence[Array]:
        part, state = self._parts[link.sender], self._states[link.sender]
        if isinstance(link, CornerLink):
            return [np.array(part.node(state, link))]
        data = part.functional(state, link)
        return [data.normal, data.tangential]


# Sweeps of a subdomain with classical data end when their moves are this share of the first. A larger share would
# change the rate of the paper's iteration.
SWEEP_ACCURACY = 1e-4
MAX_SWEEPS = 40


class FunctionalSlopes:
    """The derivative of the functionals that subdomains receive by the nodes of a merged mesh.

    Sender and receiver evaluate a functional on equal stencils, so that the receiver's part of the mesh is enough.
    """

    def __init__(self, parts: Sequence[SubdomainProblem], equations: Sequence[MeshEquations], mesh: Mesh) -> None:
        self._windows = [part.window for part in parts]
        self._rows, self._matrices = [], []
        for window, local in zip(self._windows, equations, strict=True):
            z = local.vector(window.restrict(mesh))
            state, conditions = local.window(z), local.conditions
            rows = [c.rows(state).rows for c in conditions if isinstance(c, Interface | InterfaceCorner)]
            self._rows.append(np.concatenate([np.zeros(0, dtype=np.int64), *rows]))
            self._matrices.append(local.jacobian(z).tocsr()[self._rows[-1]])

    def received(self, change: tuple[Array, Array]) -> list[Array]:
        """For every subdomain the change of its equations' right side, when the nodes of the mesh move by ``change``.

        ``change`` is of two arrays of the grid's shape, a right side as the vector of the subdomain's equations.
        """
        found = []
        for window, rows, matrix in zip(self._windows, self._rows, self._matrices, strict=True):
            moved = np.concatenate([q[window.slices].ravel() for q in change])
            right = np.zeros(moved.size)
            right[rows] = matrix @ moved
            found.append(right)
        return found


class FunctionalSubdomains:
    """All subdomains of a decomposition, with a transmission condition of the paper."""

    def __init__(
        self, problem: Problem, merged: MergedMeshes, condition: PairOfFunctionals, solver: LocalSolver
    ) -> None:
        decomposition, self._merged = merged.decomposition, merged
        self.parts = [SubdomainProblem(problem, decomposition, part, condition) for part in decomposition.parts]
        self.windows: list[SubdomainWindow] = [part.window for part in self.parts]
        self._sweeps: dict[int, SubdomainSweeps] = {}
        self._problem, self._by_sweeps = problem, solver is LocalSolver.SWEEPS
        self._has_substitute = condition.ghosts > 0
        self._states: dict[int, Mesh] = {}
        self._exchange = Exchange(merged, self.parts, has_substitute=self._has_substitute)
        self._read: tuple[dict[int, Mesh], Mesh] = {}, Mesh(np.zeros((0, 0)), np.zeros((0, 0)))

    def restart(self, mesh: Mesh) -> None:
        """Set the states of the subdomains to their parts of ``mesh``."""
        self._states = {k: self._merged.restrict(self.windows[k], mesh) for k in self._merged.numbers}

    def begin(self, mesh: Mesh, turn: Sequence[int] | None = None) -> None:
        """Read the last solutions in the next solves; ``mesh`` is the merged mesh."""
        self._read = dict(self._states), mesh
        self._exchange.read(self._read[0], turn)

    def solve(self, k: int) -> Outcome:
        """The solution of a subdomain.

        Newton's method starts from its previous solution, then from the merged mesh. Where it stalls from both, the
        interface data is far from any solution of the subdomain: positions from the neighbours are taken instead.
        """
        part, (states, mesh) = self.parts[k], self._read
        exchange = self._exchange
        starts = [start for start in (states[k], self._merged.restrict(part.window, mesh)) if not start.is_folded]
        for rescue in (False, True)[: 1 + self._has_substitute]:
            if self._by_sweeps and (rescue or not self._has_substitute):
                swept = self._swept(k, part.held(exchange, states[k]))
                if swept.converged:
                    return Outcome(swept, rescue)
            equations = part.equations(exchange, classical=rescue)
            for start in starts:
                *_, solution = newton_steps(equations, start, most_steps=MAX_LOCAL_STEPS, fast=True)
                if solution.converged:
                    return Outcome(solution, rescue)
        return Outcome(NewtonSolution(states[k], 0, math.inf, converged=False))

    def keep(self, k: int, state: Mesh) -> None:
        """Keep the solution of a subdomain for its neighbours."""
        self._states[k] = state

    def place(self, k: int) -> Place:
        """The nodes that a subdomain owns."""
        return self.windows[k].part.owned

    def state(self, k: int, mesh: Mesh) -> Mesh:  # noqa: ARG002
        """The last solution of a subdomain."""
        return self._states[k]

    def equations(self, k: int) -> MeshEquations:
        """The equations of a subdomain, with the data that it has from its neighbours."""
        return self.parts[k].equations(self._exchange)

    def slopes(self, states: Sequence[Mesh]) -> FunctionalSlopes:
        """The derivative of the received data by the merged mesh, where the states are parts of it."""
        del states  # the data enters the equations directly, for any solution
        return FunctionalSlopes(self.parts, [self.equations(k) for k in range(len(self.parts))], self._read[1])

    def sent(self, turn: Sequence[int]) -> int:
        """Two functionals for every node of an interface, and two positions where they may take their place."""
        numbers = 0
        for part in (self.parts[k] for k in turn):
            lines = sum(part.nodes(link.axis) for link in part.links)
            numbers += 2 * (lines * (1 + self._has_substitute) + len(part.corner_links))
        return numbers

    def _swept(self, k: int, start: Mesh) -> NewtonSolution:
        """The solution with the interfaces held at their positions in ``start``; not converged where it folds."""
        if start.is_folded:
            return NewtonSolution(start, 0, math.inf, converged=False)
        if k not in self._sweeps:
            window = self.windows[k]
            frame = Frame(physical=window.physical)
            self._sweeps[k] = SubdomainSweeps(self._problem, window.shape, frame)
        return self._sweeps[k].solve(start, None, accuracy=SWEEP_ACCURACY, most=MAX_SWEEPS)
