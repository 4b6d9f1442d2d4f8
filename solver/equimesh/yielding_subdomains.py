"""Subdomains whose interfaces yield: each reads the merged mesh, and the sums of metric lengths along its lines."""

from __future__ import annotations

import math
from collections.abc import Sequence

from equimesh import yielding
from equimesh.decomposition import Decomposition
from equimesh.functional_subdomains import Outcome
from equimesh.line_sums import LineSums
from equimesh.local_solution import LocalSolution
from equimesh.mesh import Mesh
from equimesh.problem import Problem
from equimesh.subdomain_sweeps import SubdomainSweeps
from equimesh.subdomain_window import AXES, SubdomainWindow
from equimesh.transmission import LineData, Optimized

# A local solve ends when its moves are this share of the first, or after so many sweeps: the interface data is no
# better. With ten times the accuracy the numbers of iterations are the same.
ACCURACY, MOST_SWEEPS = 0.1, 4


class YieldingSubdomains:
    """All subdomains of a decomposition, with the optimized condition."""

    def __init__(self, problem: Problem, decomposition: Decomposition, condition: Optimized, threads: int) -> None:
        self.windows = [SubdomainWindow(decomposition, part, condition.ghosts) for part in decomposition.parts]
        self._metric, self._local = problem.metric, condition.data is LineData.LOCAL
        interfaces = tuple(
            {end for span in decomposition.spans[axis] for end in (span.first, span.last)} for axis in AXES
        )
        self._sums = LineSums(problem, (interfaces[0], interfaces[1]), threads)
        shape = problem.grid.shape
        self._sweeps = [SubdomainSweeps(problem, w.shape, yielding.frame(w, shape)) for w in self.windows]
        self._mesh = Mesh.uniform(problem.grid)

    def begin(self, states: Sequence[Mesh], mesh: Mesh) -> None:
        """Read the merged mesh ``mesh`` in the solves to come."""
        del states  # what they merge to is all that is read
        self._mesh = mesh
        self._sums.read(mesh)

    def solve(self, k: int) -> Outcome:
        """The solution of a subdomain, from its part of the merged mesh."""
        window = self.windows[k]
        start = window.restrict(self._mesh)
        sides = yielding.sides(self._metric, window, start, self._sums, local=self._local)
        solution = self._sweeps[k].solve(start, sides.rest, accuracy=ACCURACY, most=MOST_SWEEPS)
        if not solution.converged:
            solution = LocalSolution(start, solution.steps, math.inf, converged=False, swept=True)
        return Outcome(solution)

    def sent(self, k: int) -> int:
        """Numbers that a subdomain receives in one iteration: the line beyond each interface, and a sum for each of
        the lines that cross it."""
        window = self.windows[k]
        return sum(3 * window.shape[1 - axis] for (axis, _), is_open in window.open.items() if is_open)
