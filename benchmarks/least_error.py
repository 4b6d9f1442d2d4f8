"""Least error against its goals and against Mmg2d and Gmsh: gains, cost, random functions, errors.

pip install mmgpy gmsh        # optional
python benchmarks/least_error.py --functions paper ring20 --parts gains costs
python benchmarks/least_error.py --write      # all of it, into benchmarks/least_error.md
"""

from __future__ import annotations

import argparse
import os
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path

from equimesh_cli.report import THREAD_COUNTS

if __name__ == "__main__":
    os.environ.update(dict.fromkeys(THREAD_COUNTS, "1"))  # before the linear algebra is loaded

import least_error_gains as measured
from costs import budget, peers
from costs.rows import Row, lines
from least_error_goals import (
    COSTS,
    CURVED,
    EQUAL_VERTICES,
    EQUAL_VERTICES_ELSEWHERE,
    LAYERS,
    POINTS,
    ROUGH,
)

import equimesh as em

PAGE = Path(__file__).with_suffix(".md")
HEADING = "# Least error"
WIDTH = 120
"""Of a line of the page."""
INTRODUCTION = f"""\
`benchmarks/least_error.py --write` measures all of this and writes this page. The errors are those of the bilinear
interpolant, or of the linear one on triangles, by {measured.GAUSS_POINTS} x {measured.GAUSS_POINTS} Gauss points in a
cell, with code that the solver does not use. A *gain* is the error on the uniform mesh over that on the adapted one.
CPU time is that of one thread, after a solve that loads the kernels. The functions are in
`benchmarks/least_error_goals.py`.
"""
TEXTS = {
    "gains": "The L2 gain on {n} x {n} points. The first number is the gain; the goals are for {goal} x {goal} points.",
    "costs": "The cost of a point in microseconds, the median of the functions from `paper` to `smooth`.",
    "random": "Random functions that nobody tuned to: `random_functions.py --seed {seed}`, on {n} x {n} points.",
    "vertices": "Our L2 error over that of the peer, with as many vertices, to 3 percent. Below 1 ours is smaller.",
    "budget": (
        "The L2 error that CPU time buys, least ones starred. Every mesher makes meshes of growing size, and counts"
        " the best that took no longer; between two sizes the logarithms are interpolated. Mmg2d may stop after one,"
        " two or three passes. Its scale and the size table of Gmsh cost nothing here."
    ),
}


def vertices(n: int, names: list[str]) -> Iterator[Row]:
    """Our error over those of Mmg2d and Gmsh, with as many vertices."""
    for name in names:
        u = em.Expression(CURVED[name].u)
        kinds: dict[str, em.Monitor] = {
            "defaults": em.LeastError(u=u),
            f"smoothness {ROUGH:g}": em.LeastError(u=u, smoothness=ROUGH),
        }
        others = [work(name, u, n) for library, work in PEERS.items() if peers.is_installed(library)]
        for kind, monitor in kinds.items():
            mesh = measured.solve(monitor, n).mesh
            own = peers.measure(name, u, kind, 0.0, (mesh.points, mesh.cells))
            for other in others:
                goal = EQUAL_VERTICES.get(name, EQUAL_VERTICES_ELSEWHERE) if "Mmg" in other.mesher else None
                note = f"{own.l2:.2e} and {other.l2:.2e}; {own.vertices} and {other.vertices} vertices"
                yield Row(
                    what=f"{name}, {kind}, over {other.mesher}", value=own.l2 / other.l2, unit="", goal=goal, note=note
                )


PEERS: dict[str, Callable[[str, em.Expression, int], peers.Meshed]] = {"mmgpy": peers.mmg, "gmsh": peers.gmsh}


def bought(names: list[str]) -> Iterator[budget.Curve]:
    """The errors that CPU time buys, of our least error and of the peers."""
    for name in names:
        u = em.Expression(CURVED[name].u)
        monitors: dict[str, em.Monitor] = {
            "equimesh, defaults": em.LeastError(u=u),
            f"equimesh, smoothness {ROUGH:g}": em.LeastError(u=u, smoothness=ROUGH),
        }
        yield from budget.curves(name, u, monitors)


def report(options: argparse.Namespace) -> Iterator[str]:
    """The lines of the section, each as soon as it is measured."""
    known = [*CURVED, *LAYERS]
    names = [name for name in known if name in options.functions]
    curved = [name for name in names if name in CURVED]
    parts: dict[str, Callable[[], Iterator[str]]] = {
        "gains": lambda: lines(measured.gains(options.points, names)),
        "costs": lambda: lines(measured.costs(options.sizes, {name: CURVED[name] for name in curved})),
        "random": lambda: lines(measured.unseen(options.seed, options.count, options.points)),
        "vertices": lambda: lines(vertices(options.points, curved)),
        "budget": lambda: budget.lines(bought(curved)),
    }
    for part in options.parts:
        text = TEXTS[part].format(n=options.points, goal=POINTS, seed=options.seed)
        yield from ("", *textwrap.wrap(text, WIDTH), "", "```text")
        yield from parts[part]()
        yield "```"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    every = [*CURVED, *LAYERS]
    parser.add_argument("--points", type=int, default=POINTS, help="points a side")
    parser.add_argument("--sizes", type=int, nargs="+", default=list(COSTS), help="points a side for the cost")
    parser.add_argument("--functions", nargs="+", choices=every, default=every, metavar="NAME", help=", ".join(every))
    parser.add_argument("--seed", type=int, default=12, help="of the random functions")
    parser.add_argument("--count", type=int, default=200, help="random functions")
    parser.add_argument("--parts", nargs="+", choices=list(TEXTS), default=list(TEXTS))
    parser.add_argument("--write", action="store_true", help="write benchmarks/least_error.md")
    options = parser.parse_args()
    printed = [HEADING, "", INTRODUCTION.rstrip()]
    print("\n".join(printed), flush=True)
    for line in report(options):
        print(line, flush=True)
        printed.append(line)
    if options.write:
        PAGE.write_text("\n".join(printed) + "\n")


if __name__ == "__main__":
    main()
