"""Schwarz iterations on four strips: the error of every subdomain, for four ways to iterate.

33 x 33 points, 2 points of overlap, a = 0.7, b = 0.05, from the mesh of a grid half as fine. Nothing takes over where a
condition fails: what one sees is the condition itself. Without --full, only the paper's u is shown.

    pip install 'equimesh[solver,plot]'
    python 12_schwarz_errors.py --full
"""

import argparse
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

import equimesh as em
from equimesh.plot import figure_file, iteration_axis, semilog

LAST = 14
FIXED = em.Schwarz(fallback=False, tolerance=None, max_iterations=LAST, compare_single_domain=True)
COMMON = replace(FIXED, subdomains=(4, 1), overlap=2)
TURNS = replace(COMMON, ordering=em.Ordering.ALTERNATING)
KINDS = {
    "classical": replace(COMMON, transmission=em.Classical()),
    "linear Robin, taking turns": replace(TURNS, transmission=em.LinearRobin(p="auto")),
    "optimized alone": replace(COMMON, line_correction=0, acceleration=em.Acceleration.NONE),
    "default: + lines + Anderson": COMMON,
}
FUNCTIONS = {"paper's u": "(1 - exp(15*(x - 1))) * sin(pi*y)", "wave": "tanh(50*(y - 0.5 - 0.25*sin(2*pi*x)))"}


def remark(solution: em.Solution) -> str:
    """How often positions replaced the requested data."""
    rescued = sum(any(part.classical for part in record.subdomains) for record in solution.iterations)
    return f"classical data in {rescued} of {solution.iterations[-1].iteration} iterations" if rescued else ""


def draw(rows: Mapping[str, Mapping[str, em.Solution]], path: Path) -> None:
    """A row of panels for every function, a column for every way to iterate."""
    with figure_file(path, 12.0, 0.9 + 3.0 * len(rows)) as figure:
        panels = figure.subplots(len(rows), len(KINDS), sharex=True, sharey=True, squeeze=False)
        for (name, solutions), line in zip(rows.items(), panels, strict=True):
            line[0].set_ylabel(f"{name}\nlargest error of a node")
            for axes, solution in zip(line, solutions.values(), strict=True):
                parts = [[max(p.error_x, p.error_y) for p in r.subdomains] for r in solution.iterations]
                columns = enumerate(np.array(parts).T, start=1)
                semilog(axes, {f"subdomain {k}": (np.arange(len(parts)), column) for k, column in columns})
                axes.get_legend().remove()
                axes.text(0.04, 0.04, remark(solution), transform=axes.transAxes)
                iteration_axis(axes, np.arange(LAST + 1))
                axes.label_outer()
        for axes, kind in zip(panels[0], KINDS, strict=True):
            axes.set_title(kind, fontsize=11)
        panels[0, 0].set_ylim(3e-17, 0.3)
        figure.suptitle("Error against the single-domain mesh: 4 strips, 33 × 33 points, overlap 2", fontsize=12)
        figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    Image.open(path).convert("RGB").quantize(64).save(path, optimize=True)


def main(output: Path, names: list[str]) -> None:
    rows: dict[str, dict[str, em.Solution]] = {}
    for name in names:
        monitor = em.ArcLength(u=em.Expression(FUNCTIONS[name]), a=0.7, b=0.05)
        problem = em.Problem(monitor=monitor, grid=em.Grid(n_xi=33, n_eta=33))
        rows[name] = {kind: em.solve(problem, settings, check=False) for kind, settings in KINDS.items()}
        print(f"{name}: error at the start, and after 1, 3 and {LAST} iterations")
        for kind, solution in rows[name].items():
            shown = "  ".join(f"{solution.iterations[k].error:.1e}" for k in (0, 1, 3, -1))
            print(f"  {kind:<27}  {shown}  {remark(solution)}".rstrip())
    draw(rows, output / "schwarz-errors.png")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("example-output"), help="folder for files")
    parser.add_argument("--full", action="store_true", help="all functions, in half a minute")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    main(options.output, list(FUNCTIONS)[: None if options.full else 1])
