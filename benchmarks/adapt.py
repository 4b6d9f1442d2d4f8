"""Solve, adapt, solve: gains of the meshes of ``equimesh.adapt`` over the uniform mesh, as the tables of the docs.

python benchmarks/adapt.py                  # the loop on all problems, 65 x 65 points, five rounds
python benchmarks/adapt.py --only A B       # some of them
python benchmarks/adapt.py --norm h1        # meshes and ranks by the error of the gradient
python benchmarks/adapt.py --supg           # the usual SUPG parameter against the bounded one
python benchmarks/adapt.py --write          # both, into the pages of the docs
"""

from __future__ import annotations

import argparse
import re
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
from convection import PROBLEMS, UNRESOLVED, UNSEEN, Parameter, Problem

import equimesh as em
from equimesh.rounds.estimate import ErrorEstimate
from equimesh.rounds.round import next_mesh

DOCS = Path(__file__).parents[1] / "docs"
POINTS, ROUNDS = 65, 5
ALL = {**PROBLEMS, **UNSEEN, **UNRESOLVED}
STREAMS = [name for name, problem in PROBLEMS.items() if any(problem.b)]
"""Problems with a stream, which need the parameter."""


@dataclass(frozen=True, kw_only=True)
class Result:
    """The result of one loop."""

    found: em.Adaptation
    gains: list[tuple[float, float]]
    """The gains of every round in L2 and H1."""
    efficiency: float
    """The estimate over the error of the best mesh."""


def run(
    problem: Problem, points: int, rounds: int, parameter: Parameter = "thin", norm: Literal["l2", "h1"] = "l2"
) -> Result:
    """The loop on one problem."""
    found = em.adapt(
        lambda mesh: problem.solve(mesh, parameter), points, domain=problem.domain, rounds=rounds, norm=norm, threads=1
    )
    errors = [problem.errors(one.mesh, one.values) for one in found.rounds]
    gains = [(errors[0][0] / l2, errors[0][1] / h1) for l2, h1 in errors]
    return Result(found=found, gains=gains, efficiency=found.estimate / errors[found.best][0])


def loop_rows(names: list[str], points: int, rounds: int, norm: Literal["l2", "h1"] = "l2") -> Iterator[str]:
    """The table of the loop."""
    yield "| problem | gain L2 / H1 | estimate over error | resolved |"
    yield "|---|---|---|---|"
    for name in names:
        result = run(ALL[name], points, rounds, norm=norm)
        l2, h1 = result.gains[result.found.best]
        resolved = "yes" if result.found.resolved else "**no**"
        yield f"| {name} | {l2:.3g} / {h1:.3g} | {result.efficiency:.2f} | {resolved} |"


def supg_rows(names: list[str], points: int, rounds: int) -> Iterator[str]:
    """The table of the SUPG parameters: both on the uniform mesh, and on the mesh of the loop with either."""
    yield "| problem | uniform, usual over bounded | gain, usual | gain, bounded |"
    yield "|---|---|---|---|"
    for name in names:
        problem = ALL[name]
        uniform = em.Mesh.uniform(em.Grid(n_xi=points, n_eta=points))
        usual, thin = (problem.errors(uniform, problem.solve(uniform, kind))[0] for kind in ("usual", "thin"))
        mesh = run(problem, points, rounds).found.mesh
        gains = [problem.errors(mesh, problem.solve(mesh, kind))[0] for kind in ("usual", "thin")]
        yield f"| {name} | {usual / thin:.2f} | {usual / gains[0]:.3g} | {thin / gains[1]:.3g} |"


def microseconds(points: int) -> float:
    """CPU time of adapting in one round, of a front, in microseconds a point: the least of a few."""
    problem, times = PROBLEMS["A"], []
    mesh = em.Mesh.uniform(em.Grid(n_xi=points, n_eta=points))
    for _ in range(5):
        values = problem.solve(mesh)
        begun = time.process_time()
        known = ErrorEstimate.of(mesh, values, problem.domain)
        mesh = next_mesh(known, "l2").reference
        times.append(time.process_time() - begun)
    return 1e6 * float(np.min(times)) / points**2


def write(page: str, mark: str, rows: list[str]) -> None:
    """Replace the table after the line with ``mark`` in a page of the docs."""
    path = DOCS / page
    start = f"<!-- {mark} -->\n\n"
    text, changed = re.subn(
        rf"({re.escape(start)})(?:\|.*\n)*", lambda m: m[1] + "\n".join(rows) + "\n", path.read_text()
    )
    if changed != 1:
        raise SystemExit(f"{path} has no line {start.strip()}")
    path.write_text(text)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=ALL, help="these problems")
    parser.add_argument("--points", type=int, default=POINTS, help="points a side")
    parser.add_argument("--rounds", type=int, default=ROUNDS, help="rounds, at most")
    parser.add_argument("--norm", choices=("l2", "h1"), default="l2", help="the norm of the loop, not for --write")
    parser.add_argument("--supg", action="store_true", help="compare the two SUPG parameters")
    parser.add_argument("--write", action="store_true", help="write both tables into the pages of the docs")
    options = parser.parse_args()
    if options.write and options.norm != "l2":
        parser.error("the tables of the docs are those of l2: leave --norm or --write out")
    loop = partial(loop_rows, norm=options.norm)
    tables = [] if options.supg else [("how-to/adapt.md", "loop", loop, options.only or [*ALL])]
    if options.supg or options.write:
        tables.append(("how-to/supg.md", "supg", supg_rows, options.only or STREAMS))
    for page, mark, table, names in tables:
        rows = []
        for row in table(names, options.points, options.rounds):
            rows.append(row)
            print(row, flush=True)
        if options.write:
            write(page, mark, rows)
    print(f"a round adapts in {microseconds(options.points):.0f} microseconds of CPU time a point")


if __name__ == "__main__":
    main()
