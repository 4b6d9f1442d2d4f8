"""The tables of the page of results: each claim has one command, which takes about a minute or less.

python benchmarks/results.py trace        # or: p, sums, cuts, least
python benchmarks/results.py --write      # all of them, into docs/background/results.md
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
from functions import FUNCTIONS
from random_functions import random_functions

import equimesh as em

PAGE = Path(__file__).resolve().parent.parent / "docs" / "background" / "results.md"
Rows = Iterator[Sequence[object]]

STEEP = ("tanh20", "wave")
"""Functions that change across the sides of the square."""
GRIDS = (17, 33, 65, 129)
PARAMETERS = (1.0, 2.0, None, 2.3, 3.0, 5.0)
"""Of the Robin conditions; ``None`` is the automatic one."""
STRIPS = (2, 4, 8)
MAX_ITERATIONS = 30
"""Of the iterations whose rate is observed."""
SMALLEST_ERROR = 1e-9
"""Smaller errors are left out of observed rates."""
CUTS = ((2, 1), (32, 1), (8, 8), (3, 5))
SEED, COUNT = 20_261_122, 50
"""Of the random functions; no constant of the method was tuned to those of this seed."""


def monitor(name: str) -> em.ArcLength:
    """The monitor of the paper, with its parameters, for a function of this name."""
    return em.ArcLength(u=em.Expression(FUNCTIONS[name].u), a=0.7, b=0.05, scaled=False)


def trace(names: Sequence[str] = STEEP, grids: Sequence[int] = GRIDS) -> Rows:
    """Smallest corner Jacobians with each boundary condition, on finer and finer grids."""
    yield "u", "boundary", *(f"{n} x {n}" for n in grids)
    for name in names:
        for boundary in (em.Boundary.EQUIDISTRIBUTED_1D, em.Boundary.TRACE):
            found = []
            for n in grids:
                grid = em.Grid(n_xi=n, n_eta=n)
                problem = em.Problem(monitor=monitor(name), grid=grid, boundary=boundary)
                solution = em.solve(problem, mode=em.Mode.TIGHT, check=False)
                relaxed = solution.status == "relaxed"
                found.append("none" if relaxed else f"{solution.certificate.min_jacobian:.3f}")
            yield f"`{name}`", f"`{boundary.value}`", *found


def robin(parameters: Sequence[float | None] = PARAMETERS) -> Rows:
    """Iterations of the Robin conditions for each parameter, and the rate that is predicted."""
    problem = em.Problem(
        monitor=monitor("paper"), grid=em.Grid(n_xi=12, n_eta=12), boundary=em.Boundary.EQUIDISTRIBUTED_1D
    )
    columns = []
    for p in parameters:
        column, value = [f"{p:g}" if p else "auto = 2.2"], {} if p is None else {"p": p}
        for kind in (em.LinearRobin, em.NonlinearRobin):
            settings = em.Schwarz(
                overlap=2, transmission=kind(**value), ordering=em.Ordering.ALTERNATING, tolerance=1e-8
            )
            solution = em.solve(problem, settings, initial=em.Initial.UNIFORM)
            column.append(str(len(solution.iterations) - 1))
        columns.append([*column, f"{solution.predicted_rate:.4f}"])
    heads = ("p", "`linear_robin`, iterations", "`nonlinear_robin`, iterations", "predicted rate")
    yield from ((head, *cells) for head, cells in zip(heads, zip(*columns, strict=True), strict=True))


def sums(strips: Sequence[int] = STRIPS) -> Rows:
    """Predicted and observed rates, and iterations, for each kind of data that strips exchange."""
    yield "data of the interface", "strips", "predicted rate", "observed rate", "iterations to a millionth"
    plain = {"line_correction": 0, "acceleration": em.Acceleration.NONE, "fallback": False, "tolerance": None}
    kinds: dict[str, em.TransmissionCondition] = {
        "positions (`classical`)": em.Classical(),
        "one edge (`optimized`, `local`)": em.Optimized(data=em.LineData.LOCAL),
        "line sums (`optimized`)": em.Optimized(),
    }
    problem = em.Problem(monitor=monitor("paper"), grid=em.Grid(n_xi=33, n_eta=33))
    for kind, condition in kinds.items():
        for count in strips:
            settings = em.Schwarz(
                subdomains=(count, 1),
                transmission=condition,
                max_iterations=MAX_ITERATIONS,
                compare_single_domain=True,
                **plain,
            )
            solution = em.solve(problem, settings, check=False)
            errors = [record.error for record in solution.iterations]
            below = [i for i, error in enumerate(errors) if error <= 1e-6 * errors[0]]
            needed = str(below[0]) if below else f"more than {MAX_ITERATIONS}"
            yield kind, count, f"{solution.predicted_rate:.3f}", observed_rate(errors), needed


def observed_rate(errors: Sequence[float]) -> str:
    """The factor by which errors fall in an iteration: the mean of the last four above what rounding disturbs."""
    above = [error for error in errors if error > SMALLEST_ERROR]
    last = above[-5:]
    return f"{(last[-1] / last[0]) ** (1 / (len(last) - 1)):.3f}"


def cuts(names: Sequence[str] = ("paper", "tanh60"), cut: Sequence[tuple[int, int]] = CUTS) -> Rows:
    """The largest distance of a node from its place in the mesh of one domain, for each way to cut the grid."""
    yield "u", "subdomains", "iterations", "largest distance", "status"
    for name in names:
        problem = em.Problem(monitor=monitor(name), grid=em.Grid(n_xi=65, n_eta=65))
        one = em.solve(problem, mode=em.Mode.TIGHT, threads=1).mesh
        two = em.solve(problem, mode=em.Mode.TIGHT, threads=2).mesh
        yield f"`{name}`", "1 x 1, two threads", "-", f"{distance(one, two):.0e}", "-"
        for columns, rows in cut:
            solution = em.solve(problem, em.Schwarz(subdomains=(columns, rows), overlap=2))
            yield (
                f"`{name}`",
                f"{columns} x {rows}",
                len(solution.iterations) - 1,
                f"{distance(one, solution.mesh):.0e}",
                solution.status,
            )


def distance(one: em.Mesh, other: em.Mesh) -> float:
    """The largest difference of a coordinate."""
    return max(float(np.abs(one.x - other.x).max()), float(np.abs(one.y - other.y).max()))


def least(count: int = COUNT, n: int = 33) -> Rows:
    """Gains of least-error meshes over uniform ones, for random functions."""
    yield "norm", "functions", "smallest gain", "median", "geometric mean", "folded"
    for norm in ("l2", "h1"):
        gains, folded = [], 0
        for function in random_functions(SEED, count):
            monitored = em.LeastError(u=em.Expression(function.u), norm=norm)
            solution = em.solve(em.Problem(monitor=monitored, grid=em.Grid(n_xi=n, n_eta=n)))
            folded += solution.mesh.is_folded
            gains.append(solution.interpolation.estimated_gain(norm))
        mean = math.exp(float(np.mean(np.log(gains))))
        yield f"`{norm}`", count, f"{min(gains):.2f}", f"{np.median(gains):.2f}", f"{mean:.2f}", folded


PARTS: dict[str, Callable[[], Rows]] = {"trace": trace, "p": robin, "sums": sums, "cuts": cuts, "least": least}


def table(rows: Rows) -> Iterator[str]:
    """The lines of a Markdown table, the first row its head."""
    for number, row in enumerate(rows):
        yield f"| {' | '.join(str(cell) for cell in row)} |"
        if number == 0:
            yield "|" + "---|" * len(row)


def write(part: str, lines: Sequence[str]) -> None:
    """Put a table between its marks in the page."""
    begin, end = marks(part)
    before, _, rest = PAGE.read_text().partition(begin)
    _, mark, after = rest.partition(end)
    if not mark:
        sys.exit(f"{PAGE}: the marks of {part} are not there")
    PAGE.write_text("\n".join([before + begin, "", *lines, "", end]) + after)


def marks(part: str) -> tuple[str, str]:
    """The lines of the page around the table of a part."""
    return f"<!-- results.py {part}: begin -->", f"<!-- results.py {part}: end -->"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"{', '.join(PARTS)}; all unless given")
    parser.add_argument("--write", action="store_true", help="write the tables of docs/background/results.md")
    options = parser.parse_args()
    if unknown := [*{*options.parts} - {*PARTS}]:
        parser.error(f"no such table: {', '.join(unknown)}")
    for part in options.parts or PARTS:
        printed = []
        for line in table(PARTS[part]()):
            print(line, flush=True)
            printed.append(line)
        print()
        if options.write:
            write(part, printed)


if __name__ == "__main__":
    main()
