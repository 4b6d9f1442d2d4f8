"""Subdomains whose interfaces yield: each reads the merged mesh and the sums of metric lengths along its lines."""

import math
from collections.abc import Sequence

from equimesh.equations.mesh_equations import MeshEquations
from equimesh.equations.newton_solve import MAX_FACTORISED_POINTS, NewtonSolution, newton_steps
from equimesh.equations.problem import Problem
from equimesh.meshes.mesh import Mesh
from equimesh.schwarz.conditions import LineData, Optimized
from equimesh.schwarz.holding.port import Holding, Place
from equimesh.schwarz.lines.line_sums import line_sums
from equimesh.schwarz.local_sweeps import SubdomainSweeps
from equimesh.schwarz.optimized import equations as yielding_equations
from equimesh.schwarz.optimized import sides as yielding
from equimesh.schwarz.optimized.slopes import YieldingSlopes
from equimesh.schwarz.port import MAX_LOCAL_STEPS, Outcome
from equimesh.schwarz.settings import LocalSolver
from equimesh.schwarz.window import SubdomainWindow

# Sweeps of a subdomain end when their moves are this share of the first: the interface data is no more accurate. A
# tenth of it leads to the same numbers of iterations.
SWEEP_ACCURACY = 0.1
MAX_SWEEPS = 4


class OptimizedSubdomains:
    """All subdomains of a decomposition, with the optimized condition.

    Sweeps of a subdomain end when they move its nodes by no more than ``enough``. With ``in_turns`` each subdomain also
    writes its overlap into the merged mesh, for those of later turns.
    """

    def __init__(
        self,
        problem: Problem,
        holding: Holding,
        condition: Optimized,
        solver: LocalSolver,
        *,
        in_turns: bool,
        enough: float,
        threads: int,
    ) -> None:
        self.windows = [
            SubdomainWindow(holding.decomposition, part, condition.ghosts) for part in holding.decomposition.parts
        ]
        self._problem, self._local = problem, condition.data is LineData.LOCAL
        self._by_sweeps, self._enough = solver is LocalSolver.SWEEPS, enough
        self._holding, self._sums = holding, line_sums(problem, holding, self.windows, threads, local=self._local)
        shape, windows = problem.grid.shape, {k: self.windows[k] for k in holding.numbers}
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
        """The nodes that a subdomain owns; in turns also those of its overlap."""
        window = self.windows[k]
        return window.covered if self._in_turns else window.part.owned

    def state(self, k: int, mesh: Mesh) -> Mesh:
        """The part of the merged mesh."""
        return self._holding.restrict(self.windows[k], mesh)

    def equations(self, k: int) -> MeshEquations:
        """The equations of a subdomain, with its data from the merged mesh."""
        start, sides = self.received(k)
        return yielding_equations.equations(self._problem, self.windows[k], start, sides)

    def slopes(self, states: Sequence[Mesh]) -> YieldingSlopes:
        """The derivative of the received data by the mesh that is read, at the solutions ``states``."""
        return YieldingSlopes(self._problem, self.windows, self._sums, self._mesh, states, local=self._local)

    def received(self, k: int) -> tuple[Mesh, yielding.Sides]:
        """The data of a subdomain: its part of the merged mesh, and its yielding sides."""
        start = self._holding.restrict(self.windows[k], self._mesh)
        return start, yielding.sides(self._problem.metric, self.windows[k], start, self._sums, local=self._local)

    def sent(self, turn: Sequence[int]) -> int:  # noqa: ARG002
        """The sum of each line, over all interfaces that it crosses: all subdomains pass it on, in every turn."""
        lines = [w.shape[1 - axis] for w in self.windows for (axis, _), is_open in w.open.items() if is_open]
        return 0 if self._local else sum(lines)
