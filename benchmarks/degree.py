"""What meshes for elements of degree 2 and 3 gain, on random functions and on seven known ones, and what they cost.

    python benchmarks/degree.py                  # 100 random functions and the table: two minutes of processor time
    python benchmarks/degree.py --count 20 --norm h1

Every gain is the error of interpolation on the uniform mesh over that on the mesh, for elements of one degree. It is
measured with 8 x 8 Gauss points a cell, other ones than those of the descent.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from random_functions import random_functions

import equimesh as em
from equimesh.quality.cells import BilinearCells, ChosenCells
from equimesh.quality.degrees import squared_errors
from equimesh.quality.elements import basis, rule

DEGREES = (1, 2, 3)
GAUSS_POINTS = 8
SEED = 29_171_127
KNOWN = {
    "tanh(20*(x + y/2 - 0.75))": "a front",
    "exp(-1000*((x-0.5)**2 + (y-0.5)**2))": "a peak",
    "atan(50*(hypot(x-0.5, y-0.5) - 0.25))": "a ring",
    "2**40*(x*(1-x)*y*(1-y))**10": "a hill",
    "sin(6*x)*cos(5*y)": "waves",
    "tanh(60*(x-0.3-0.4*y)) + tanh(40*(y-0.5-0.2*sin(2*pi*x)))": "two fronts",
    "(x*x + y*y + 1e-12)**(1/3)": "a corner",
}
"""Functions of the table, and what they are."""


class Mesh(NamedTuple):
    """A mesh for one degree: its gains for each of ``DEGREES``, whether a cell is folded, and the time of the solve."""

    gains: tuple[float, ...]
    folded: bool
    seconds: float


def errors(mesh: em.Mesh, u: em.Field, norm: str) -> np.ndarray:
    """The error of interpolation for each degree."""
    cells, element = BilinearCells(mesh), rule("quad", GAUSS_POINTS)
    bases = [basis("quad", degree, element) for degree in DEGREES]
    (squares,) = squared_errors((cells,), ChosenCells.of(cells.rows), u, bases, element)
    return np.sqrt(squares[:, ("l2", "h1").index(norm)].sum(axis=-1))


def solved(text: str, points: int, norm: str) -> Iterator[Mesh]:
    """The mesh for each degree."""
    u, grid = em.Expression(text), em.Grid(n_xi=points, n_eta=points)
    uniform = errors(em.Mesh.uniform(grid), u, norm)
    for degree in DEGREES:
        problem = em.Problem(monitor=em.LeastError(u=u, degree=degree, norm=norm), grid=grid)  # type: ignore[arg-type]
        began = time.process_time()
        solution = em.solve(problem, threads=1, check=False)
        seconds = time.process_time() - began
        gains = uniform / np.maximum(errors(solution.mesh, u, norm), 1e-300)
        yield Mesh(tuple(gains), solution.mesh.is_folded, seconds)


def mean(values: Sequence[float]) -> float:
    """The geometric mean."""
    return math.exp(float(np.mean(np.log(values))))


def main() -> None:
    """Print the table of known functions, and the means over random ones."""
    parser = argparse.ArgumentParser(description="Gains and cost of meshes for elements of degree 1, 2 and 3.")
    parser.add_argument("--points", type=int, default=33, help="points a side")
    parser.add_argument("--count", type=int, default=100, help="random functions")
    parser.add_argument("--norm", choices=("l2", "h1"), default="l2")
    parser.add_argument("--seed", type=int, default=SEED)
    options = parser.parse_args()
    list(solved("x*y + exp(x)", options.points, options.norm))  # compiles the loops
    print(f"gains in {options.norm.upper()} on {options.points} x {options.points} points, for degree 1 / 2 / 3")
    print("| u | mesh for degree 1 | for degree 2 | for degree 3 |\n|---|---|---|---|")
    for text, name in KNOWN.items():
        rows = [" / ".join(f"{gain:.3g}" for gain in mesh.gains) for mesh in solved(text, options.points, options.norm)]
        print(f"| {name}, `{text}` | {' | '.join(rows)} |", flush=True)
    found = [list(solved(one.u, options.points, options.norm)) for one in random_functions(options.seed, options.count)]
    for k, degree in enumerate(DEGREES):
        own = [meshes[k].gains[k] for meshes in found]
        of_first = [meshes[0].gains[k] for meshes in found]
        seconds = [meshes[k].seconds for meshes in found]
        worse, folded = sum(gain < 1.0 - 1e-9 for gain in own), sum(meshes[k].folded for meshes in found)
        print(
            f"degree {degree}: mean gain {mean(own):.1f}, smallest {min(own):.3f}, {worse} worse, {folded} folded;"
            f" on the mesh for degree 1 mean {mean(of_first):.1f}, {sum(gain < 1.0 for gain in of_first)} worse;"
            f" {1e3 * mean(seconds):.0f} ms, {mean(seconds) / mean([meshes[0].seconds for meshes in found]):.2f} times"
        )


if __name__ == "__main__":
    main()
