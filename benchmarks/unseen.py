"""How many random functions have a mesh of the requested equations, and what a solve costs.

The functions are those of a seed to which nothing was tuned. CPU seconds of one thread, after a first solve that
compiles. "Exact" is the status ``converged``.

    python benchmarks/unseen.py --seed 201 --count 100 --points 33 65
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from random_functions import RandomFunction, random_functions

import equimesh as em

KINDS = {"arc-length": em.ArcLength, "curvature": em.Curvature}


def solve(function: RandomFunction, kind: str, shape: tuple[int, int], smoothing: float) -> tuple[bool, float]:
    """Whether the mesh of a function is exact, and the CPU seconds of its solve."""
    monitor: em.Monitor = KINDS[kind](u=em.Expression(function.u))
    if smoothing > 0.0:
        monitor = em.Smoothed(monitor=monitor, radius=smoothing)
    begun = time.process_time()
    problem = em.Problem(monitor=monitor, grid=em.Grid(n_xi=shape[0], n_eta=shape[1]))
    solution = em.solve(problem, threads=1, check=False)
    return solution.status is em.Status.CONVERGED, time.process_time() - begun


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=201)
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--points", nargs="+", default=["33", "65"], help="points a side, or 129x65")
    parser.add_argument("--monitor", choices=KINDS, default="arc-length")
    parser.add_argument("--smoothing", type=float, default=0.0, help="radius, 0 for none")
    arguments = parser.parse_args()
    functions = random_functions(arguments.seed, arguments.count)
    print("| points | exact | CPU of exact ones: median, worst | of relaxed ones: median, worst |")
    print("|---|---|---|---|")
    for points in arguments.points:
        n_xi, _, n_eta = points.partition("x")
        shape = (int(n_xi), int(n_eta or n_xi))
        for first in functions[:20]:  # compiles what either way needs
            solve(first, arguments.monitor, (17, 17), arguments.smoothing)
        results = [solve(function, arguments.monitor, shape, arguments.smoothing) for function in functions]
        exact = 100 * sum(found for found, _ in results) / len(results)
        cells = [f"{shape[0]} x {shape[1]}", f"{exact:.0f} %"]
        for status in (True, False):
            seconds = [cpu for found, cpu in results if found is status] or [np.nan]
            cells.append(f"{np.median(seconds):.3f} s, {max(seconds):.2f} s")
        print("| " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
