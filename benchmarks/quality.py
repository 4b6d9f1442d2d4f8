"""Processor time of what every answer carries of a mesh, next to that of its solve.

    python benchmarks/quality.py

Each row: the points a side, where u comes from, milliseconds of the solve, of the quality with u at the nodes, of the
faces, and of the rest of the certificate; then the quality with the faces, and all of it, over the solve. ``again`` is
the quality with the faces of the next mesh of the same u and size, over the solve: what is known of u on the uniform
mesh is kept. A time is the shortest of some runs, of one thread, without the collection of garbage. It is processor
time, so that other work on the machine changes it little. ``nodes`` is a step of a sequence: u at the nodes of the mesh
before.
"""

from __future__ import annotations

import argparse
import gc
import time
from itertools import pairwise

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


def renewed(u: em.Field, run: int) -> em.Field:
    """The same function, of which nothing is known yet but how it is evaluated."""
    if isinstance(u, em.Expression):
        u = em.Expression(u.text, t=float(run))
    elif isinstance(u, em.GridSamples):
        u = em.GridSamples(x=u.x, y=u.y, values=u.values)
    for order in range(2):
        u.evaluate(np.full(1, 0.5), np.full(1, 0.5), order)
    return u


def times(n: int, u: em.Field, runs: int) -> list[float]:
    """Milliseconds of the solve, quality, faces and the rest, then quality and faces of the next mesh of the u.

    They are the shortest of ``runs`` after one that compiles.
    """
    found = []
    gc.collect()
    for run in range(runs + 1):
        case = problem(n, renewed(u, run))
        marks = [time.process_time()]
        solution = em.solve(case, threads=1)
        marks.append(time.process_time())
        _ = solution.quality.summary(), solution.u
        marks.append(time.process_time())
        _ = solution.faces
        marks.append(time.process_time())
        _ = solution.data(), solution.certificate.summary()
        marks.append(time.process_time())
        solution = em.solve(case, threads=1)
        begin = time.process_time()
        _ = solution.quality.summary(), solution.u, solution.faces
        again = time.process_time() - begin
        found.append([*(1e3 * (end - begin) for begin, end in pairwise(marks)), 1e3 * again])
    return [min(part) for part in zip(*found[1:], strict=True)]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", type=int, nargs="+", default=[*SIZES], help="points a side")
    parser.add_argument("--fields", nargs="+", default=["expression", "samples", "nodes"], help="where u comes from")
    arguments = parser.parse_args()
    gc.disable()
    print("points  u            solve, ms  quality   faces    rest  quality and faces / solve  all / solve  again")
    for n in arguments.sizes:
        for name, u in fields(n).items():
            if name in arguments.fields:
                solve, *rest, again = times(n, u, SIZES.get(n, 3))
                quality, faces, certificate = rest
                print(
                    f"{n:6d}  {name:10s} {solve:11.2f} {quality:8.2f} {faces:7.2f} {certificate:7.2f}"
                    f" {(quality + faces) / solve:26.2f} {sum(rest) / solve:12.2f} {again / solve:6.2f}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
