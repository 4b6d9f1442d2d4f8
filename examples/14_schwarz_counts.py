"""Numbers of Schwarz iterations by transmission condition, function and subdomains, as a table and a picture.

Counted are iterations until the error against the single-domain mesh is a millionth of the start's, on 33 x 33 points
with 2 points of overlap, a = 0.7, b = 0.05, from the mesh of a grid half as fine. Robin's take turns as in the paper,
and are given up after 10 iterations that have not gained a digit. Without --full, one function is counted.

    pip install 'equimesh[solver,plot]'
    python 14_schwarz_counts.py --full
"""

import argparse
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import LogNorm
from PIL import Image

import equimesh as em
from equimesh.meshes import halved, prolong
from equimesh.plot import figure_file

COMMON = em.Schwarz(overlap=2, fallback=False, tolerance=None)
TURNS = replace(COMMON, ordering=em.Ordering.ALTERNATING)
CLASSICAL = replace(COMMON, transmission=em.Classical())
KINDS = {
    "classical": CLASSICAL,
    "linear Robin, taking turns": replace(TURNS, transmission=em.LinearRobin(p="auto")),
    "nonlinear Robin, taking turns": replace(TURNS, transmission=em.NonlinearRobin(p="auto")),
    "optimized alone": replace(COMMON, line_correction=0, acceleration=em.Acceleration.NONE),
    "classical + lines + Anderson": replace(CLASSICAL, line_correction=3, acceleration=em.Acceleration.ANDERSON),
    "default: optimized + lines + Anderson": COMMON,
}
FUNCTIONS = {
    "paper": "(1 - exp(15*(x - 1))) * sin(pi*y)",
    "sine": "sin(2*pi*x) * sin(2*pi*y)",
    "ring": "tanh(20*((x - 0.5)**2 + (y - 0.5)**2 - 0.09))",
    "tanh20": "tanh(20*(x + y/2 - 0.75))",
    "tanh60": "tanh(60*(x + y/2 - 0.75))",
    "wave": "tanh(50*(y - 0.5 - 0.25*sin(2*pi*x)))",
}
CUTS = ((2, 1), (8, 1), (16, 1), (1, 8), (2, 2), (4, 4), (8, 8))
GOAL, MOST, PATIENCE = 1e-6, 30, 10


def count(problem: em.Problem, start: em.Mesh, single: em.Mesh, settings: em.Schwarz) -> str:
    """The number of iterations to :data:`GOAL`, or the reason why there is none."""
    errors: list[float] = []
    for record in em.iterate(problem, settings, start, single):
        errors.append(record.error)
        if errors[-1] <= GOAL * errors[0]:
            return str(record.iteration)
        hopeless = settings.ordering == "alternating" and record.iteration == PATIENCE and errors[-1] > 0.1 * errors[0]
        if record.failed or hopeless or record.iteration == MOST:
            return "failed" if record.failed else f">{record.iteration}"
    raise AssertionError("iterations end in one of these ways")


def shade(word: str) -> float:
    """The value that is drawn for a count: the largest where it is not reached, nan where the iteration failed."""
    return {">": 2.0 * MOST, "f": np.nan}.get(word[0]) or float(word)


def draw(counts: dict[tuple[str, str], dict[str, str]], names: list[str], path: Path) -> None:
    """A panel for every kind: functions down, subdomains across, the darker the more iterations."""
    with figure_file(path, 12.0, 6.2) as figure:
        colours = colormaps["YlGnBu"].with_extremes(over="black")
        panels = figure.subplots(2, 3, sharex=True, sharey=True)
        for axes, kind in zip(panels.flat, KINDS, strict=True):
            words = [list(counts[kind, name].values()) for name in names]
            shades = [[shade(word) for word in row] for row in words]
            axes.pcolormesh(shades, cmap=colours, norm=LogNorm(2, MOST), edgecolors="white", linewidth=1.5)
            axes.patch.set(hatch="////", edgecolor="#bbbbbb")  # visible where an iteration failed
            for (row, column), number in np.ndenumerate(shades):
                ink, box = "white" if number > 9 else "black", None if number > 0 else {"color": "white", "pad": 1}
                axes.text(column + 0.5, row + 0.5, words[row][column], color=ink, bbox=box, ha="center", va="center")
            axes.set_title(kind, fontsize=11)
            axes.set_xticks(np.arange(len(words[0])) + 0.5, counts[kind, names[0]])
            axes.set_yticks(np.arange(len(names)) + 0.5, names)
            axes.tick_params(length=0)
        panels[0, 0].invert_yaxis()
        figure.supxlabel("subdomains along xi × eta; >10, >30: not reached in this number of iterations", fontsize=10)
        figure.suptitle("Iterations until the error is 1e-6 of the start's; 33 × 33 points, overlap 2", fontsize=12)
    Image.open(path).convert("RGB").quantize(64).save(path, optimize=True)


def main(output: Path, names: list[str], cuts: list[tuple[int, int]]) -> None:
    counts = {}
    for name in names:
        monitor = em.ArcLength(u=em.Expression(FUNCTIONS[name]), a=0.7, b=0.05)
        problem = em.Problem(monitor=monitor, grid=em.Grid(n_xi=33, n_eta=33))
        coarse = em.solve(replace(problem, grid=halved(problem.grid)), mode=em.Mode.TIGHT).reference
        start, single = prolong(coarse, problem.grid), em.solve(problem, mode=em.Mode.TIGHT).reference
        for kind, settings in KINDS.items():
            counts[kind, name] = {
                f"{cut[0]} × {cut[1]}": count(problem, start, single, replace(settings, subdomains=cut)) for cut in cuts
            }
    print("| condition | u | " + " | ".join(counts[kind, name]) + " |" + "\n|---|---" + "|---" * len(cuts) + "|")
    for kind, name in product(KINDS, names):
        print(f"| {kind} | {name} | " + " | ".join(counts[kind, name].values()) + " |")
    draw(counts, names, output / "schwarz-counts.png")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("example-output"), help="folder for files")
    parser.add_argument("--full", action="store_true", help="all functions and subdomains, in half an hour")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    main(options.output, *((list(FUNCTIONS), CUTS) if options.full else (["paper"], [(2, 1), (2, 2)])))
