"""The cost of the Schwarz iteration compared with a single domain, and the data exchanged by subdomains."""

from collections.abc import Iterator
from dataclasses import replace

import equimesh as em
from costs.rows import Row, cpu_seconds
from costs.solves import CHEAP, LARGE, front

DECOMPOSITIONS = {"16 strips": (16, 1), "4 x 4 blocks": (4, 4)}
COLD_GOAL = 3.0
"""CPU time over that of the single domain, from an own start."""
WARM_GOAL = 1.3
"""CPU time over that of the single domain, from the mesh of the time step before."""
STEP = 1e-4
"""Move of the front from one time step to the next, in units of the domain."""


def compare(n: int) -> Iterator[Row]:
    """CPU time of 16 subdomains over that of the single domain, cold and warm, and the traffic of an iteration."""
    problem, moved = front(n), front(n, em.Expression(CHEAP.replace("x +", "x - t +"), t=STEP))
    singles = {
        em.Mode.DISCRETIZATION: cpu_seconds(lambda: em.solve(problem, threads=1))[0],
        em.Mode.TIGHT: cpu_seconds(lambda: em.solve(problem, mode=em.Mode.TIGHT, threads=1))[0],
    }
    before = em.solve(problem, mode=em.Mode.TIGHT, threads=1).reference
    warm, _ = cpu_seconds(lambda: em.solve(moved, initial=before, threads=1))
    for name, subdomains in DECOMPOSITIONS.items():
        tight = em.Schwarz(subdomains=subdomains)
        loose = replace(tight, tolerance="discretization")
        for mode, settings in ((em.Mode.DISCRETIZATION, loose), (em.Mode.TIGHT, tight)):
            seconds, solution = cpu_seconds(lambda settings=settings: em.solve(problem, settings, threads=1))  # type: ignore[misc]
            yield _ratio(f"n = {n}, {name}, {mode}", seconds / singles[mode], solution, COLD_GOAL, n)
        seconds, solution = cpu_seconds(lambda tight=tight: em.solve(moved, tight, initial=before, threads=1))  # type: ignore[misc]
        yield _ratio(f"n = {n}, {name}, warm start", seconds / warm, solution, WARM_GOAL, n)
        yield _traffic(f"n = {n}, {name}, traffic of an iteration", solution)


def _ratio(what: str, ratio: float, solution: em.Solution, goal: float, n: int) -> Row:
    return Row(
        what=f"{what} over single domain",
        value=ratio,
        unit="",
        goal=goal if n == LARGE else None,
        counts={"iterations": len(solution.iterations) - 1},
    )


def _traffic(what: str, solution: em.Solution) -> Row:
    last = solution.iterations[-1]
    share = last.traffic / (16 * solution.problem.grid.points)
    return Row(what=what, value=last.traffic / 1e3, unit="kB", note=f"{100 * share:.2g} % of the mesh")
