"""Subdomains that exchange the paper's functionals: each has its own state, and reads those of its neighbours."""

import math
from collections.abc import Sequence

import numpy as np

from equimesh.equations.mesh_equations import MeshEquations
from equimesh.equations.newton_solve import NewtonSolution, newton_steps
from equimesh.equations.problem import Problem
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.types import Array
from equimesh.schwarz.conditions import PairOfFunctionals
from equimesh.schwarz.functionals.exchange import Exchange
from equimesh.schwarz.functionals.interface import Interface, InterfaceCorner
from equimesh.schwarz.functionals.subdomain import SubdomainProblem
from equimesh.schwarz.holding.port import Holding, Place
from equimesh.schwarz.local_sweeps import SubdomainSweeps
from equimesh.schwarz.port import MAX_LOCAL_STEPS, Outcome
from equimesh.schwarz.settings import LocalSolver
from equimesh.schwarz.window import SubdomainWindow
from equimesh.sweeps.sides import Frame

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

    def __init__(self, problem: Problem, holding: Holding, condition: PairOfFunctionals, solver: LocalSolver) -> None:
        decomposition, self._holding = holding.decomposition, holding
        self.parts = [SubdomainProblem(problem, decomposition, part, condition) for part in decomposition.parts]
        self.windows: list[SubdomainWindow] = [part.window for part in self.parts]
        self._sweeps: dict[int, SubdomainSweeps] = {}
        self._problem, self._by_sweeps = problem, solver is LocalSolver.SWEEPS
        self._has_substitute = condition.ghosts > 0
        self._states: dict[int, Mesh] = {}
        self._exchange = Exchange(holding, self.parts, has_substitute=self._has_substitute)
        self._read: tuple[dict[int, Mesh], Mesh] = {}, Mesh(np.zeros((0, 0)), np.zeros((0, 0)))

    def restart(self, mesh: Mesh) -> None:
        """Set the states of the subdomains to their parts of ``mesh``."""
        self._states = {k: self._holding.restrict(self.windows[k], mesh) for k in self._holding.numbers}

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
        starts = [start for start in (states[k], self._holding.restrict(part.window, mesh)) if not start.is_folded]
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
