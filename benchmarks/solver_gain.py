"""What a solver gets from meshes: the errors of bilinear elements on the uniform mesh over those on the adapted one.

Poisson's equation with u as solution, by the Ritz projection of ``equimesh.quality.ritz``. Eight problems of the
tutorials and the gallery, and random functions that nobody tuned to on 33 x 33 points, by several monitors.

    python benchmarks/solver_gain.py                    eight problems, 30 functions: two minutes
    python benchmarks/solver_gain.py --functions 100 --monitors auto "auto, for interpolation"
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from statistics import fmean
from typing import NamedTuple

from costs.rows import cpu_seconds
from random_functions import random_functions

import equimesh as em

GALLERY = Path(__file__).resolve().parent.parent / "service" / "equimesh_service" / "workbench" / "gallery.json"
SHOWN = ("flame", "vortex-pair", "shear-layer")
"""The problems of the gallery; their specs are read from its file."""
PROBLEMS: Mapping[str, tuple[str, int]] = {
    "boundary layer": ("(1 - exp(40*(x - 1)))*sin(pi*y)", 49),
    "corner layers": ("(1 - exp(-30*x))*(1 - exp(-30*y))", 49),
    "ring": ("tanh(20*((x - 0.5)**2 + (y - 0.5)**2 - 0.09))", 65),
    "wave": ("tanh(40*(y - 0.5 - 0.1*sin(2*pi*x)))", 33),
    "front": ("tanh(20*(x + y/2 - 0.75))", 33),
}
"""Formulas, and points a side."""
POINTS, SEED = 33, 77
"""Points a side of the meshes of random functions, and the seed of these."""
MAX_ANGLE = 60.0
"""The angle above which many codes complain, in degrees."""
Make = Callable[[em.Field], em.Monitor]
MONITORS: Mapping[str, Make] = {
    "auto": lambda u: em.Auto(u=u),
    "auto, for interpolation": lambda u: em.Auto(u=u, purpose="interpolation"),
    "for interpolation, norm h1": lambda u: em.Auto(u=u, norm="h1", purpose="interpolation"),
    "for interpolation, orthogonality 50": lambda u: em.Auto(u=u, orthogonality=50, purpose="interpolation"),
    "least error": lambda u: em.LeastError(u=u),
    "least error, for finite_element": lambda u: em.LeastError(u=u, purpose="finite_element"),
    "least error, smoothness 10": lambda u: em.LeastError(u=u, smoothness=10.0),
    "least error, distortion 2, smoothness 4": lambda u: em.LeastError(u=u, distortion=2.0, smoothness=4.0),
    "rectilinear": lambda u: em.LeastError(u=u, rectilinear=True),
}


class Measured(NamedTuple):
    """One mesh: gains of a solver and of interpolation in L2, the largest angle in degrees, and CPU seconds."""

    solver: float
    interpolation: float
    angle: float
    seconds: float


def measured(u: em.Field, n: int, make: Make) -> Measured:
    """The mesh of a monitor on ``n`` x ``n`` points of the unit square."""
    problem = em.Problem(monitor=make(u), grid=em.Grid(n_xi=n, n_eta=n))
    seconds, solution = cpu_seconds(lambda: em.solve(problem, threads=1, check=False), 1)
    gain, errors = solution.solver_gain, solution.interpolation
    assert gain is not None
    assert errors is not None
    return Measured(gain.l2, errors.estimated_gain("l2"), solution.faces.non_orthogonality, seconds)


def problems() -> Iterator[tuple[str, em.Field, int]]:
    """The eight problems: name, u, and points a side."""
    for name, (text, n) in PROBLEMS.items():
        yield name, em.Expression(text), n
    for item in json.loads(GALLERY.read_text())["problems"]:
        if item["name"] in SHOWN:
            u = item["spec"]["monitor"]["u"]
            function = em.Expression(u["expression"], parameters=u["parameters"])
            yield item["name"].replace("-", " "), function, item["spec"]["grid"]["n_xi"]


def table(names: Sequence[str]) -> Iterator[str]:
    """The eight problems in lines: gain of the solver / of interpolation / largest angle."""
    yield f"| problem, points a side | {' | '.join(names)} |"
    yield f"|{'---|' * (len(names) + 1)}"
    for name, u, n in problems():
        found = [measured(u, n, MONITORS[one]) for one in names]
        best = max(one.solver for one in found)
        cells = [f"{one.solver:.3g} / {one.interpolation:.3g} / {one.angle:.0f}°" for one in found]
        bold = [f"**{text}**" if one.solver >= 0.9 * best else text for text, one in zip(cells, found, strict=True)]
        yield f"| {name}, {n} | {' | '.join(bold)} |"


def summary(names: Sequence[str], count: int, seed: int) -> Iterator[str]:
    """The random functions in lines, one for each monitor."""
    functions = [em.Expression(one.u) for one in random_functions(seed, count)]
    yield f"| {count} random functions | solver, mean | smallest | interpolation | angle below 60° | CPU, ms |"
    yield "|---|---|---|---|---|---|"
    for name in names:
        found = [measured(u, POINTS, MONITORS[name]) for u in functions]
        solver, other = (math.exp(fmean(math.log(one[k]) for one in found)) for k in (0, 1))
        share = fmean(one.angle < MAX_ANGLE for one in found)
        milliseconds = 1000.0 * fmean(one.seconds for one in found)
        smallest = min(one.solver for one in found)
        yield f"| {name} | {solver:.2f} | {smallest:.2f} | {other:.2f} | {share:.0%} | {milliseconds:.0f} |"


def main(arguments: Sequence[str] | None = None) -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--functions", type=int, default=30, metavar="N", help="random functions (default: 30)")
    parser.add_argument("--seed", type=int, default=SEED, help=f"their seed (default: {SEED})")
    parser.add_argument("--monitors", nargs="+", choices=MONITORS, default=list(MONITORS), metavar="NAME")
    options = parser.parse_args(arguments)
    for u, n in ((em.Expression("x*y + x**3"), 17),):  # loads the compiled loops
        for name in options.monitors:
            measured(u, n, MONITORS[name])
    for line in table(options.monitors):
        print(line, flush=True)
    print()
    for line in summary(options.monitors, options.functions, options.seed):
        print(line, flush=True)


if __name__ == "__main__":
    main()
