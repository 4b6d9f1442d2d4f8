"""The chord iteration against guarded Newton with a sparse factorisation, in one run.

Both go up the same nested grids to the same mesh. CPU time of the finest level alone, median of several runs, each from
the same start: the solution on the grid half as fine.

    python benchmarks/chord_against_newton.py --points 65 129 257
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from statistics import median
from typing import TypeVar

import equimesh as em
from equimesh import chord, single_domain

T = TypeVar("T")
U = "tanh(20*(x + y/2 - 0.75))"


def cpu_seconds(work: Callable[[], T], runs: int) -> tuple[float, T]:
    """Median CPU time of ``work`` on this process, and its last result."""
    times = []
    for _ in range(runs):
        start = time.process_time()
        result = work()
        times.append(time.process_time() - start)
    return median(times), result


def compare(problem: em.Problem, runs: int) -> str:
    coarse = em.solve(replace(problem, grid=single_domain.halved(problem.grid))).mesh
    start = single_domain.prolong(coarse, problem.grid)
    fast_time, sweeps = cpu_seconds(lambda: list(chord.iterate(problem, start)), runs)
    slow_time, steps = cpu_seconds(lambda: list(single_domain.newton_steps(problem.equations(), start)), 1)
    difference = max(abs(sweeps[-1].mesh.x - steps[-1].mesh.x).max(), abs(sweeps[-1].mesh.y - steps[-1].mesh.y).max())
    each = 1e9 / problem.grid.points
    return (
        f"{problem.grid.n_xi:>6}  {sweeps[-1].sweep:>6}  {each * fast_time:>10.0f}  {steps[-1].steps:>5}  "
        f"{each * slow_time:>11.0f}  {slow_time / fast_time:>6.0f}  {difference:.1e}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, nargs="+", default=[65, 129, 257], help="points a side")
    parser.add_argument("--runs", type=int, default=5, help="runs of the chord iteration")
    arguments = parser.parse_args()
    print(f"u = {U}, a = 0.7, b = 0.05, trace; ns are CPU time a point of the finest level\n")
    print("points  sweeps  chord [ns]    steps  Newton [ns]   ratio  difference")
    monitor = em.ArcLength(u=em.Expression(U))
    for n in arguments.points:
        print(compare(em.Problem(monitor=monitor, grid=em.Grid(n_xi=n, n_eta=n)), arguments.runs))


if __name__ == "__main__":
    main()
