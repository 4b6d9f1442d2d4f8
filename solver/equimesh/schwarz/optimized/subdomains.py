"""Subdomains whose interfaces yield: each reads the merged mesh and the sums of metric lengths along its lines."""

import math
from collections.abc import Sequence

from equimesh.equations.mesh_equations import MeshEquations
from equimesh.equations.newton_solve import MAX_FACTORISED_POINTS, NewtonSolution, newton_steps
from equimesh.equations.problem import Problem
from equimesh.meshes.mesh import Mesh
from equimesh.schwarz.conditions import LineData, Optimized
from equimesh.schwarz.decomposition import Decomposition
from equimesh.schwarz.local_sweeps import SubdomainSweeps
from equimesh.schwarz.optimized import equations as yielding_equations
from equimesh.schwarz.optimized import sides as yielding
from equimesh.schwarz.optimized.line_sums import LineSums
from equimesh.schwarz.optimized.slopes import YieldingSlopes
from equimesh.schwarz.port import MAX_LOCAL_STEPS, Outcome
from equimesh.schwarz.settings import LocalSolver
from equimesh.schwarz.window import AXES, SubdomainWindow

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
        decomposition: Decomposition,
        condition: Optimized,
        solver: LocalSolver,
        *,
        in_turns: bool,
        enough: float,
        threads: int,
    ) -> None:
        self.windows = [SubdomainWindow(decomposition, part, condition.ghosts) for part in decomposition.parts]
        self._problem, self._local = problem, condition.data is LineData.LOCAL
        self._by_sweeps, self._enough = solver is LocalSolver.SWEEPS, enough
        interfaces = tuple(
            {end for span in decomposition.spans[axis] for end in (span.first, span.last)} for axis in AXES
        )
        self._sums = LineSums(problem, (interfaces[0], interfaces[1]), threads)
        shape = problem.grid.shape
        self._sweeps = [SubdomainSweeps(problem, w.shape, yielding.frame(w, shape)) for w in self.windows]
        self._mesh, self._in_turns = Mesh.uniform(problem.grid), in_turns

    def restart(self, mesh: Mesh) -> None:
        """Nothing to do: every solve reads the merged mesh."""

    def begin(self, mesh: Mesh) -> None:
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

    def merge(self, k: int, state: Mesh, mesh: Mesh) -> None:
        """Write the nodes of a subdomain into ``mesh``."""
        window = self.windows[k]
        window.write(state, mesh, window.covered if self._in_turns else window.part.owned)

    def state(self, k: int, mesh: Mesh) -> Mesh:
        """The part of the merged mesh."""
        return self.windows[k].restrict(mesh)

    def equations(self, k: int) -> MeshEquations:
        """The equations of a subdomain, with its data from the merged mesh."""
        start, sides = self.received(k)
        return yielding_equations.equations(self._problem, self.windows[k], start, sides)

    def slopes(self, states: Sequence[Mesh]) -> YieldingSlopes:
        """The derivative of the received data by the mesh that is read, at the solutions ``states``."""
        return YieldingSlopes(self._problem, self.windows, self._sums, self._mesh, states, local=self._local)

    def received(self, k: int) -> tuple[Mesh, yielding.Sides]:
        """The data of a subdomain: its part of the merged mesh, and its yielding sides."""
        start = self.windows[k].restrict(self._mesh)
        return start, yielding.sides(self._problem.metric, self.windows[k], start, self._sums, local=self._local)

    def sent(self, k: int) -> int:
        """Numbers that a subdomain receives in one iteration: three for each line that crosses an interface.

        Two are the node beyond the interface, one is the sum.
        """
        window = self.windows[k]
        return sum(3 * window.shape[1 - axis] for (axis, _), is_open in window.open.items() if is_open)
