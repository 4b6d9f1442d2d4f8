"""Processor time of what every answer carries of a mesh, next to that of its solve.

    python benchmarks/quality.py

Each row: the points a side, where u comes from, milliseconds of the solve, and of the quality with u at the nodes and
the certificate; their quotient; nanoseconds a cell. A time is the shortest of some runs, of one thread. It is processor
time, so that other work on the machine changes it little. ``nodes`` is a step of a sequence: u at the nodes of the mesh
before.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

import equimesh as em

U = "tanh(20*(x + y/2 - {}))+0.3*sin(5*x*y)"
BEFORE, NOW = 0.75, 0.76  # the place of the front in the step before, and in this one
SAMPLES = 65
SIZES = {33: 30, 65: 30, 257: 7, 1025: 3}
"""Points a side, and the runs of which the shortest counts."""
MAX_STEP_POINTS = 257


def fields(n: int) -> dict[str, em.Field]:
    """u as an expression, as samples on a grid, and at the nodes of a mesh that was made for a u before."""
    expression, axis = em.Expression(U.format(NOW)), np.linspace(0.0, 1.0, SAMPLES)
    values = expression.evaluate(*np.meshgrid(axis, axis, indexing="ij"))[0]
    found: dict[str, em.Field] = {
        "expression": expression,
        "samples": em.GridSamples(x=axis, y=axis, values=values),
    }
    if n <= MAX_STEP_POINTS:
        mesh = em.solve(problem(n, em.Expression(U.format(BEFORE))), threads=1).mesh
        found["nodes"] = em.NodalField(mesh=mesh, values=expression.evaluate(mesh.x, mesh.y)[0])
    return found


def problem(n: int, u: em.Field) -> em.Problem:
    """The arc-length mesh of u with n points a side."""
    return em.Problem(monitor=em.ArcLength(u=u), grid=em.Grid(n_xi=n, n_eta=n))


def times(case: em.Problem, runs: int) -> tuple[float, float]:
    """Seconds of the solve and of the rest, the shortest of ``runs`` after one that compiles."""
    solving, measuring = [], []
    for _ in range(runs + 1):
        begin = time.process_time()
        solution = em.solve(case, threads=1)
        solved = time.process_time()
        _ = solution.data(), solution.quality.summary(), solution.certificate.summary()
        solving.append(solved - begin)
        measuring.append(time.process_time() - solved)
    return min(solving[1:]), min(measuring[1:])


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", type=int, nargs="+", default=[*SIZES], help="points a side")
    arguments = parser.parse_args()
    print("points  u           solve, ms  quality, ms  quotient  ns a cell")
    for n in arguments.sizes:
        for name, u in fields(n).items():
            solve, measure = times(problem(n, u), SIZES.get(n, 3))
            per_cell = 1e9 * measure / (n - 1) ** 2
            print(
                f"{n:6d}  {name:10s} {1e3 * solve:10.2f} {1e3 * measure:12.2f} {measure / solve:9.2f} {per_cell:10.0f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
